"""Turn raw EMG into normalised co-contraction, its bursts, and the level of its peaks."""

from dataclasses import fields, replace

import numpy as np

from msgs.emg import CoContraction, EmgBlock
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.perception.emg.bursts import BurstRule, BurstState
from palp_core.palpation.perception.emg.calibration import Calibration, calibrate, look_step
from palp_core.palpation.perception.emg.emg import EmgChain, find_offset
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.emg.settings import (
    BURSTS,
    WINDOW_S,
    BurstSettings,
    LevelRule,
    MvcRule,
)
from palp_core.palpation.perception.emg.stream import CoContractionStream, StreamState
from palp_core.units import Float64Array, RatioNonNegative, Seconds, SecondsPositive

UNSCALED = Calibration((), 1.0, 0.0, 0.0)


class CoContractionParams(Params):
    """Set in the launch file. None of it was published; see :class:`BurstSettings` for what each is.

    ``mvc_rule: sum_of_maxima`` with ``level_rule: peak`` reads levels as eqs. (1) to (3) are printed: the
    scatter of the MVC then makes them some tenth too low.
    """

    window_s: SecondsPositive = WINDOW_S
    mvc_rule: MvcRule = "plateau"
    level_rule: LevelRule = "plateau"
    on_share: RatioNonNegative = BURSTS.on_share
    off_share: RatioNonNegative = BURSTS.off_share
    rest_spreads: RatioNonNegative = BURSTS.rest_spreads
    gap_s: Seconds = BURSTS.gap_s
    least_s: Seconds = BURSTS.least_s
    valley_share: RatioNonNegative = BURSTS.valley_share
    top_share: RatioNonNegative = BURSTS.top_share
    shelf_s: Seconds = BURSTS.shelf_s

    @property
    def bursts(self) -> BurstSettings:
        """What is a burst and a peak."""
        return BurstSettings(**{one.name: getattr(self, one.name) for one in fields(BurstSettings)})


class CoContractionState(State):
    """What a replacement inherits: the stream's memory, and what is known of the muscles.

    ``rest_v`` and ``mvc_v`` are envelopes at every look, a list per muscle.
    """

    phase: str = ""
    phase_count: int = 0
    offsets_v: list[float] = []
    rest_v: list[list[float]] = []
    mvc_v: list[list[float]] = []
    known: Calibration | None = None
    stream: StreamState | None = None
    burst_count: int = 0
    peak_count: int = 0
    level: int = 0


class Cocontraction(Node):
    """Equations (1) to (3), block by block; a burst counts once it has ended, a peak once it has sunk."""

    params: CoContractionParams
    state: CoContractionState
    emg = Sub(EmgBlock)
    cocontraction = Pub(CoContraction)

    @classmethod
    def find_mistakes(cls, params: CoContractionParams, mistakes: Mistakes) -> None:
        with mistakes.of("on_share"):
            params.bursts  # noqa: B018 - it refuses what does not fit together

    @on(emg)
    def process(self, block: EmgBlock) -> None:
        state = self.state
        samples = np.array([block.fds_v, block.edc_v])
        if not state.offsets_v:  # the first block is at rest: it has the electrodes' offset
            state.offsets_v = [find_offset(muscle) for muscle in samples]
        published = block.phase == "palpation" and bool(state.mvc_v)
        if published and state.known is None:
            state.known = self._calibrated(block.rate_hz)
        known = state.known if published and state.known else UNSCALED
        stream = self._stream(block.rate_hz, known)
        before = state.stream or stream.start()
        if block.phase != state.phase:  # no burst spans two phases, and the scale is another
            before, state.phase, state.phase_count = replace(before, bursts=BurstState()), block.phase, 0
        state.stream, out = stream.step(before, samples)
        self._remember(block, out.envelopes)
        if not published:
            return
        state.burst_count += len(out.bursts)
        if out.peaks:
            peak = out.peaks[-1]
            level = peak.level if self.params.level_rule == "plateau" else peak.value
            state.peak_count += len(out.peaks)
            state.level = int(to_levels(np.array([level])).index[0])
        self.cocontraction.publish(
            CoContraction(
                stamp_ns=self.now_ns(),
                start_ns=block.start_ns,
                rate_hz=block.rate_hz,
                reference_v=known.reference,
                value=out.cocontraction,
                burst_count=state.burst_count,
                level=state.level,
                level_defined=state.peak_count > 0,
            )
        )

    def _remember(self, block: EmgBlock, envelopes_v: Float64Array) -> None:
        """Keep the envelopes of rest and MVC, at every look from the phase's begin on."""
        state, step = self.state, look_step(block.rate_hz)
        looks = envelopes_v[:, -state.phase_count % step :: step].tolist()
        state.phase_count += envelopes_v.shape[1]
        if block.phase == "rest":
            state.rest_v = _joined(state.rest_v, looks)
        elif block.phase == "mvc":
            state.mvc_v, state.known = _joined(state.mvc_v, looks), None

    def _calibrated(self, rate_hz: float) -> Calibration:
        state, params, step = self.state, self.params, look_step(rate_hz)
        skip = round(params.window_s * rate_hz) // step  # the first window ramps up from silence
        rest = np.array(state.rest_v)[:, skip:] if state.rest_v else np.zeros((len(state.mvc_v), 0))
        known = rest.shape[1] > 0
        return calibrate(
            np.array(state.mvc_v),
            rest if known else np.array(state.mvc_v),
            rate_hz=rate_hz / step,
            window_s=params.window_s,
            rule=params.mvc_rule,
            rest_known=known,
        )

    def _stream(self, rate_hz: float, known: Calibration) -> CoContractionStream:
        params = self.params
        chains = tuple(EmgChain(o, rate_hz, window_s=params.window_s) for o in self.state.offsets_v)
        rule = BurstRule.of(rate_hz, known, params.bursts)
        return CoContractionStream(chains, known.reference, rule)


def _joined(before: list[list[float]], more: list[list[float]]) -> list[list[float]]:
    return [a + b for a, b in zip(before, more, strict=True)] if before else more
