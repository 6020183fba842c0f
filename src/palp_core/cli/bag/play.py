"""``palp bag play``."""

from __future__ import annotations

import contextlib
import select
import signal
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.keyboard import Keyboard, attended, standard_input
from palp_core.cli.options import (
    INTERRUPTED,
    TERMINATED,
    ExcludeRegexOption,
    GraphOption,
    RegexOption,
    argument,
    option,
)
from palp_core.cli.output import note, show
from palp_core.cli.running import find_graph
from palp_core.counted import counted
from palp_core.errors import BagError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.supervision.interrupt import Interrupted

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from palp_core.graph.bag.reader import Bag
    from palp_core.graph.messages.topic import Topic
    from palp_core.graph.replay.play import Playback, PlayRun

FASTER = 1.1
LONGEST_WAIT_S = 0.1
SHOW_NS = 100_000_000
BAR = 30


def _terminate(*_: object) -> None:
    raise Interrupted(signal.SIGTERM)  # within a node's handler, too, as Ctrl-C


def play(
    bag: Annotated[Path, argument("A bag's folder or one of its files.")],
    *,
    rate: Annotated[float, option("Speed factor.", "--rate", "-r", min=0.01, max=1000.0)] = 1.0,
    loop: Annotated[bool, option("Begin again at the end.", "--loop", "-l")] = False,
    delay: Annotated[float, option("Wait S before the start.", "--delay", "-d", min=0.0, metavar="S")] = 0.0,
    start_offset: Annotated[float, option("Skip the first S seconds.", min=0.0, metavar="S")] = 0.0,
    playback_duration: Annotated[float, option("Length to play; below 0: all.", metavar="S")] = -1.0,
    playback_until_sec: Annotated[
        float, option("To this time in the bag; below 0: end.", metavar="S")
    ] = -1.0,
    start_paused: Annotated[bool, option("Wait for the space bar.", "--start-paused", "-p")] = False,
    topics: Annotated[list[str] | None, option("Only this one; repeatable.", "--topics", "-t")] = None,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
    remap: Annotated[
        list[str] | None, option("Another name; repeatable.", "--remap", "-m", metavar="OLD:=NEW")
    ] = None,
    wait_matching: Annotated[
        int, option("Start when N topics have readers.", "--wait-matching-subscriptions", "-w", min=0)
    ] = 0,
    disable_keyboard_controls: Annotated[bool, option("Leave the keyboard alone.")] = False,
    graph: GraphOption = None,
    as_json: Annotated[bool, option("Print the account at the end as JSON.", "--json")] = False,
) -> None:
    """Publish a bag's messages in their order and spacing.

    The recorded nodes appear as a graph of their own called 'play': palp topic, node and top see them. With
    --graph NAME messages go into ports of that graph which take messages from outside instead.

    Keys: space pauses and goes on, up and down change the speed by a tenth, q ends. At the end it
    prints the largest delay.
    """
    from palp_core.graph.bag.reader import Bag, topic_selection
    from palp_core.graph.replay.play import Playback, PlayRun, external_ports, publish_into

    if start_paused and (disable_keyboard_controls or not attended(standard_input())):
        raise BagError(
            "--start-paused needs a keyboard: nothing else ends the pause; see also --delay and -w"
        )
    check_topics(topics or (), bag)
    signal.signal(signal.SIGTERM, _terminate)
    with contextlib.ExitStack() as stack:
        opened = stack.enter_context(Bag(bag))
        names = _names(opened, topic_selection(topics or (), regex, exclude_regex), remap or [])
        described = {new: _renamed(opened, old, new) for old, new in names.items()}
        running = None if graph is None else find_graph(graph, changes=True)
        if running is not None:
            taken = external_ports(running, described)
            left_out = [old for old, new in names.items() if new not in taken]
            if left_out:
                note(f"no port of graph '{graph}' takes {', '.join(left_out)}; they are not played")
            names = {old: new for old, new in names.items() if new in taken}
        playback = Playback(
            opened,
            names,
            rate=rate,
            start_offset_s=start_offset,
            duration_s=playback_duration if playback_duration >= 0 else None,
            until_s=playback_until_sec if playback_until_sec >= 0 else None,
            loop=loop,
        )
        stack.enter_context(playback)
        playback.paused = start_paused
        run = None
        if running is None:
            run = PlayRun(bag, described, playback)
            stack.callback(run.close)
        else:
            playback.send = partial(publish_into, running, described)
        where = "as graph 'play'" if graph is None else f"into graph '{graph}'"
        note(f"{bag}: {counted(len(names), 'topic')}, {where}")
        status = 0
        try:
            loop_ = PlayLoop(playback, run, keys=not disable_keyboard_controls)
            loop_.run(delay_s=delay, readers=wait_matching)
        except KeyboardInterrupt as error:
            status = TERMINATED if isinstance(error, Interrupted) else INTERRUPTED
    max_s, p99_s = playback.lateness.max_ns / 1e9, playback.lateness.percentile_s(99)
    account: dict[str, float] = {"messages": playback.played_count, "topics": len(names)}
    played = f"{counted(playback.played_count, 'message')} of {counted(len(names), 'topic')}"
    lateness = f"never more than {max_s * 1e3:.3f} ms late, 99 % within {p99_s * 1e3:.3f} ms"
    account |= {"late_max_s": max_s, "late_p99_s": p99_s, "interrupted": status != 0}
    show(account, [f"{bag}: played {played}; {lateness}"], as_json=as_json)
    if status:
        raise typer.Exit(status)


