"""Start every node as its own process, watch it, restart it by rule, and end all of them for certain."""

from __future__ import annotations

import contextlib
import logging
import signal
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.node.loading import NodeProcess
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage
from palp_core.graph.process.control_messages import (
    Activate,
    Configured,
    Done,
    Failed,
    FromNode,
    Knock,
    Matched,
    Pulse,
    Raised,
    Relay,
    Shutdown,
    ToNode,
)
from palp_core.graph.process.shadow import Comparison
from palp_core.graph.process.swap_messages import FromSwapped, Listening
from palp_core.graph.supervision.channel_server import Switchboard
from palp_core.graph.supervision.fork_client import ForkServer
from palp_core.graph.supervision.fork_server import News, Started
from palp_core.graph.supervision.interrupt import Interrupt, Patience
from palp_core.graph.supervision.launcher_node import GraphBus
from palp_core.graph.supervision.managed_process import Member, how_it_ended
from palp_core.graph.supervision.restarts import READY_NS, Keeper
from palp_core.graph.supervision.standby import Understudies, Understudy

LADDER = ((), (signal.SIGTERM, signal.SIGCONT), (signal.SIGKILL,))
_LOG = logging.getLogger("palp.supervisor")


class ProcessCrew:
    """A crew of processes.

    Args:
        specs: The nodes in graph order.
        clock: ``sim`` or ``wall``.
        workspace: Folder that holds ``nodes/``.
        folder: The run directory.
        server: Parent of the processes.
        interrupt: Raises when the user wants the end.
        observe: Wall clock: is shown every message for the launch view.
        bus: Where the graph's events and health are published.

    Attributes:
        start_ns: The graph's start on the wall clock; 0 before.
        between: Called in every turn of :meth:`run_wall`.
        answers: What nodes have last said in a swap.
        listening: Which nodes listen to which topic at which second place.
        renewed: Called when a node has a new process.
        pulsed: Takes each encoded :class:`NodeHealth`.
        watch, forget: As of the switchboard.
    """

    def __init__(
        self,
        specs: Sequence[NodeSpec],
        clock: str,
        workspace: str,
        folder: Path,
        server: ForkServer,
        interrupt: Interrupt,
        observe: Callable[[int, bytes], None],
        bus: GraphBus,
    ) -> None:
        self.names = [spec.name for spec in specs]
        self.members = [Member(spec, folder / "log" / f"{spec.name}.log") for spec in specs]
        self.exit_code: int | None = None
        self.renewed: Callable[[], None] = lambda: None
        self.pulsed: Callable[[bytes], None] = lambda _: None
        self.between: Callable[[], None] = lambda: None
        self._place = {"clock": clock, "run_dir": str(folder), "workspace": workspace}
        self._server = server
        self._interrupt = interrupt
        self._observe = observe
        self._patience = Patience(interrupt)
        self.start_ns = 0
        self._replies: dict[int, Done] = {}
        self.answers: dict[int, FromSwapped] = {}
        self.listening: set[tuple[int, str, str]] = set()
        self._knocks: set[int] = set()
        self._keeper = Keeper(self.members, self, bus, restarts=clock == "wall")
        self._lines = Switchboard(
            folder / "supervisor.sock", self.names, (server.descriptor, interrupt.descriptor)
        )
        self.understudies = Understudies(folder, server, self._lines, self.spawn)
        self.watch, self.forget = self._lines.watch, self._lines.forget
        for descriptor in bus.file_descriptors:
            self.watch(descriptor, bus.poll)

    # Hands of the keeper

    def spawn(self, member: Member, *, successor: bool = False, fresh: bool = False) -> None:
        """Start a node's process."""
        birth = NodeProcess(
            spec=member.spec, place=member.place, successor=successor, fresh=fresh, **self._place
        )
        self._server.spawn(birth, str(member.log))

    def activate_on_wall(self, index: int) -> None:
        """Tell a node to work on the wall clock."""
        self._send(index, Activate(self.start_ns))

    def signal(self, member: Member, *numbers: signal.Signals) -> None:
        """Send signals to a node's process."""
        for number in numbers:
            self._server.signal(member.pid, number)

    def _send(self, index: int, message: ToNode) -> None:
        try:
            self._lines.send(index, message)
        except ChannelClosed:
            while not self.members[index].ended:  # the news of how it ended raises
                self._pump(1.0)

    # Events

    def _pump(self, timeout_s: float) -> None:
        """Handle what has happened; wait for something if nothing has.

        Raises:
            NodeError: A node failed; the first, when everything that has happened is accounted for.
        """
        heard, others = self._lines.wait(timeout_s)
        failures: list[NodeError] = []
        events: list[Callable[[], None]] = [partial(self._on_message, *said) for said in heard]
        events += self._lines.handlers(others)
        if self._server.descriptor in others:
            events += [partial(self._on_news, news) for news in self._server.news()]
        for handle in events:
            try:
                handle()
            except NodeError as error:
                failures.append(error)
        if failures:
            raise failures[0]
        if self._interrupt.descriptor in others:
            if not self._patience.ending:
                self._interrupt.check()
            self._interrupt.drain()

    def _on_message(self, index: int, message: FromNode) -> None:
        if self.understudies.hear(index, message):
            return
        member = self.members[index]
        if isinstance(message, Done):
            self._replies[index] = message
            member.done = self._patience.ending
        elif isinstance(message, Pulse):
            self._keeper.pulse(index, message.health)
            self.pulsed(message.health)
        elif isinstance(message, Relay):
            if message.frame:
                self._observe(monotonic_ns() - self.start_ns, message.frame)
            if message.exit_code is not None and member.spec.shutdown_on_exit:
                self.exit_code = message.exit_code
        elif isinstance(message, Listening):
            self.listening.add((index, message.topic, message.publish))
        elif isinstance(message, FromSwapped):
            self.answers[index] = message
        elif isinstance(message, Configured):
            member.configured = True
        elif isinstance(message, Matched):
            member.matched, member.missing = True, message.missing
        elif isinstance(message, Knock):
            self._knocks.add(index)
        elif isinstance(message, Raised) and not self._patience.ending:
            self._keeper.raised(index, message)
        elif isinstance(message, Failed) and not self._patience.ending:
            text = message.text.removeprefix(f"{member.spec.name}: ")
            if not self._keeper.restart(index, text):
                raise NodeError(member.spec.name, f"{text} (log: {member.log})")

    def _on_news(self, news: News) -> None:
        if self.understudies.take(news):
            return
        index = next(i for i, member in enumerate(self.members) if member.place == news.name)
        member = self.members[index]
        if isinstance(news, Started):
            member.pid = news.pid
            if member.spec.epoch:
                self.renewed()
            return
        if news.pid != member.pid:
            return
        member.ended = True
        self._keeper.ended(index)
        for message in self._lines.last_words(index):
            self._on_message(index, message)
        if self._patience.ending or member.handed_in or member.respawn_at_ns is not None:
            return
        cause = f"its process {how_it_ended(news.status)}"
        if not self._keeper.restart(index, cause):
            raise NodeError(member.spec.name, f"{cause}{member.last_words()}")

    # Swap

    def say(self, index: int, line: ChannelMessage) -> None:
        """Say something to a node; of one that is gone the fork server tells."""
        with contextlib.suppress(ChannelClosed):
            self._lines.send(index, line)  # type: ignore[arg-type]

    def lose(self, index: int, cause: str) -> None:
        """Restart a node whose process has ended by its rule.

        Raises:
            NodeError: Its rule allows none.
        """
        self._keeper.recover(index, cause)

    def promote(self, index: int, understudy: Understudy) -> None:
        """Let an understudy have a node's part, and the other way round."""
        new = self.understudies.exchange(index, self.members[index], understudy)
        self.members[index] = new
        new.activate(monotonic_ns())
        self._keeper.begin(index)

    # End

    def close(self) -> None:
        """End every process that is left; return when all are gone.

        One that has reached its safe state ends by itself, others with SIGTERM (and SIGCONT, for one that was
        stopped), 5 s later with SIGKILL; sooner if the user insists.
        """
        self._server.wake()
        for numbers in LADDER:
            known = [*self.members, *self.understudies.members]
            left = [m for m in known if m.pid and not m.ended and (numbers or m.done)]
            with contextlib.suppress(GraphError):
                for member in left:
                    self.signal(member, *numbers)
                self._patience.step()
                while any(not m.ended for m in left) and not self._patience.over:
                    self._pump(0.2)
        self._lines.close()


