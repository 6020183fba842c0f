"""Deliver the raw EMG of a finger's flexor and extensor."""

from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from msgs.emg import EmgBlock, EmgReport
from msgs.human import MuscleCue
from palp_core import Alarm, Params, Pub, ReadOnly, Sub, Timer, on
from palp_core.counted import counted
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.blocks import check_block, late_blocks
from palp_core.palpation.devices.device_node import DeviceNodeState, SensorNode
from palp_core.palpation.devices.protocols import EmgSamples as Samples
from palp_core.palpation.devices.registry import find_device_mistakes, open_device
from palp_core.palpation.devices.sim.emg import SimEmg
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import is_sealed, own_codes, sealed_phantoms
from palp_core.palpation.perception.strategy import figure5
from palp_core.units import CountPositive, HertzPositive, Seconds

SUBJECT = "palp_core.palpation.devices.sim.subject:SimSubject"
"""The simulated person who does what is cued."""


class EmgParams(Params):
    """Set in the launch file.

    From the start on the subject rests for ``rest_s``, contracts to the maximum (MVC) for ``mvc_s``, rests
    again and palpates: a simulated one for ``palpation_s`` (the paper: at most 60 s), following the average
    of the reconstructed human matrices; a real one to the end.

    With ``cued`` none of this holds: the input ``cue`` gives what is done from when on, and a sample has the
    phase of its own time. ``phantoms``: by whose depths a simulated person palpates; in a ``blind`` session
    also by those of the codes that ``key`` names.
    """

    device: ReadOnly[str] = "sim"
    options: ReadOnly[dict[str, Any]] = {}
    rest_s: ReadOnly[Seconds] = 2.0
    mvc_s: ReadOnly[Seconds] = 5.0
    rate_hz: ReadOnly[HertzPositive] = 1500.0
    block_samples: CountPositive = 75
    palpation_s: ReadOnly[Seconds] = 60.0
    cued: ReadOnly[bool] = False
    phantoms: ReadOnly[str] = ""
    blind: ReadOnly[bool] = False
    key: ReadOnly[str] = ""

    @property
    def block_hz(self) -> float:
        """Rate of blocks."""
        return self.rate_hz / self.block_samples

    def driver_options(self) -> dict[str, Any]:
        """Return the options of the source; a simulated one has the average of the human matrices."""
        simulated: dict[str, Any] = {"matrix": figure5.matrices().mean(axis=0)}
        if self.device == SUBJECT:
            return {"rate_hz": self.rate_hz, **simulated, "chains": self._chains(), **self.options}
        if self.device == "sim":
            return {"rate_hz": self.rate_hz, "rest_s": self.rest_s, "mvc_s": self.mvc_s, **simulated}
        return {"rate_hz": self.rate_hz, **self.options}

    def _chains(self) -> dict[str, Any]:
        """Return the human chain of the published depth that is nearest to each phantom's, by code."""
        from palp_core.palpation.session.human.blinding import key_of

        key = key_of(self.phantoms, self.key)
        found = sealed_phantoms(key) if self.blind else load_phantoms(self.phantoms)
        depths = {code: one.bead.depth_m for code, one in found.items() if one.bead}
        if self.blind:
            depths |= {own: depths[code] for code, own in own_codes(key).items()}
        published = np.array(figure5.DEPTHS_M)
        chains = figure5.matrices()
        return {code: chains[int(np.argmin(np.abs(published - d)))] for code, d in depths.items()}


class EmgNodeState(DeviceNodeState):
    """What a replacement inherits."""

    begin_ns: int = 0
    cue_ns: list[int] = []
    cued: list[str] = []


