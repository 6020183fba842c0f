"""Room for the files that the launcher and its fork server keep open for each node."""

import resource

from palp_core.errors import GraphError

OF_EACH_NODE = 2
"""In the fork server: what a node prints, and its log. The launcher has one, the node's channel."""

OF_THE_GRAPH = 200
"""Whatever the number of nodes (counted: 20 in the launcher, 15 in the fork server); the rest is for tools
that ask, four each, and for processes that stand by in a swap."""


def make_room(node_count: int, fork_server_pid: int) -> None:
    """Let both processes open what so many nodes need: the usual limit of 1024 is met by 412.

    Raises:
        GraphError: The hard limit, which only an administrator can raise, does not allow it.
    """
    needed = OF_THE_GRAPH + OF_EACH_NODE * node_count
    for pid in (0, fork_server_pid):
        soft, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
        if soft != resource.RLIM_INFINITY and soft < needed:
            if hard != resource.RLIM_INFINITY and hard < needed:
                raise GraphError(
                    f"{node_count} nodes need {needed} open files in one process; {hard} are allowed here: "
                    f"raise the hard limit to {needed} (ulimit -Hn, LimitNOFILE= of a service, or "
                    "/etc/security/limits.conf)"
                )
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (needed, hard))
