"""Deliver the raw EMG of a finger's flexor and extensor."""

from __future__ import annotations

from typing import Annotated

import msgspec

from msgs.emg import EmgBlock
from palp_core import Alarm, Node, Params, Pub, State, Timer, on
from palp_core.devices.registry import open_device
from palp_core.devices.sim.emg import EmgState as DeviceState
from palp_core.devices.sim.emg import SimEmg
from palp_core.perception import figure5
from palp_core.units import HertzPositive, Seconds


class EmgParams(Params):
    """Set in the launch file.

    The simulated subject rests, contracts to the maximum (MVC), rests, and palpates for ``palpation_s`` (the
    paper: at most 60 s), following the average of the reconstructed human matrices.
    """

    device: str = "sim"
    rate_hz: HertzPositive = 1500.0
    block_samples: Annotated[int, msgspec.Meta(ge=1)] = 75
    palpation_s: Seconds = 60.0

    @property
    def block_hz(self) -> float:
        """Rate of blocks."""
        return self.rate_hz / self.block_samples


class EmgNodeState(State):
    """What a replacement inherits."""

    device: DeviceState = msgspec.field(default_factory=DeviceState)


class Emg(Node):
    """Publish blocks of both muscles until the recording is over; then silence."""

    simulates = True
    params: EmgParams
    state: EmgNodeState
    block = Pub(EmgBlock)
    tick = Timer(hz="block_hz", running=True)
    end = Alarm()

    def on_configure(self) -> None:
        params = self.params
        options = {"matrix": figure5.matrices().mean(axis=0)} if params.device == "sim" else {}
        self.device = open_device("emg", params.device, rate_hz=params.rate_hz, **options)

    def on_activate(self) -> None:
        self.device.open(self.now_ns(), self.state.device, self.rng)
        if isinstance(self.device, SimEmg):
            begin_ns = self.device.palpation_ns(self.state.device)
            self.end.set(begin_ns + round(self.params.palpation_s * 1e9))

    def on_resume(self) -> None:
        self.device.open(self.now_ns(), self.state.device, self.rng)

    def on_deactivate(self) -> None:
        self.device.close()

    @on(tick)
    def drain(self) -> None:
        block = self.device.drain(self.now_ns(), self.state.device, self.rng)
        if not len(block.times_ns):
            return
        start_ns = int(block.times_ns[0])
        self.block.publish(
            EmgBlock(
                stamp_ns=self.now_ns(),
                start_ns=start_ns,
                rate_hz=self.params.rate_hz,
                phase=self._phase(start_ns),
                fds_v=block.fds_v,
                edc_v=block.edc_v,
            )
        )

    def _phase(self, start_ns: int) -> str:
        if not isinstance(self.device, SimEmg):
            return "palpation"
        mvc_begin_ns, mvc_end_ns = self.device.mvc_ns(self.state.device)
        if start_ns >= self.device.palpation_ns(self.state.device):
            return "palpation"
        return "mvc" if mvc_begin_ns <= start_ns < mvc_end_ns else "rest"

    @on(end)
    def stop(self) -> None:
        self.drain()  # what has come since the last tick
        self.tick.stop()
