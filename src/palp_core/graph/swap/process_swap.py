"""A swap between two processes, make before break: each step can fail, and then the old one goes on.

Until the new process is told :class:`Go` it publishes nothing, so that there is one owner at every instant.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import msgspec

from palp_core.errors import GraphError, NodeError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.node_class import DescribeRequest, NodeDescription
from palp_core.graph.messages.message import decode_any
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.loading import endpoints
from palp_core.graph.process.channel import ChannelMessage
from palp_core.graph.process.control_messages import Done
from palp_core.graph.process.swap_messages import (
    Announced,
    EndShadow,
    Go,
    HandedIn,
    HandIn,
    Leave,
    Meet,
    Met,
    Place,
    Rehearse,
    Rehearsed,
    Resume,
    Shadow,
    Shadowed,
    Stay,
    TakeOver,
    TookOver,
    Working,
)
from palp_core.graph.supervision.standby import Understudy
from palp_core.graph.supervision.supervisor import Supervisor
from palp_core.graph.swap.swap import Replacement, SwapFailed, SwapReport, unfit
from palp_core.graph.transport.offsets import ReceivedOffsets

Answer = TypeVar("Answer", bound=ChannelMessage)


class SwapTalk:
    """One swap's words with the process that has the node's part and the one that is to get it.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        replacement: What is replaced by what.
        now_ns: Time on the graph's clock.
        elapse: Lets so much simulated time go by.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        folder: Path,
        replacement: Replacement,
        now_ns: int,
        elapse: Callable[[int], None],
    ) -> None:
        self._elapse = elapse
        self._supervisor, self._folder, self._replacement = supervisor, folder, replacement
        self._index, self._now_ns = replacement.index, now_ns
        self._old = supervisor.members[replacement.index]
        self._begun_ns = monotonic_ns()
        self._deadline_ns = self._begun_ns + round(replacement.request.timeout_s * 1e9)
        self._step = "start"
        self._new: Understudy | None = None
        self._announced = self._paused = False
        self._found: dict[str, Any] = {}

    def _fail(self, text: str) -> NoReturn:
        raise SwapFailed(self._replacement.request.node, self._step, text)

    def _hand_in(self, after: dict[str, tuple[int, int]], *, pause: bool) -> HandedIn:
        self._say_old(HandIn(after, pause))
        return self._from_old(HandedIn)

    def _say_old(self, line: ChannelMessage) -> None:
        self._supervisor.answers.pop(self._index, None)
        self._supervisor.say(self._index, line)

    def _say_new(self, line: ChannelMessage) -> None:
        assert self._new is not None
        self._new.said.clear()
        self._supervisor.understudies.send(self._new, line)

    def _from_old(self, kind: type[Answer]) -> Answer:
        answers, index = self._supervisor.answers, self._index
        self._until(lambda: index in answers, f"the old node did not answer ({kind.__name__})")
        answer = answers.pop(index)
        assert isinstance(answer, kind)
        return answer

    def _from_new(self, kind: type[Answer]) -> Answer:
        new = self._new
        assert new is not None

        def fitting() -> list[Answer]:
            return [said for said in new.said if isinstance(said, kind)]

        self._until(lambda: bool(fitting()), f"the new node did not answer ({kind.__name__})")
        return fitting()[0]

    def _until(self, so: Callable[[], bool], otherwise: str) -> None:
        """Wait for something.

        Raises:
            SwapFailed: One of the processes has ended, or the time is over.
        """
        old, new = self._old, self._new

        def over() -> bool:
            gone = (old.ended and not old.handed_in) or old.respawn_at_ns is not None
            return so() or gone or (new is not None and bool(new.failure))

        in_time = self._supervisor.follow(over, self._deadline_ns)
        if so():
            return
        if not in_time:
            self._fail(f"{otherwise} within {self._replacement.request.timeout_s:g} s")
        if new is not None and new.failure:
            self._fail(new.failure)
        self._fail("the old node has ended")


SEE_OFF_NS = 1_000_000_000
LINGER_NS = 60_000_000_000
"""How long an old process stays for a reader that is stopped or slow (assumed)."""