class Emg(SensorNode):
    """Publish blocks of both muscles until the recording is over; report the health of a real source."""

    simulates = True
    params: EmgParams
    state: EmgNodeState
    block = Pub(EmgBlock)
    report = Pub(EmgReport)
    cue = Sub(MuscleCue, optional=True)
    tick = Timer(hz="block_hz", running=True)
    end = Alarm()

    @classmethod
    def find_mistakes(cls, params: EmgParams, mistakes: Mistakes) -> None:
        with mistakes.of("block_samples"):
            check_block(params.block_samples, params.rate_hz)
        has_key = params.blind and is_sealed(params.phantoms)
        shown = msgspec.structs.replace(params, blind=has_key)  # or the key is still to be drawn
        find_device_mistakes("emg", params.device, shown.driver_options(), mistakes)

    def on_configure(self) -> None:
        self.device = open_device("emg", self.params.device, **self.params.driver_options())
        self.real = not isinstance(self.device, SimEmg)
        if late := late_blocks("emg", 1.0 / self.params.block_hz, wall_clock=self.real):
            self.log.warning("%s", late)

    def on_activate(self) -> None:
        self.state.begin_ns = self.now_ns()
        super().on_activate()
        if not self.real and not self.params.cued:
            *_, palpates_ns = self._schedule_ns
            self.end.set(palpates_ns + round(self.params.palpation_s * 1e9))

    def drain_rest(self) -> None:
        if self.real:
            self.drain()

    @property
    def _schedule_ns(self) -> tuple[int, int, int]:
        """When the MVC begins and ends, and when the palpation begins."""
        begin_ns, params = self.state.begin_ns, self.params
        rest_ns, mvc_ns = round(params.rest_s * 1e9), round(params.mvc_s * 1e9)
        return begin_ns + rest_ns, begin_ns + rest_ns + mvc_ns, begin_ns + 2 * rest_ns + mvc_ns

    @on(tick)
    def drain(self) -> None:
        block = self.drain_device()
        if self.real:
            self._publish_report(block)
        # a block has equal steps of time, and one phase: a gap ends one, and so does a cue
        breaks = {*(np.flatnonzero(block.gap[1:]) + 1).tolist()}
        breaks |= {*np.searchsorted(block.times_ns, self.state.cue_ns, side="right").tolist()}
        for first, end in pairwise(sorted({0, *breaks, len(block.times_ns)})):
            if first < end:
                self._publish(block, slice(first, end))

    @on(cue)
    def follow(self, cue: MuscleCue) -> None:
        """Remember what is done from when on; the last two cues suffice for what is still on its way."""
        state = self.state
        state.cue_ns, state.cued = [*state.cue_ns[-2:], cue.stamp_ns], [*state.cued[-2:], cue.phase]
        self.drain()
        if hasattr(self.device, "cue"):  # who is not a person at an amplifier does as the cue says
            self.device.cue(cue.phase, cue.phantom, self.memory)

    def _publish(self, block: Samples, part: slice) -> None:
        start_ns = max(0, int(block.times_ns[part.start]))
        self.block.publish(
            EmgBlock(
                stamp_ns=self.now_ns(),
                start_ns=start_ns,
                rate_hz=self.params.rate_hz,
                phase=self._phase(start_ns),
                fds_v=block.fds_v[part],
                edc_v=block.edc_v[part],
            )
        )

    def _publish_report(self, block: Samples) -> None:
        """Report the source's health; a gap is in the log, too."""
        health, gap_count = self.device.health(self.now_ns()), int(np.count_nonzero(block.gap))
        if gap_count:
            self.log.warning("%s in the EMG", counted(gap_count, "gap"))
        self.report.publish(
            EmgReport(
                stamp_ns=self.now_ns(),
                sample_count=len(block.times_ns),
                gap_count=gap_count,
                condition=health.condition.value,
                text=health.cause,
            )
        )

    def _phase(self, start_ns: int) -> str:
        if self.params.cued:
            # what is cued at an instant is done after it
            place = int(np.searchsorted(self.state.cue_ns, start_ns)) - 1
            return self.state.cued[place] if place >= 0 else "pause"
        mvc_ns, rests_ns, palpates_ns = self._schedule_ns
        if start_ns >= palpates_ns:
            return "palpation"
        return "mvc" if mvc_ns <= start_ns < rests_ns else "rest"

    @on(end)
    def stop(self) -> None:
        self.drain()  # what has come since the last tick
        self.tick.stop()
