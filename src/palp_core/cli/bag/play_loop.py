"""Play a bag as time goes by, follow the keys, show how far it is."""

import select
import sys
from collections.abc import Mapping

from palp_core.cli.keyboard import Keyboard, standard_input
from palp_core.graph.bag.reader import RecordedMessage
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.messages.message import Message, encode
from palp_core.graph.replay.play import PlaySink
from palp_core.graph.replay.playback import Playback
from palp_core.units import Nanoseconds

CLOCK_TOPIC = "/player/clock"
FASTER = 1.1
BACK_NS = 5_000_000_000
LONGEST_WAIT_S = 0.1
SHOW_NS = 100_000_000
BAR = 30
SLICE = 100  # messages that are due at once, before anybody who asks is answered


class BagClock(Message):
    """What time it is in a bag that is played."""

    stamp_ns: Nanoseconds
    rate: float
    paused: bool


class PlayLoop:
    """Hands each message to the sink when it is due."""

    def __init__(
        self, playback: Playback, sink: PlaySink, names: Mapping[str, str], *, clock_hz: float, keys: bool
    ) -> None:
        self._playback, self._sink, self._names = playback, sink, names
        self._keyboard = Keyboard(standard_input() if keys else None)
        self._clock_ns = round(1e9 / clock_hz) if clock_hz else 0
        self._next_clock_ns = self._next_show_ns = 0
        self._ended, self._waiting = False, True
        self._shown = sys.stderr.isatty()

    def run(self, *, delay_s: float = 0.0, readers: int = 0) -> None:
        with self._keyboard:
            begin_ns = monotonic_ns() + round(delay_s * 1e9)
            while not self._ended and (monotonic_ns() < begin_ns or self._sink.reader_count() < readers):
                self._wait(begin_ns if monotonic_ns() < begin_ns else None)
            self._waiting = False
            self._playback.start(monotonic_ns())
            while not (self._playback.finished or self._ended):
                self._publish_due()
                self._wait(self._playback.due_ns())
            self._show(monotonic_ns(), last=True)

    def _publish_due(self) -> None:
        playback = self._playback
        for _ in range(SLICE):
            due_ns, now_ns = playback.due_ns(), monotonic_ns()
            if due_ns is None or due_ns > now_ns:
                return
            self._publish(playback.next_due(now_ns))

    def _publish(self, message: RecordedMessage) -> None:
        self._sink.publish(self._names[message.stream.topic.name], message.payload)

    def _wait(self, until_ns: int | None) -> None:
        """Until then (None: for a while) answer who asks and follow the keys."""
        now_ns = monotonic_ns()
        if self._clock_ns and now_ns >= self._next_clock_ns:
            self._next_clock_ns = now_ns + self._clock_ns
            position_ns = self._playback.position_ns(now_ns)
            clock = BagClock(stamp_ns=position_ns, rate=self._playback.rate, paused=self._playback.paused)
            self._sink.publish(CLOCK_TOPIC, encode(clock))
        if self._shown and now_ns >= self._next_show_ns:
            self._next_show_ns = now_ns + SHOW_NS
            self._show(now_ns)
        more = self._sink.poll()
        keys = self._keyboard.file_descriptors
        timeout_s = LONGEST_WAIT_S
        if self._clock_ns:
            timeout_s = min(timeout_s, (self._next_clock_ns - monotonic_ns()) / 1e9)
        if until_ns is not None:
            timeout_s = min(timeout_s, (until_ns - monotonic_ns()) / 1e9)
        if more:
            timeout_s = 0.0
        ready = select.select((*keys, *self._sink.file_descriptors), (), (), max(timeout_s, 0.0))[0]
        if keys and keys[0] in ready:
            for key in self._keyboard.read():
                self._on_key(key, monotonic_ns())

    def _on_key(self, key: str, now_ns: int) -> None:
        playback = self._playback
        match key:
            case " ":
                playback.toggle(now_ns)
            case "right":
                if (message := playback.step(now_ns)) is not None:
                    self._publish(message)
            case "left":
                playback.seek(playback.position_ns(now_ns) - BACK_NS, now_ns)
            case "up":
                playback.set_rate(playback.rate * FASTER, now_ns)
            case "down":
                playback.set_rate(playback.rate / FASTER, now_ns)
            case "q":
                self._ended = True
            case _ if key.isdecimal() and key.isascii():
                span_ns = playback.end_ns - playback.begin_ns
                playback.seek(playback.begin_ns + span_ns * int(key) // 10, now_ns)

    def _show(self, now_ns: int, *, last: bool = False) -> None:
        if not self._shown:
            return
        playback = self._playback
        at_ns, span_ns = playback.position_ns(now_ns) - playback.begin_ns, playback.end_ns - playback.begin_ns
        filled = BAR if not span_ns else BAR * at_ns // span_ns
        state = "waiting" if self._waiting else "paused" if playback.paused else "playing"
        sys.stderr.write(
            f"\r\x1b[K[{'=' * filled}{' ' * (BAR - filled)}] {at_ns / 1e9:.1f} of {span_ns / 1e9:.1f} s, "
            f"{playback.rate:.3g} times real time, {state}" + ("\n" if last else "")
        )
        sys.stderr.flush()
