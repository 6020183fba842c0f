"""Turn raw EMG into normalised co-contraction and its level."""

from __future__ import annotations

import msgspec
import numpy as np

from msgs.emg import CoContraction, EmgBlock
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.perception import emg
from palp_core.perception.levels import find_bursts, to_levels
from palp_core.units import Float64Array, Ratio, Seconds

KEPT_S = 2.0


class CoContractionParams(Params):
    """Set in the launch file. Window, prominence and distance were not published; all assumed.

    The RMS of a shorter window scatters by more than the prominence (8 % of the value at 50 ms), and noise
    then counts as bursts.
    """

    window_s: Seconds = 0.15
    prominence: Ratio = 0.05
    distance_s: Seconds = 0.4


class Muscle(msgspec.Struct):
    """The chain of one muscle: its memory and what it knows of the muscle."""

    band: list[float] = []
    squares: list[float] = []
    offset_v: float = 0.0
    maximum_v: float = 0.0


class CoContractionState(State):
    """What a replacement inherits."""

    rest_seen: bool = False
    fds: Muscle = msgspec.field(default_factory=Muscle)
    edc: Muscle = msgspec.field(default_factory=Muscle)
    kept: list[float] = []
    kept_from: int = 0
    sample_count: int = 0
    last_burst: int = -1
    burst_count: int = 0
    level: int = 0


class Cocontraction(Node):
    """Equations (1) to (3), block by block; a burst counts once it has ended."""

    params: CoContractionParams
    state: CoContractionState
    emg = Sub(EmgBlock)
    cocontraction = Pub(CoContraction)

    @on(emg)
    def process(self, block: EmgBlock) -> None:
        state = self.state
        if not state.rest_seen:  # the first block is at rest: it tells the electrodes' offset
            state.fds.offset_v, state.edc.offset_v = (
                emg.find_offset(block.fds_v),
                emg.find_offset(block.edc_v),
            )
            state.rest_seen = True
        envelopes = np.array(
            [
                self._envelope(state.fds, block.fds_v, block.rate_hz),
                self._envelope(state.edc, block.edc_v, block.rate_hz),
            ]
        )
        if block.phase == "mvc":
            for muscle, envelope in zip((state.fds, state.edc), envelopes, strict=True):
                muscle.maximum_v = max(muscle.maximum_v, float(envelope.max()))
        reference_v = state.fds.maximum_v + state.edc.maximum_v
        if block.phase != "palpation" or reference_v <= 0.0:
            return
        value = emg.cocontraction(envelopes, reference_v)
        self._find_bursts(value, block.rate_hz)
        self.cocontraction.publish(
            CoContraction(
                stamp_ns=self.now_ns(),
                start_ns=block.start_ns,
                rate_hz=block.rate_hz,
                reference_v=reference_v,
                value=value,
                burst_count=state.burst_count,
                level=state.level,
                level_defined=state.burst_count > 0,
            )
        )

    def _envelope(self, muscle: Muscle, samples: Float64Array, rate_hz: float) -> Float64Array:
        chain = emg.EmgChain(offset=muscle.offset_v, rate_hz=rate_hz, window_s=self.params.window_s)
        before = (
            emg.EmgState(np.array(muscle.band), np.array(muscle.squares)) if muscle.band else chain.start()
        )
        after, envelope = chain.step(before, samples)
        muscle.band, muscle.squares = after.band.tolist(), after.squares.tolist()
        return envelope

    def _find_bursts(self, value: Float64Array, rate_hz: float) -> None:
        """Look for peaks in the last seconds; one is new if it lies beyond the last one and has settled."""
        state, params = self.state, self.params
        state.kept = [*state.kept, *value.tolist()]
        state.sample_count += len(value)
        drop = max(0, len(state.kept) - round(KEPT_S * rate_hz))
        state.kept, state.kept_from = state.kept[drop:], state.kept_from + drop
        settled = state.sample_count - round(params.distance_s * rate_hz)
        window = np.array(state.kept)
        found = find_bursts(
            window, rate_hz=rate_hz, prominence=params.prominence, distance_s=params.distance_s
        )
        for index in found.tolist():
            at = state.kept_from + index
            if state.last_burst < at < settled:
                state.last_burst = at
                state.burst_count += 1
                state.level = int(to_levels(window[index : index + 1]).index[0])
