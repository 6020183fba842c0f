"""Which node of a run was which, whatever the launch file calls it: the experiment, the estimator, the stage.

A node's role shows in what it publishes. Of several of a role, as with a second estimator that only listens,
the one meant is that from which the experiment receives, directly or through others, by the wires of the
launch file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from palp_core.errors import PalpError

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

PUBLISHED = {
    "experiment": "TrialResult",
    "policy": "RingCommand",  # so does the experiment, which fits the line above
    "actuator": "RingState",
    "stage": "SweepStatus",
    "phantom": "PhantomTruth",
    "torque": "TorqueBlock",
    "estimator": "Belief",
    "emg": "EmgBlock",
    "cocontraction": "CoContraction",
}
"""The message type that a node of each role publishes; the first role that fits is a node's."""

GUARD = "ContactGuard"
"""What a phantom publishes that is solved and not touched: what its contact model met."""

_NEEDED = ("experiment", "policy", "stage", "estimator")


@dataclass(frozen=True)
class Roles:
    node: Mapping[str, str]  # name of the node by role; a role that a session can do without may be missing
    of: Mapping[str, str]  # role by node; nodes without one are left out
    touch_simulated: bool  # whether the phantom's touch was computed
    guards_recorded: bool  # whether the experiment received what the computed touch met
    _params: Mapping[str, Mapping[str, Any]]

    def params(self, role: str) -> dict[str, Any]:
        """Return the parameters of the node of a role; none where no node has it."""
        return dict(self._params.get(self.node.get(role, ""), {}))


class NoSession(PalpError):
    """A run lacks a node that a session cannot do without."""

    def __init__(self, why: str, advice: str) -> None:
        super().__init__(f"{why}; {advice}")
        self.why = why


def roles_of(summary: RunSummary) -> Roles:
    of = {node: role for node, types in summary.publishes.items() if (role := _role(types))}
    experiment = _only(summary, "experiment", [node for node, role in of.items() if role == "experiment"])
    away = _away(experiment, summary)
    node = {"experiment": experiment}
    for role in PUBLISHED:
        found = sorted((one for one in of if of[one] == role), key=lambda one: away.get(one, len(away)))
        nearest = [one for one in found if away.get(one) == away.get(found[0])]
        if role in _NEEDED or nearest:
            node[role] = _only(summary, role, nearest)
    published = summary.publishes.get(node.get("phantom", ""), {})
    guards = {topic for topic, type_name in published.items() if type_name == GUARD}
    return Roles(node, of, bool(guards), not guards.isdisjoint(summary.listens[experiment]), summary.params)


def _role(topics: Mapping[str, str]) -> str:
    return next((role for role, type_name in PUBLISHED.items() if type_name in topics.values()), "")


def _only(summary: RunSummary, role: str, found: list[str]) -> str:
    if len(found) == 1:
        return found[0]
    if found:
        raise PalpError(
            f"{summary.file}: {' and '.join(found)} publish {PUBLISHED[role]}, so the report cannot choose "
            f"which is the session's {role}; let the experiment listen to one of them alone"
        )
    why = f"{summary.file}: no node publishes {PUBLISHED[role]}, so the report knows no {role}"
    raise NoSession(why, "add the node, or leave out 'report:'")


def _away(start: str, summary: RunSummary) -> dict[str, int]:
    """Return over how many wires ``start`` receives from each node; others are left out."""
    owner = {topic: node for node, topics in summary.publishes.items() for topic in topics}
    away, edge = {start: 0}, [start]
    while edge:
        node = edge.pop(0)
        for topic in summary.listens.get(node, []):
            source = owner.get(topic, start)
            if source not in away:
                away[source] = away[node] + 1
                edge.append(source)
    return away