class ProcessSwaps:
    """The swaps of a graph of processes.

    Args:
        supervisor: Has the processes.
        folder: The run directory.
        workspace: Folder that holds ``nodes/``.
        elapse: Lets so much simulated time go by.
    """

    def __init__(
        self, supervisor: Supervisor, folder: Path, workspace: Path, elapse: Callable[[int], None]
    ) -> None:
        self._supervisor, self._folder, self._workspace = supervisor, folder, workspace
        self._elapse = elapse

    def describe_class(self, request: DescribeRequest, timeout_s: float) -> NodeDescription:
        """Let a forked child import a class and say what it declares."""
        understudies = self._supervisor.understudies
        understudies.look([request], self._workspace)
        deadline_ns = monotonic_ns() + round(timeout_s * 1e9)
        if not self._supervisor.follow(lambda: understudies.described is not None, deadline_ns):
            understudies.look_away()
            error = f"it could not be imported within {timeout_s:g} s"
            return NodeDescription(run=request.run, error=error)
        assert understudies.described is not None
        return understudies.described[0]

    def swap(self, replacement: Replacement, now_ns: int) -> tuple[SwapReport, Done | None]:
        """Let a new process take the place of a node's.

        Raises:
            SwapFailed: A step failed; the old node goes on.
        """
        return _Swap(self._supervisor, self._folder, replacement, now_ns, self._elapse).run()


