"""The processes of a graph's nodes: what they say, how they end, who takes whose place."""

from __future__ import annotations

import contextlib
import logging
import signal
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.node.loading import NodeProcess
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import (
    Activate,
    Configured,
    Done,
    Failed,
    FromNode,
    Knock,
    LinkClosed,
    Matched,
    Pulse,
    Raised,
    Relay,
    ToNode,
)
from palp_core.graph.process.line import Line
from palp_core.graph.process.swap_messages import FromSwapped, Listening
from palp_core.graph.supervision.channel_server import Switchboard
from palp_core.graph.supervision.fork_client import ForkServer
from palp_core.graph.supervision.fork_server import News, Started
from palp_core.graph.supervision.interrupt import Interrupt
from palp_core.graph.supervision.launcher_node import GraphBus
from palp_core.graph.supervision.managed_process import Member, how_it_ended
from palp_core.graph.supervision.patience import Patience
from palp_core.graph.supervision.restarts import Keeper
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
        except LinkClosed:
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

    def say(self, index: int, line: Line) -> None:
        """Say something to a node; of one that is gone the fork server tells."""
        with contextlib.suppress(LinkClosed):
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