PATIENCE_S = 10.0
_LOG = logging.getLogger("palp.supervisor")


class Supervisor(ProcessCrew):
    """A crew of processes, from their start to the end of the run.

    Attributes:
        shadow: In lockstep, the number of a node, who works beside it unheard, and how they compare.
    """

    shadow: tuple[int, Understudy, Comparison] | None = None

    def follow(self, until: Callable[[], bool], deadline_ns: int | None = None) -> bool:
        """Handle what happens until something is so; return whether it is, when the time is over.

        Raises:
            NodeError: A node failed.
        """
        while not until():
            now_ns = monotonic_ns()
            left_s = 1.0 if deadline_ns is None else (deadline_ns - now_ns) / 1e9
            if left_s <= 0.0:
                return False
            if self.start_ns:
                self._keeper.turn(now_ns)
                left_s = min(left_s, self._keeper.patience_s(now_ns))
            self._pump(min(left_s, 1.0))
        return True

    # Start

    def start(self) -> None:
        """Start every node; return when all are configured and all edges matched.

        Raises:
            NodeError: A node failed or did not get ready in time.
        """
        for member in self.members:
            self.spawn(member)
        self._await(lambda m: m.configured, "configured")
        self._await(lambda m: m.matched, "matched with its publishers")

    def _await(self, ready: Callable[[Member], bool], what: str) -> None:
        deadline_ns = monotonic_ns() + READY_NS
        while late := next((member for member in self.members if not ready(member)), None):
            if monotonic_ns() > deadline_ns:
                text = f"was not {what} within {READY_NS // 10**9} s{late.last_words()}"
                raise NodeError(late.spec.name, text)
            self._pump(1.0)

    # Lockstep crew

    def activate(self, index: int) -> Done:
        """Activate one node."""
        return self.work({index: Activate(self.start_ns)})[index]

    def knocks(self) -> set[int]:
        """Return the numbers of the nodes for which commands have come since this was last asked."""
        knocks, self._knocks = self._knocks, set()
        return knocks

    def work(self, rounds: Mapping[int, ToNode]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, in parallel; return what each has done."""
        for index, message in rounds.items():
            self._send(index, message)
        if self.shadow is not None and self.shadow[0] in rounds:
            self._work_unheard(rounds[self.shadow[0]])
        asked_ns = monotonic_ns()
        while len(self._replies) < len(rounds):
            self._pump(PATIENCE_S)
            if monotonic_ns() - asked_ns > PATIENCE_S * 1e9:
                late = ", ".join(self.names[index] for index in rounds if index not in self._replies)
                _LOG.warning("still waiting for %s; Ctrl-C ends the run", late)
                asked_ns = monotonic_ns()
        replies, self._replies = self._replies, {}
        if self.shadow is not None and self.shadow[0] in replies:
            for frame in replies[self.shadow[0]].frames:
                self.shadow[2].old(frame)
        return replies

    def _work_unheard(self, message: ToNode) -> None:
        """Let the understudy of a node do the same as the node, and compare."""
        assert self.shadow is not None
        _, understudy, comparison = self.shadow
        understudy.said.clear()
        self.understudies.send(understudy, message)
        self.follow(lambda: bool(understudy.said) or bool(understudy.failure))
        for done in understudy.said:
            if isinstance(done, Done):
                for frame in done.frames:
                    comparison.new(frame)

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and let it end; :meth:`close` is for one that does not answer."""
        member = self.members[index]
        self._patience.begin()
        if not self._lines.connected(index) or member.ended:
            return Done([], -1, None)
        self._replies.clear()
        with contextlib.suppress(NodeError, GraphError, ChannelClosed):
            self._lines.send(index, Shutdown(now_ns))
            while not (member.done or member.ended) and not self._patience.over:
                self._pump(0.2)
        return self._replies.pop(index, Done([], -1, None))

    # Wall clock

    def run_wall(self, until_ns: int | None = None, start_ns: int | None = None) -> int:
        """Activate in graph order, then watch until the run ends; return the exit code.

        Args:
            until_ns: When to end, on the graph's clock.
            start_ns: The graph's start on the machine's monotonic clock; now by default.

        Raises:
            NodeError: A node failed and its rule does not restart it.
        """
        self.start_ns = monotonic_ns() if start_ns is None else start_ns
        while self.exit_code is None:
            now_ns = monotonic_ns()
            left_s = 1.0 if until_ns is None else (until_ns + self.start_ns - now_ns) / 1e9
            if left_s <= 0.0:
                return 0
            self._keeper.turn(now_ns)
            self._pump(min(left_s, self._keeper.patience_s(now_ns)))
            self.between()
        return self.exit_code
