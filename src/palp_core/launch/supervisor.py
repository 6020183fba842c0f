"""Start every node as its own process, watch it, restart it by rule, and end all of them for certain."""

from __future__ import annotations

import contextlib
import logging
import signal
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from palp_core.errors import GraphError, NodeError
from palp_core.launch.fork_client import ForkServer
from palp_core.launch.fork_server import News, Started
from palp_core.launch.interrupt import Interrupt
from palp_core.launch.member import Member, how_it_ended
from palp_core.launch.switchboard import Switchboard
from palp_core.runtime.birth import NodeProcess
from palp_core.runtime.clock import monotonic_ns
from palp_core.runtime.link import (
    Activate,
    Configured,
    Done,
    Failed,
    FromNode,
    LinkClosed,
    Matched,
    Relay,
    Round,
    Shutdown,
    ToNode,
)
from palp_core.runtime.spec import NodeSpec

__all__ = ["Supervisor"]

START_TIMEOUT_NS = 60_000_000_000
LADDER_STEP_NS = 5_000_000_000
PATIENCE_S = 10.0
_LOG = logging.getLogger("palp.supervisor")


class Supervisor:
    """A crew of processes.

    Args:
        specs: The nodes in graph order.
        clock: ``sim`` or ``wall``.
        workspace: Folder that holds ``nodes/``.
        folder: The run directory.
        server: Parent of the processes.
        interrupt: Raises when the user wants the end.
        observe: Wall clock: is shown every message for the launch view.

    Attributes:
        renewed: Called when a node has a new process.
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
    ) -> None:
        self.names = [spec.name for spec in specs]
        self.members = [Member(spec, folder / "log" / f"{spec.name}.log") for spec in specs]
        self.exit_code: int | None = None
        self.renewed: Callable[[], None] = lambda: None
        self._clock = clock
        self._workspace = workspace
        self._folder = folder
        self._server = server
        self._interrupt = interrupt
        self._observe = observe
        self._ending = False
        self._patience_ends_ns = 0
        self._start_ns = 0
        self._replies: dict[int, Done] = {}
        self._lines = Switchboard(
            folder / "supervisor.sock", self.names, (server.descriptor, interrupt.descriptor)
        )

    # Start

    def start(self) -> None:
        """Start every node; return when all are configured and all edges matched.

        Raises:
            NodeError: A node failed or did not get ready in time.
        """
        for member in self.members:
            self._spawn(member)
        self._await(lambda: all(m.configured for m in self.members), "configured")
        self._await(lambda: all(m.matched for m in self.members), "matched with its publishers")

    def _spawn(self, member: Member) -> None:
        birth = NodeProcess(
            spec=member.spec,
            clock=self._clock,
            run_dir=str(self._folder),
            workspace=self._workspace,
        )
        self._server.spawn(birth, str(member.log))

    def _await(self, ready: Callable[[], bool], what: str) -> None:
        deadline_ns = monotonic_ns() + START_TIMEOUT_NS
        while not ready():
            if monotonic_ns() > deadline_ns:
                late = next(
                    m for m in self.members if not (m.configured if what == "configured" else m.matched)
                )
                raise NodeError(late.spec.name, f"was not {what} within {START_TIMEOUT_NS // 10**9} s")
            self._pump(1.0)

    # Lockstep crew

    def activate(self, index: int) -> Done:
        """Activate one node."""
        return self._ask({index: Activate(self._start_ns)})[index]

    def work(self, rounds: Mapping[int, Round]) -> Mapping[int, Done]:
        """Let several nodes do their part of a round, in parallel."""
        return self._ask(rounds)

    def _ask(self, messages: Mapping[int, ToNode]) -> Mapping[int, Done]:
        for index, message in messages.items():
            self._send(index, message)
        asked_ns = monotonic_ns()
        while len(self._replies) < len(messages):
            self._pump(PATIENCE_S)
            if monotonic_ns() - asked_ns > PATIENCE_S * 1e9:
                late = ", ".join(self.names[index] for index in messages if index not in self._replies)
                _LOG.warning("still waiting for %s; Ctrl-C ends the run", late)
                asked_ns = monotonic_ns()
        replies, self._replies = self._replies, {}
        return replies

    def shutdown(self, index: int, now_ns: int) -> Done:
        """Bring one node to its safe state and end it; one that does not answer is left to :meth:`close`."""
        member = self.members[index]
        if not self._ending:
            self._ending = True
            self._patience_ends_ns = monotonic_ns() + LADDER_STEP_NS
        if not self._lines.connected(index) or member.ended:
            return Done([], -1, None)
        self._replies.clear()
        with contextlib.suppress(NodeError, GraphError, LinkClosed):
            self._lines.send(index, Shutdown(now_ns))
            while not member.ended and monotonic_ns() < self._patience_ends_ns:
                self._pump(0.2)
        return self._replies.pop(index, Done([], -1, None))

    def _send(self, index: int, message: ToNode) -> None:
        try:
            self._lines.send(index, message)
        except LinkClosed:
            self._mourn(index)

    # Wall clock

    def run_wall(self, until_ns: int | None = None) -> int:
        """Activate in graph order, then watch until the run ends; return the exit code.

        Raises:
            NodeError: A node failed and its rule does not restart it.
        """
        self._start_ns = monotonic_ns()
        for index, member in enumerate(self.members):
            self._send(index, Activate(self._start_ns))
            member.active = True
        while self.exit_code is None:
            now_ns = monotonic_ns()
            if until_ns is not None and now_ns - self._start_ns >= until_ns:
                return 0
            for index, member in enumerate(self.members):
                if member.respawn_at_ns is not None and now_ns >= member.respawn_at_ns:
                    self._replace(member, now_ns)
                if member.matched and not member.active:
                    self._send(index, Activate(self._start_ns))
                    member.active = True
            self._pump(0.1)
        return self.exit_code

    def _replace(self, member: Member, now_ns: int) -> None:
        """Start a failed node's next process, but never beside the one that has failed."""
        assert member.respawn_at_ns is not None
        if member.ended:
            member.begin()
            self._spawn(member)
        elif now_ns > member.respawn_at_ns + LADDER_STEP_NS:
            self._server.signal(member.pid, signal.SIGKILL)

    # Events

    def _pump(self, timeout_s: float) -> None:
        """Handle what has happened; wait for something if nothing has.

        Raises:
            NodeError: A node failed; the first, when everything that has happened is accounted for.
        """
        heard, others = self._lines.wait(timeout_s)
        failures: list[NodeError] = []
        events = [partial(self._on_message, *said) for said in heard]
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
            if not self._ending:
                self._interrupt.check()
            self._interrupt.drain()

    def _on_message(self, index: int, message: FromNode) -> None:
        member = self.members[index]
        if isinstance(message, Done):
            self._replies[index] = message
        elif isinstance(message, Configured):
            member.configured = True
        elif isinstance(message, Matched):
            member.matched = True
        elif isinstance(message, Relay):
            if message.frame:
                self._observe(monotonic_ns() - self._start_ns, message.frame)
            if message.exit_code is not None and member.spec.shutdown_on_exit:
                self.exit_code = message.exit_code
        elif isinstance(message, Failed) and not self._ending:
            text = message.text.removeprefix(f"{member.spec.name}: ")
            if not self._restart(index, text):
                raise NodeError(member.spec.name, f"{text} (log: {member.log})")

    def _on_news(self, news: News) -> None:
        index = self.names.index(news.name)
        member = self.members[index]
        if isinstance(news, Started):
            member.pid = news.pid
            if member.restart_count:
                self.renewed()
            return
        if news.pid != member.pid:
            return
        member.ended = True
        for message in self._lines.last_words(index):
            self._on_message(index, message)
        if self._ending or member.respawn_at_ns is not None:
            return
        cause = how_it_ended(news.status)
        if not self._restart(index, cause):
            raise NodeError(member.spec.name, f"its process {cause}{member.last_words()}")

    def _mourn(self, index: int) -> None:
        """A line is broken: wait for the news of how the process ended, which raises."""
        while not self.members[index].ended:
            self._pump(1.0)

    def _restart(self, index: int, cause: str) -> bool:
        return self._clock == "wall" and self.members[index].plan_restart(monotonic_ns(), cause)

    # End

    def close(self) -> None:
        """End every process that is left: SIGTERM, 5 s later SIGKILL; return when all are gone."""
        self._ending = True
        for number in (signal.SIGTERM, signal.SIGKILL):
            left = [m for m in self.members if m.pid and not m.ended]
            if not left:
                break
            with contextlib.suppress(GraphError):
                for member in left:
                    self._server.signal(member.pid, number)
                deadline_ns = monotonic_ns() + LADDER_STEP_NS
                while any(not m.ended for m in left) and monotonic_ns() < deadline_ns:
                    self._pump(0.2)
        self._lines.close()