class _Swap(SwapTalk):
    """One swap, step by step."""

    def run(self) -> tuple[SwapReport, Done | None]:
        if not self._old.matched or self._old.ended or self._old.respawn_at_ns is not None:
            self._fail("the node is not up just now; ask again when it is")
        try:
            after = self._prepare()
            if self._replacement.request.shadow_s:
                after = self._shadow(after)
            if self._replacement.request.dry_run:
                self._take_back()
                return self._report(None, 0), None
            return self._change(after)
        except BaseException:
            self._take_back()
            raise

    # Steps

    def _prepare(self) -> ReceivedOffsets:
        """Bring a new process as far as it comes while the old one works."""
        running = decode_any(HandOver, self._hand_in({}, pause=False).hand_over)
        if why := unfit(running, self._replacement):
            self._fail(why)
        self._step = "configure"
        supervisor, new_spec = self._supervisor, self._replacement.new
        self._new = supervisor.understudies.start(new_spec, self._old.log, fresh=True)
        new = self._new.member
        self._until(lambda: new.configured, "it was not configured")
        self._until(lambda: new.matched, "it did not hear all of its publishers")
        self._step = "connect"
        self._announced = True
        publish, serve = endpoints(str(self._folder), new.place)
        supervisor.listening.clear()
        self._say_old(Place(publish, serve))
        readers = self._from_old(Announced).readers
        if supervisor.start_ns:
            self._await_readers(publish)
        self._say_new(Meet(readers))
        self._from_new(Met)  # who did not come is no node of this graph, and can ask for what it missed
        self._step = "state"
        handed = self._hand_in({}, pause=False)
        self._say_new(Rehearse(handed.hand_over, self._replacement.request.params))
        rehearsed = self._from_new(Rehearsed)
        if rehearsed.error:
            self._fail(rehearsed.error)
        return rehearsed.after

    def _await_readers(self, publish: str) -> None:
        """Wait until the graph's own readers listen at the new place; others can ask for what they miss."""
        supervisor, checked = self._supervisor, self._replacement.checked
        wanted = {
            (supervisor.names.index(reader), name, publish)
            for name, ends in checked.edges.items()
            if name.split("/")[1] == self._replacement.request.node
            for reader, _ in ends
            if reader in supervisor.names and supervisor.members[supervisor.names.index(reader)].active
        }
        deaf = {f"/{supervisor.names[index]}" for index, _, _ in wanted}
        text = (
            f"not every reader listened at the new place; one is stopped or busy: {', '.join(sorted(deaf))}"
        )
        self._until(lambda: wanted <= supervisor.listening, text)

    def _shadow(self, after: ReceivedOffsets) -> ReceivedOffsets:
        """Let both work for a while, and only the old one be heard; return up to where the new one heard."""
        self._step = "shadow"
        request, supervisor, new = self._replacement.request, self._supervisor, self._new
        assert new is not None
        handed = self._hand_in(after, pause=False)
        start_ns = supervisor.start_ns
        publish = endpoints(str(self._folder), self._old.place)[0] if start_ns else ""
        self._say_new(Shadow(handed.hand_over, request.params, start_ns, publish))
        taken = self._from_new(TookOver)
        if taken.error:
            self._fail(taken.error)
        duration_ns = round(request.shadow_s * 1e9)
        self._deadline_ns += duration_ns
        if start_ns:
            end_ns = monotonic_ns() + duration_ns
            supervisor.follow(lambda: bool(new.failure) or self._old.ended, end_ns)
        else:
            comparison = self._replacement.comparison(decode_any(HandOver, handed.hand_over).published)
            begun_ns = monotonic_ns()
            supervisor.shadow = (self._index, new, comparison)
            try:
                self._elapse(duration_ns)
            finally:
                supervisor.shadow = None
            self._deadline_ns += monotonic_ns() - begun_ns
            self._now_ns += duration_ns
            self._found = comparison.report()
        self._say_new(EndShadow())
        shadowed = self._from_new(Shadowed)
        if shadowed.report:
            self._found = msgspec.json.decode(shadowed.report)
        return shadowed.after

    def _change(self, after: ReceivedOffsets) -> tuple[SwapReport, Done | None]:
        request = self._replacement.request
        self._step = "hand over"
        self._paused = True
        handed = self._hand_in(after, pause=True)
        self._old.handed_in = True
        self._step = "take over"
        start_ns = self._supervisor.start_ns
        self._say_new(TakeOver(handed.hand_over, request.params, start_ns, handed.remembered))
        taken = self._from_new(TookOver)
        if taken.error:
            self._fail(taken.error)
        assert self._new is not None
        if start_ns:
            self._now_ns = handed.at_ns - start_ns
        runs = {"before": self._replacement.old.run, "after": self._replacement.new.run}
        record = {"at_s": self._now_ns / 1e9, **runs}
        new, self._new = self._new, None  # from here on there is no way back
        self._supervisor.understudies.send(new, Go(record, handed.at_ns if start_ns else 0))
        self._supervisor.promote(self._index, new)
        working = self._working()
        self._see_off(new)
        done = Done([*handed.frames, *taken.frames], taken.next_due_ns, None)
        held = taken.held if working is None else int(str(working.record["held"]))
        return self._report(working, held), done

    def _report(self, working: Working | None, held: int) -> SwapReport:
        lockstep = not self._supervisor.start_ns
        gap_s = 0.0 if working is None else float(str(working.record["gap_s"]))
        return self._replacement.report(
            at_ns=self._now_ns,
            gap_s=gap_s,
            held=held,
            duration_s=0.0 if lockstep else (monotonic_ns() - self._begun_ns) / 1e9,
            shadow=self._found,
        )

    def _working(self) -> Working | None:
        """Wait until the new node is at work; if it fails now, that is a failure of the node as any other."""
        supervisor, index = self._supervisor, self._index
        member = supervisor.members[index]
        answered = lambda: isinstance(supervisor.answers.get(index), Working) or member.ended  # noqa: E731
        supervisor.follow(answered, monotonic_ns() + SEE_OFF_NS)
        answer = supervisor.answers.pop(index, None)
        return answer if isinstance(answer, Working) else None

    def _see_off(self, former: Understudy) -> None:
        """Let the old process end; whoever looks for the node by its name is led to the new one.

        It stays as long as a reader has not had all that it published, but nobody waits for that.
        """
        supervisor = self._supervisor
        supervisor.understudies.send(former, Leave(LINGER_NS))
        former.on_end = self._lead(former.member.place, supervisor.members[self._index].place)
        supervisor.follow(lambda: former.member.ended, monotonic_ns() + SEE_OFF_NS)
        former.on_end()

    def _lead(self, before: str, place: str) -> Callable[[], None]:
        node, folder, members, index = (
            self._replacement.request.node, self._folder, self._supervisor.members, self._index
        )  # fmt: skip

        def lead() -> None:
            if members[index].place != place:
                return  # it has changed hands again
            for end in ("pub", "srv"):
                link = folder / f"+{node}.{end}.link"
                link.unlink(missing_ok=True)
                link.symlink_to(f"{place}.{end}")
                link.replace(folder / f"{node}.{end}")
                if before != node:
                    (folder / f"{before}.{end}").unlink(missing_ok=True)

        return lead

    def _take_back(self) -> None:
        """Leave all as it was; a new process has said nothing to anybody yet."""
        supervisor = self._supervisor
        if self._new is not None:
            supervisor.understudies.kill(self._new)
        if self._paused:
            self._say_old(Resume())
        if self._announced:
            self._say_old(Stay())
        new = self._new
        if new is not None:
            with contextlib.suppress(NodeError, GraphError):  # the swap's own failure is the news
                supervisor.follow(lambda: new.member.ended, monotonic_ns() + SEE_OFF_NS)
            for end in ("pub", "srv"):
                (self._folder / f"{new.member.place}.{end}").unlink(missing_ok=True)
        if self._old.handed_in:
            self._old.handed_in = False
            if self._old.ended:
                supervisor.lose(self._index, "its process ended while its successor failed")
