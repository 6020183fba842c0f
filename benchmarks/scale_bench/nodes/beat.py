"""A node that says something ten times a second and hears another: as idle as nodes at work are."""

from __future__ import annotations

from palp_core import Message, Node, Params, Pub, State, Sub, every, on


class Beat(Message):
    """One of a sequence."""

    index: int


class BeatParams(Params):
    """Set in the launch file."""

    rate_hz: float = 10.0


class Count(State):
    """How many there were."""

    said: int = 0
    heard: int = 0


class Beater(Node):
    """Counts aloud, and listens to its neighbour."""

    params: BeatParams
    state: Count
    beat = Sub(Beat)
    out = Pub(Beat)

    @every("rate_hz")
    def say(self) -> None:
        """Say the next."""
        self.state.said += 1
        self.out.publish(Beat(index=self.state.said))

    @on(beat)
    def hear(self, _: Beat) -> None:
        """Hear one."""
        self.state.heard += 1
