"""Ask for one angle after the other."""

from __future__ import annotations

from msgs.pendulum import Reference
from palp_core import Node, Params, Pub, State, every
from palp_core.units import Count, HertzPositive, Radians


class SourceParams(Params):
    """Set in the launch file: the angles, and how often there is another one."""

    angles_rad: tuple[Radians, ...] = (0.0, 0.3, -0.3, 0.3, 0.0)
    rate_hz: HertzPositive = 0.5


class SourceState(State):
    """What a replacement inherits."""

    place: Count = 0


class Source(Node):
    """Publish one angle after the other; once the last one has had its time the run ends."""

    params: SourceParams
    state: SourceState
    reference = Pub(Reference)

    def on_activate(self) -> None:
        self._ask()

    @every("rate_hz")
    def ask_next(self) -> None:
        self.state.place += 1
        if self.state.place < len(self.params.angles_rad):
            self._ask()
        else:
            self.finish()

    def _ask(self) -> None:
        angle_rad = self.params.angles_rad[self.state.place]
        self.reference.publish(Reference(stamp_ns=self.now_ns(), angle_rad=angle_rad))
