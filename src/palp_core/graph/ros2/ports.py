"""Messages from outside into the external ports of a running graph; the account of whatever crosses."""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Callable, Mapping
from threading import Lock
from typing import Any, NamedTuple

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.transport.requester_socket import RequesterSocket

MOST_UNDER_WAY = 500
ANSWER_NS = 5_000_000_000
REPORT_NS = 1_000_000_000


class Account:
    """The account of one entry of a map; any thread may write it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.crossed = self.lost = self.refused = 0  # refused, with a reason: those that could not be taken
        self.reason = ""
        self._reported = (0, 0)
        self._reported_ns = 0
        self._lock = Lock()

    def cross(self) -> None:
        with self._lock:
            self.crossed += 1

    def lose(self, count: int) -> None:
        with self._lock:
            self.lost += count

    def refuse(self, reason: str) -> None:
        with self._lock:
            self.refused += 1
            self.reason = reason

    def report(self, write: Callable[[str], None], *, at_once: bool = False) -> None:
        """Write what has been lost or refused since the last report, at most once a second."""
        now_ns = monotonic_ns()
        if (self.lost, self.refused) == self._reported or (
            now_ns < self._reported_ns + REPORT_NS and not at_once
        ):
            return
        lost, refused = self.lost - self._reported[0], self.refused - self._reported[1]
        self._reported, self._reported_ns = (self.lost, self.refused), now_ns
        if lost:
            write(f"{self.name}: {lost} lost ({self.lost} in all)")
        if refused:
            write(f"{self.name}: {refused} refused ({self.refused} in all): {self.reason}")

    def __str__(self) -> str:
        refused = f", {self.refused} refused" if self.refused else ""
        return f"{self.name}: {self.crossed} crossed, {self.lost} lost{refused}"


class _Asked(NamedTuple):
    account: Account
    at_ns: int


class Ports:
    """External ports of a running graph; used by one thread.

    A message has crossed when its node confirms it. What is not confirmed within some seconds is lost; so is
    what comes while too many wait for their answers.
    """

    def __init__(self, graph: RunningGraph) -> None:
        self._graph = graph
        self._sockets: dict[str, RequesterSocket] = {}
        self._asked: dict[str, deque[_Asked]] = {}
        self._token = uuid.uuid4().hex[:16]
        self._count = 0

    def publish(self, node: str, port: str, message: Mapping[str, Any], account: Account) -> None:
        if node not in self._sockets:
            self._sockets[node], self._asked[node] = RequesterSocket(), deque()
        waiting = self._asked[node]
        if len(waiting) >= MOST_UNDER_WAY:
            account.lose(1)
            return
        self._count += 1
        request = {"op": "publish", "node": node, "port": port, "message": message}
        waiting.append(_Asked(account, monotonic_ns()))
        self._sockets[node].ask(
            self._graph.node(node).serve, {**request, "id": f"{self._token}{self._count}"}
        )

    def turn(self) -> None:
        """See what nodes have confirmed, refused, or not answered."""
        oldest_ns = monotonic_ns() - ANSWER_NS
        for node, waiting in self._asked.items():
            self._take_answers(node)
            while waiting and waiting[0].at_ns < oldest_ns:
                waiting.popleft().account.lose(1)

    def _take_answers(self, node: str) -> None:
        waiting = self._asked[node]
        for reply in self._sockets[node].replies():
            if not waiting:
                continue  # late, and counted already
            account = waiting.popleft().account
            if "error" in reply:
                account.refuse(str(reply["error"]))
            else:
                account.cross()

    def close(self) -> None:
        """Let go; what is not confirmed is lost."""
        self.turn()
        for node, waiting in self._asked.items():
            self._sockets[node].close()
            for asked in waiting:
                asked.account.lose(1)