def check_topics(topics: Collection[str], *bags: Path) -> None:
    """Check that every topic is in one of the bags."""
    from palp_core.graph.bag.reader import Bag
    from palp_core.graph.problems import hint

    known: set[str] = set()
    for bag in bags if topics else ():
        with Bag(bag) as opened:
            known |= opened.topics().keys()
    for name in topics:
        if name not in known:
            raise BagError(f"{' and '.join(map(str, bags))}: no topic '{name}'{hint(name, known)}")


def _names(bag: Bag, chosen: Callable[[str], bool], remap: list[str]) -> dict[str, str]:
    from palp_core.graph.replay.player import playable

    known = playable(bag)
    if not known:
        raise BagError(f"{bag.path}: no topic /node/port in it that could be played")
    names = {name: name for name in known if chosen(name)}
    if not names:
        raise BagError(f"{bag.path}: no topic of it is chosen; it has: {', '.join(known)}")
    for rule in remap:
        old, separator, new = rule.partition(":=")
        if not separator or len(new.split("/")) != 3 or not new.startswith("/"):
            raise BagError(f"'{rule}' is not a remapping; write /node/port:=/other/port")
        if old not in names:
            raise BagError(f"'{rule}': {old} is not among the topics that are played: {', '.join(names)}")
        names[old] = new
    twice = {new for new in names.values() if list(names.values()).count(new) > 1}
    if twice:
        raise BagError(f"two topics would be called {', '.join(sorted(twice))}; a topic has one publisher")
    return names


def _renamed(bag: Bag, old: str, new: str) -> Topic:
    import msgspec

    return msgspec.structs.replace(bag.topics()[old], name=new)


class PlayLoop:
    """Plays a bag, follows the keys and shows the progress; without a run it plays into another graph."""

    def __init__(self, playback: Playback, run: PlayRun | None, *, keys: bool) -> None:
        self._playback, self._run = playback, run
        self._keyboard = Keyboard(standard_input() if keys else None)
        self._next_show_ns = 0
        self._ended, self._waiting = False, True
        self._shown = sys.stderr.isatty()

    def run(self, *, delay_s: float = 0.0, readers: int = 0) -> None:
        with self._keyboard:
            begin_ns = monotonic_ns() + round(delay_s * 1e9)
            while not self._ended and (monotonic_ns() < begin_ns or not self._has_readers(readers)):
                self._wait(begin_ns if monotonic_ns() < begin_ns else None)
            self._waiting = False
            self._playback.start(monotonic_ns())
            while not (self._playback.finished or self._ended):
                self._playback.play_due(monotonic_ns())
                self._wait(self._playback.due_ns())
            self._show(monotonic_ns(), last=True)

    def _has_readers(self, readers: int) -> bool:
        return self._run is None or self._run.reader_count() >= readers

    def _wait(self, until_ns: int | None) -> None:
        """Until then (None: for a while) answer who asks and follow the keys."""
        now_ns = monotonic_ns()
        if self._shown and now_ns >= self._next_show_ns:
            self._next_show_ns = now_ns + SHOW_NS
            self._show(now_ns)
        more = self._run is not None and self._run.poll(now_ns)
        keys = self._keyboard.file_descriptors
        timeout_s = 0.0 if more else LONGEST_WAIT_S
        if until_ns is not None:
            timeout_s = min(timeout_s, (until_ns - monotonic_ns()) / 1e9)
        others = () if self._run is None else self._run.file_descriptors
        ready = select.select((*keys, *others), (), (), max(timeout_s, 0.0))[0]
        if keys and keys[0] in ready:
            for key in self._keyboard.read():
                self._on_key(key, monotonic_ns())

    def _on_key(self, key: str, now_ns: int) -> None:
        playback = self._playback
        match key:
            case " ":
                playback.toggle(now_ns)
            case "up":
                playback.set_rate(playback.rate * FASTER, now_ns)
            case "down":
                playback.set_rate(playback.rate / FASTER, now_ns)
            case "q":
                self._ended = True

    def _show(self, now_ns: int, *, last: bool = False) -> None:
        if not self._shown:
            return
        playback = self._playback
        at_ns = 0 if self._waiting else playback.position_ns(now_ns)
        filled = BAR * at_ns // max(playback.span_ns, 1)
        state = "waiting" if self._waiting else "paused" if playback.paused else "playing"
        sys.stderr.write(
            f"\r\x1b[K[{'=' * filled}{' ' * (BAR - filled)}] {at_ns / 1e9:.1f} of "
            f"{playback.span_ns / 1e9:.1f} s, {playback.rate:.3g} times real time, {state}"
            + ("\n" if last else "")
        )
        sys.stderr.flush()
