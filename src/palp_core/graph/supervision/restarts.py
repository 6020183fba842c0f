"""Keep nodes at work on the wall clock: activate, restart by rule, notice who has gone silent."""

from __future__ import annotations

import logging
import signal
from collections.abc import Sequence
from typing import Protocol

from palp_core.errors import NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.builtin import NodeHealth
from palp_core.graph.messages.message import decode
from palp_core.graph.process.control_messages import Raised
from palp_core.graph.supervision.interrupt import KILL_NS
from palp_core.graph.supervision.launcher_node import GraphBus
from palp_core.graph.supervision.liveness import GIVE_UP_NS, Watch
from palp_core.graph.supervision.managed_process import Member
from palp_core.graph.transport.matched_readers import WAIT_NS

READY_NS = 60_000_000_000
"""In which a process must have configured its node (assumed: no device takes longer to answer)."""

HEALTH_NS = 1_000_000_000
LATE_NS = 10_000_000_000
_LOG = logging.getLogger("palp.supervisor")


class Hands(Protocol):
    """What a keeper can do to nodes."""

    def spawn(self, member: Member) -> None:
        """Start a process."""

    def activate_on_wall(self, index: int) -> None:
        """Tell a node to work."""

    def signal(self, member: Member, *numbers: signal.Signals) -> None:
        """Send signals to a process."""


