"""Processes beside those that have the nodes' parts: successors before a swap, predecessors after it."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

from palp_core.graph.description.node_class import DescribeRequest, NodeDescription
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.spec import NodeSpec
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage
from palp_core.graph.process.control_messages import Configured, Failed, FromNode, Matched
from palp_core.graph.supervision.channel_server import Switchboard
from palp_core.graph.supervision.fork_client import ForkServer
from palp_core.graph.supervision.fork_server import LOOKING, Describe, News, Started
from palp_core.graph.supervision.managed_process import Member, how_it_ended


class Understudy:
    """One such process.

    Attributes:
        number: Of its line.
        member: The process.
        said: What it has said and nobody has taken yet.
        failure: Why it cannot go on; "" while it can.
        on_end: Called when its process has ended.
    """

    def __init__(self, number: int, member: Member) -> None:
        self.number, self.member = number, member
        self.said: list[FromNode] = []
        self.failure = ""
        self.on_end: Callable[[], None] = lambda: None

    def hear(self, message: FromNode) -> None:
        """Take what it says."""
        if isinstance(message, Configured):
            self.member.configured = True
        elif isinstance(message, Matched):
            self.member.matched = True
        elif isinstance(message, Failed):
            self.failure = message.text.removeprefix(f"{self.member.spec.name}: ")
        else:
            self.said.append(message)


class Understudies:
    """All of them.

    Args:
        folder: The run directory.
        server: Parent of the processes.
        lines: To all processes.
        spawn: Starts a member's process.

    Attributes:
        described: What :meth:`look` has found; None while it looks.
    """

    def __init__(
        self,
        folder: Path,
        server: ForkServer,
        lines: Switchboard,
        spawn: Callable[..., None],
    ) -> None:
        self._folder, self._server, self._lines, self._spawn = folder, server, lines, spawn
        self._count = 0
        self._all: dict[int, Understudy] = {}
        self._answer = folder
        self._looks = self._looker = 0
        self.described: list[NodeDescription] | None = None

    def start(self, spec: NodeSpec, log: Path, *, fresh: bool) -> Understudy:
        """Start a process beside the one that has the node's part."""
        self._count += 1
        member = Member(spec, log, f"+{self._count}")
        understudy = Understudy(self._lines.expect(member.place), member)
        self._all[understudy.number] = understudy
        self._spawn(member, successor=True, fresh=fresh)
        return understudy

    def look(self, requests: Sequence[DescribeRequest], workspace: Path) -> None:
        """Let a child describe node classes; :attr:`described` is set when it has ended."""
        self._looks += 1
        self.described, self._looker = None, 0
        self._answer = self._folder / f"description{self._looks}"
        self._server.send(Describe(list(requests), str(workspace), str(self._answer)))

    def look_away(self) -> None:
        """Wait for the child no longer, and end it."""
        if self._looker:
            self._server.signal(self._looker, signal.SIGKILL)
        self._looker = 0

    def _looked(self, status: int) -> None:
        log = Path(f"{self._answer}.log")
        if self._answer.exists():
            self.described = decode_any(list[NodeDescription], self._answer.read_bytes())
        else:
            said = log.read_text(errors="replace").strip().splitlines()[-3:]
            text = f"looking at the class ended with status {status}: " + " | ".join(said)
            self.described = [NodeDescription(run="", error=text)]
        for file in (self._answer, log):
            file.unlink(missing_ok=True)

    def exchange(self, index: int, member: Member, understudy: Understudy) -> Member:
        """Give an understudy a node's part, and the one who had it the understudy's; return the new one."""
        self._lines.exchange(index, understudy.number)
        new, understudy.member = understudy.member, member
        return new

    def send(self, understudy: Understudy, line: ChannelMessage) -> None:
        """Say something to one; of one that is gone the fork server tells."""
        with contextlib.suppress(ChannelClosed):
            self._lines.send(understudy.number, line)  # type: ignore[arg-type]

    def hear(self, number: int, message: FromNode) -> bool:
        """Take what a process says; return False if it is none of these."""
        understudy = self._all.get(number)
        if understudy is not None:
            understudy.hear(message)
        return understudy is not None

    def take(self, news: News) -> bool:
        """Take news of a process; return False if it is none of these."""
        if news.name == LOOKING:
            if isinstance(news, Started):
                self._looker = news.pid
            elif news.pid == self._looker:
                self._looked(news.status)
            return True
        for number, understudy in self._all.items():
            member = understudy.member
            if isinstance(news, Started):
                if news.name == member.place and not member.pid:
                    member.pid = news.pid
                    return True
            elif news.pid == member.pid:
                member.ended = True
                for message in self._lines.last_words(number):
                    understudy.hear(message)
                understudy.failure = understudy.failure or f"its process {how_it_ended(news.status)}"
                del self._all[number]
                understudy.on_end()
                return True
        return False

    def kill(self, understudy: Understudy) -> None:
        """End one at once: it has nothing to lose."""
        if understudy.member.pid and not understudy.member.ended:
            self._server.signal(understudy.member.pid, signal.SIGKILL)

    @property
    def members(self) -> list[Member]:
        """Those whose processes live."""
        return [understudy.member for understudy in self._all.values()]
