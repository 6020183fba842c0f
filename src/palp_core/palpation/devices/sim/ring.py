"""A simulated anchor-ring actuator: finite speed, and a landing error that stays until it moves again."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import msgspec
import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import RingReading
from palp_core.palpation.devices.sim import Simulated

_NS = 1e9
_NO_LOAD_M_PER_S = 6.5e-3  # L12-50-210-06: no-load speed of the maker's present data sheet


class SimRingState(msgspec.Struct):
    """The move under way or, when its time is over, where the ring rests.

    Attributes:
        homed: Whether the actuator was brought up.
        holding: Whether it was stopped on its way, so that its target is not where it is.
        target_m: What was last commanded.
        error_m: Where the ring lands minus its target: the last draw and the backlash, within the stops.
        start_ns: When the move starts.
        after_s: Times of the corners of the move after ``start_ns``.
        nominal_m: Positions at the corners, as the actuator itself takes them to be.
        true_m: Positions at the corners, in truth.
        settled_ns: When it is at rest.
    """

    homed: bool = False
    holding: bool = False
    target_m: float = 0.0
    error_m: float = 0.0
    start_ns: int = 0
    after_s: list[float] = msgspec.field(default_factory=lambda: [0.0])
    nominal_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
    true_m: list[float] = msgspec.field(default_factory=lambda: [0.0])
    settled_ns: int = 0


@dataclass(frozen=True)
class SimRing(Simulated):
    """Parameters of an actuator like the Actuonix L12-50-210-06-I.

    Attributes:
        speed_m_per_s: Speed of travel (5 mm/s: the no-load speed of older data sheets, below the present 6.5
            mm/s).
        settle_s: Time from arrival to rest (assumed).
        repeatability_m: Repeatability r of the landing (data sheet: +-0.3 mm); how it is read is the next
            parameter.
        distribution: ``uniform`` reads +-r as hard limits, an error in [-r, r] all alike; ``normal`` as the
            band of 95 %, a standard deviation of r / 2.
        backlash_m: Play; the ring lags by half of it behind the direction it came from (0: not known).
        zero_m: Retracted stop to the ring's zero, so that small errors do not hit the stop (assumed).
        stroke_m: Stop to stop (data sheet: 50 mm).
        feedback_step_m: Step of the measured position (50 mm in 675 counts, 0.074 mm); 0 for none.
        error_seen: Share of the landing error that the measured position shows (assumed 0: the actuator is
            servoed to the same potentiometer, whose reading agrees with the target wherever the ring is).
    """

    state_type: ClassVar[type[SimRingState]] = SimRingState

    speed_m_per_s: float = 5.0e-3
    settle_s: float = 0.2
    repeatability_m: float = 0.3e-3
    distribution: Literal["uniform", "normal"] = "uniform"
    backlash_m: float = 0.0
    zero_m: float = 1.0e-3
    stroke_m: float = 0.050
    feedback_step_m: float = 0.050 / 675
    error_seen: float = 0.0

    def __post_init__(self) -> None:
        check_range("ring", "speed_m_per_s", self.speed_m_per_s, 1e-6, _NO_LOAD_M_PER_S)
        check_range("ring", "settle_s", self.settle_s, 0.0, 60.0)
        check_range("ring", "stroke_m", self.stroke_m, 1e-6, 1.0)
        for name in ("repeatability_m", "backlash_m", "zero_m", "feedback_step_m"):
            check_range("ring", name, getattr(self, name), 0.0, self.stroke_m)
        check_range("ring", "error_seen", self.error_seen, 0.0, 1.0)
        if self.distribution not in ("uniform", "normal"):
            raise DeviceError(f"ring: no distribution '{self.distribution}'; known: normal, uniform")

    @property
    def limits_m(self) -> tuple[float, float]:
        """Smallest and largest target: zero, and the extended stop."""
        return 0.0, self.stroke_m - self.zero_m

    def open(self, now_ns: int, state: SimRingState, rng: np.random.Generator) -> None:
        """Bring a fresh actuator to 0, with an error of its own; leave one that was homed before as it is."""
        if not state.homed:
            landing_m = self._landing(0.0, 1.0, rng)
            state.target_m, state.error_m = 0.0, landing_m
            self._follow(state, now_ns, [0.0], [landing_m])
            state.settled_ns = now_ns
            state.homed = True

    def command(self, target_m: float, now_ns: int, state: SimRingState, rng: np.random.Generator) -> int:
        """Go to ``target_m`` with a new landing error; the present target is no move and keeps its error."""
        self._refuse_unless_homed(state)
        check_range("ring", "target_m", target_m, *self.limits_m)
        if target_m == state.target_m and not state.holding:
            return state.settled_ns
        nominal_m, true_m = self._corners_now(now_ns, state)
        direction = math.copysign(1.0, target_m - nominal_m)
        return self._go(target_m, direction, now_ns, state, [nominal_m], [true_m], rng)

    def rehome(self, now_ns: int, state: SimRingState, rng: np.random.Generator) -> int:
        """Drive to the retracted stop and back to the target, with a new landing error."""
        self._refuse_unless_homed(state)
        nominal_m, true_m = self._corners_now(now_ns, state)
        return self._go(
            state.target_m, 1.0, now_ns, state, [nominal_m, -self.zero_m], [true_m, -self.zero_m], rng
        )

    def stop(self, now_ns: int, state: SimRingState) -> None:
        """Hold where it is; the next command is a move even if its target is the same."""
        if now_ns < state.start_ns + math.ceil(state.after_s[-1] * _NS):
            nominal_m, true_m = self._corners_now(now_ns, state)
            self._follow(state, now_ns, [nominal_m], [true_m])
            state.holding = True
            state.settled_ns = now_ns

    def read(self, now_ns: int, state: SimRingState) -> RingReading:
        """Return target, measured position and whether it rests at the target."""
        nominal_m, true_m = self._corners_now(now_ns, state)
        measured_m = nominal_m + self.error_seen * (true_m - nominal_m)
        if self.feedback_step_m > 0.0:
            counts = round((measured_m + self.zero_m) / self.feedback_step_m)
            measured_m = counts * self.feedback_step_m - self.zero_m
        settled = state.homed and not state.holding and now_ns >= state.settled_ns
        return RingReading(state.target_m, measured_m, settled)

    def true_position_m(self, now_ns: int, state: SimRingState) -> float:
        """Return where the ring is, which a real actuator does not know, in m."""
        return self._corners_now(now_ns, state)[1]

    def _refuse_unless_homed(self, state: SimRingState) -> None:
        if not state.homed:
            raise DeviceError("ring: not homed; open it before the first move")

    def _landing(self, target_m: float, direction: float, rng: np.random.Generator) -> float:
        """Return where a move to the target ends in truth: one draw, half of the play, and the stops."""
        if self.distribution == "normal":
            error_m = self.repeatability_m / 2.0 * float(rng.standard_normal())
        else:
            error_m = self.repeatability_m * float(rng.uniform(-1.0, 1.0))
        landing_m = target_m + error_m - direction * self.backlash_m / 2.0
        return min(max(landing_m, -self.zero_m), self.stroke_m - self.zero_m)

    def _go(
        self,
        target_m: float,
        direction: float,
        now_ns: int,
        state: SimRingState,
        nominal_m: list[float],
        true_m: list[float],
        rng: np.random.Generator,
    ) -> int:
        """Move through the corners given to the target and the error drawn for it."""
        state.target_m = target_m
        landing_m = self._landing(target_m, direction, rng)
        state.error_m = landing_m - target_m
        self._follow(state, now_ns, [*nominal_m, target_m], [*true_m, landing_m])
        state.holding = False
        state.settled_ns = now_ns + math.ceil((state.after_s[-1] + self.settle_s) * _NS)
        return state.settled_ns

    def _follow(self, state: SimRingState, now_ns: int, nominal_m: list[float], true_m: list[float]) -> None:
        """Write a path into the state; a leg lasts as long as the longer of its two ways at full speed."""
        after_s = [0.0]
        for leg in range(1, len(true_m)):
            way_m = max(abs(nominal_m[leg] - nominal_m[leg - 1]), abs(true_m[leg] - true_m[leg - 1]))
            after_s.append(after_s[-1] + way_m / self.speed_m_per_s)
        state.start_ns, state.after_s, state.nominal_m, state.true_m = now_ns, after_s, nominal_m, true_m

    def _corners_now(self, now_ns: int, state: SimRingState) -> tuple[float, float]:
        """Return nominal and true position at a time, straight between the corners."""
        gone_s = (now_ns - state.start_ns) / _NS
        if gone_s <= 0.0 or len(state.after_s) == 1:
            return state.nominal_m[0], state.true_m[0]
        for leg in range(1, len(state.after_s)):
            before_s, until_s = state.after_s[leg - 1], state.after_s[leg]
            if gone_s < until_s:
                share = (gone_s - before_s) / (until_s - before_s)
                return (
                    state.nominal_m[leg - 1] + share * (state.nominal_m[leg] - state.nominal_m[leg - 1]),
                    state.true_m[leg - 1] + share * (state.true_m[leg] - state.true_m[leg - 1]),
                )
        return state.nominal_m[-1], state.true_m[-1]