class Keeper:
    """Looks after members that are to work until the run ends.

    Args:
        members: The nodes in graph order.
        hands: Does what is decided here.
        bus: Is told what has happened, and once a second how the nodes do.
        restarts: Whether a restart can be: in lockstep it would not be the same run.
    """

    def __init__(
        self,
        members: Sequence[Member],
        hands: Hands,
        bus: GraphBus,
        *,
        restarts: bool,
    ) -> None:
        self._members = members
        self._hands = hands
        self._bus = bus
        self._restarts = restarts
        self._watch = Watch()
        self._health_ns = 0
        self._said_late: set[int] = set()

    def turn(self, now_ns: int) -> None:
        """Do what is due.

        Raises:
            NodeError: A node cannot be kept at work.
        """
        for index, member in enumerate(self._members):
            if member.respawn_at_ns is not None:
                if now_ns >= member.respawn_at_ns:
                    self._replace(member, now_ns)
            elif not member.active:
                self._bring_up(index, now_ns)
        for index, silent_ns in self._watch.look(now_ns):
            self._miss(index, silent_ns, now_ns)
        if now_ns >= self._health_ns:
            self._health_ns = now_ns + HEALTH_NS
            self._bus.publish_health(self._watch.health)

    def patience_s(self, now_ns: int) -> float:
        """Return how long nothing will be due."""
        due_ns = [member.respawn_at_ns for member in self._members if member.respawn_at_ns is not None]
        wait_ns = min([self._health_ns, *(due for due in due_ns if due > now_ns)]) - now_ns
        overdue = any(due <= now_ns for due in due_ns)  # the old process is still about to end
        return min(max(wait_ns / 1e9, 0.001), 0.1 if overdue else 1.0)

    def _bring_up(self, index: int, now_ns: int) -> None:
        """Activate a node that is ready; lose patience with one that is not."""
        member = self._members[index]
        if member.matched:
            self._hands.activate_on_wall(index)
            member.activate(now_ns)
            self.begin(index)
            self._said_late.discard(index)
            if member.spec.epoch:
                self._restarted(member)
        elif not member.configured and now_ns - member.begun_ns > READY_NS:
            self.recover(index, f"was not configured within {READY_NS // 10**9} s", signal.SIGKILL)
        elif member.configured and now_ns - member.begun_ns > LATE_NS and index not in self._said_late:
            self._said_late.add(index)
            _LOG.warning("%s is configured and waits for its publishers", member.spec.name)

    def _restarted(self, member: Member) -> None:
        """Say that a node works again, and whom its first messages may not reach."""
        name, missing = member.spec.name, member.missing
        self._bus.report("restarted", name, f"is at work again, as process {member.pid}", missing=missing)
        if missing:
            _LOG.warning(
                "%s is at work again and has waited %g s for its readers; not back, so that they may lose "
                "its first messages: %s", name, WAIT_NS / 1e9, ", ".join(missing),
            )  # fmt: skip

    def _replace(self, member: Member, now_ns: int) -> None:
        """Start a failed node's next process, but never beside the one that has failed."""
        assert member.respawn_at_ns is not None
        if member.ended:
            member.begin(now_ns)
            self._hands.spawn(member)
        elif now_ns > member.respawn_at_ns + KILL_NS:
            self._hands.signal(member, signal.SIGKILL)

    def recover(self, index: int, cause: str, *numbers: signal.Signals) -> None:
        """Restart a node by its rule, with signals for a process that has not ended by itself.

        Raises:
            NodeError: Its rule allows no further start.
        """
        if not self.restart(index, cause, *numbers):
            member = self._members[index]
            raise NodeError(member.spec.name, f"{cause}{member.last_words()}")

    def restart(self, index: int, cause: str, *numbers: signal.Signals) -> bool:
        """Plan a node's next process if its rule allows one; return whether it does."""
        member = self._members[index]
        if member.respawn_at_ns is not None:
            return True
        planned = member.plan_restart(monotonic_ns(), cause) if self._restarts else ""
        if planned:
            self._watch.end(index)
            if not member.ended:
                self._hands.signal(member, *numbers)
            self._bus.report("restarting", member.spec.name, planned, restart=member.restart_count)
            _LOG.warning("%s: %s", member.spec.name, planned)
        return bool(planned)

    # What nodes say

    def pulse(self, index: int, health: bytes) -> None:
        """Take a node's word that its loop turns."""
        if self._watch.hear(index, decode(NodeHealth, health), monotonic_ns()):
            name = self._members[index].spec.name
            self._bus.report("responsive", name, "answers again")
            _LOG.warning("%s: answers again", name)

    def _miss(self, index: int, silent_ns: int, now_ns: int) -> None:
        member = self._members[index]
        name, silent_s = member.spec.name, silent_ns / 1e9
        if index not in self._watch.silent:
            self._watch.silent.add(index)
            text = f"has not been heard for {silent_s:.0f} s: stopped, or busy in one handler"
            self._bus.report("unresponsive", name, text, silent_s=silent_s)
            _LOG.warning("%s %s%s", name, text, member.last_words())
        if silent_ns >= GIVE_UP_NS and member.spec.restart == "on_failure":
            # A stopped process wakes and reaches its safe state; one in a loop meets SIGKILL later.
            self.recover(index, f"was unresponsive for {silent_s:.0f} s", signal.SIGTERM, signal.SIGCONT)

    def raised(self, index: int, event: Raised) -> None:
        """Act on a quality-of-service event.

        Raises:
            NodeError: The launch file wants the graph to end, or its publisher cannot be restarted again.
        """
        reader, publisher = self._members[index].spec.name, event.topic.split("/")[1]
        self._bus.report(
            "qos",
            reader,
            event.text,
            kind=event.kind,
            port=event.port,
            topic=event.topic,
            action=event.action,
        )
        _LOG.warning("%s: %s", reader, event.text)
        if event.action == "shutdown":
            raise NodeError(reader, f"{event.text}; its launch entry ends the graph at this")
        if event.action == "restart":
            found = [i for i, member in enumerate(self._members) if member.spec.name == publisher]
            for at in found:
                if self._members[at].active and not self.restart(
                    at, f"is restarted for {reader}: {event.text}", signal.SIGTERM, signal.SIGCONT
                ):
                    _LOG.warning("%s: its rule does not restart it (again)", publisher)

    def begin(self, index: int) -> None:
        """Expect a node to be heard from now on."""
        self._watch.begin(index, monotonic_ns())

    def ended(self, index: int) -> None:
        """Expect no more of a node whose process has ended."""
        self._watch.end(index)
