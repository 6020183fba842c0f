"""Play a bag as time goes by, follow the keys, show how far it is."""

import select
import sys

from palp_core.cli.keyboard import Keyboard, standard_input
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.replay.play import Playback, PlayRun

FASTER = 1.1
LONGEST_WAIT_S = 0.1
SHOW_NS = 100_000_000
BAR = 30


class PlayLoop:
    """Has the players publish what is due.

    Args:
        playback: The players.
        run: The run that they are; None: they play into another graph.
        keys: Follow the keyboard, where there is one.
    """

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
