"""Turn raw EMG into normalised co-contraction and its level."""

from dataclasses import replace

import numpy as np

from msgs.emg import CoContraction, EmgBlock
from palp_core import Params, Pub, Sub, on
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.perception.emg.bursts import BurstFinder, BurstState
from palp_core.palpation.perception.emg.emg import EmgChain, find_offset
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.emg.stream import CoContractionStream, StreamState
from palp_core.palpation.session.methods.teller import MethodTeller, MethodTellerState
from palp_core.palpation.session.methods.used import used_of_class
from palp_core.units import RatioNonNegative, Seconds, SecondsPositive

UNSCALED = 1.0


class CoContractionParams(Params):
    """Set in the launch file. Window, prominence and distance were not published; all assumed.

    The RMS of a shorter window scatters by more than the prominence (8 % of the value at 50 ms), and noise
    then counts as bursts.
    """

    window_s: SecondsPositive = 0.15
    prominence: RatioNonNegative = 0.05
    distance_s: Seconds = 0.4


class CoContractionState(MethodTellerState):
    """What a replacement inherits: the stream's memory, and what is known of the two muscles."""

    phase: str = ""
    offsets_v: list[float] = []
    maxima_v: list[float] = []
    stream: StreamState | None = None
    burst_count: int = 0
    level: int = 0


class Cocontraction(MethodTeller):
    """Equations (1) to (3), block by block; a burst counts once nothing can displace it any more."""

    params: CoContractionParams
    state: CoContractionState
    emg = Sub(EmgBlock)
    cocontraction = Pub(CoContraction)

    def uses(self) -> list[MethodUse]:
        return [used_of_class("burst", BurstFinder)]

    @on(emg)
    def process(self, block: EmgBlock) -> None:
        state = self.state
        samples = np.array([block.fds_v, block.edc_v])
        if not state.offsets_v:  # the first block is at rest: it tells the electrodes' offset
            state.offsets_v = [find_offset(muscle) for muscle in samples]
        reference_v = sum(state.maxima_v)
        told = block.phase == "palpation" and reference_v > 0.0
        stream = self._stream(block.rate_hz, reference_v if told else UNSCALED)
        before = state.stream or stream.start()
        if block.phase != state.phase:  # no burst spans two phases, and the scale is another
            before, state.phase = replace(before, bursts=BurstState()), block.phase
        state.stream, out = stream.step(before, samples)
        if block.phase == "mvc":
            state.maxima_v = np.maximum(state.maxima_v or [0.0], out.envelopes.max(axis=1)).tolist()
        if not told:
            return
        if out.bursts:
            state.burst_count += len(out.bursts)
            state.level = int(to_levels(np.array([out.bursts[-1].value])).index[0])
        self.cocontraction.publish(
            CoContraction(
                stamp_ns=self.now_ns(),
                start_ns=block.start_ns,
                rate_hz=block.rate_hz,
                reference_v=reference_v,
                value=out.cocontraction,
                burst_count=state.burst_count,
                level=state.level,
                level_defined=state.burst_count > 0,
            )
        )

    def _stream(self, rate_hz: float, reference_v: float) -> CoContractionStream:
        params = self.params
        chains = tuple(EmgChain(o, rate_hz, window_s=params.window_s) for o in self.state.offsets_v)
        return CoContractionStream(
            chains, reference_v, BurstFinder(rate_hz, params.prominence, params.distance_s)
        )
