"""Move the anchor ring, and with it the stiffness of the probe's joint."""

from typing import Literal

import msgspec

from msgs.actuator import RingCommand, RingState, RingTruth
from palp_core import Alarm, Node, Params, Pub, State, Sub, on
from palp_core.palpation.devices.registry import device_mistakes, open_device
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.ring import SimRingState as DeviceState
from palp_core.palpation.perception.belief.rig_noise import read_noise
from palp_core.palpation.session.named_files import file_mistakes
from palp_core.units import MillimetresNonNegative


class ActuatorParams(Params):
    """Set in the launch file. The defaults are an L12-50-210-06-I as its data sheet gives it.

    ``ring_error`` says how the data sheet's +-0.3 mm is read: ``uniform`` as hard limits, ``normal`` as the
    band of 95 %. ``backlash_mm`` lets the ring lag by half of it behind the direction it came from (not
    known: 0). Where a noise file (plan ``repeatability``) is named in ``noise``, the ring's error is normal
    with its standard deviation, and the two parameters of it are not used.
    """

    device: str = "sim"
    ring_error: Literal["uniform", "normal"] = "uniform"
    repeatability_mm: MillimetresNonNegative = 0.3
    backlash_mm: MillimetresNonNegative = 0.0
    noise: str = ""


class ActuatorState(State):
    """What a replacement inherits."""

    device: DeviceState = msgspec.field(default_factory=DeviceState)
    trial: int = 0
    iteration: int = 0
    rehome: bool = False
    moving: bool = False
    waiting: list[tuple[int, int, float]] = []


class Actuator(Node):
    """Follow ring commands in the order they come; a command during re-homing waits for its end."""

    moves = True
    simulates = True
    params: ActuatorParams
    state: ActuatorState
    command = Sub(RingCommand)
    ring = Sub(RingCommand)
    ring_state = Pub(RingState)
    truth = Pub(RingTruth)
    settled = Alarm()

    @staticmethod
    def examine(params: ActuatorParams) -> dict[str, str]:
        return file_mistakes(params) | device_mistakes("ring", params.device)

    def on_configure(self) -> None:
        params = self.params
        distribution, repeatability_m = params.ring_error, params.repeatability_mm * 1e-3
        if params.noise:
            distribution, repeatability_m = "normal", 2.0 * read_noise(params.noise).ring_sd_m.value
        self.device = open_device(
            "ring",
            params.device,
            distribution=distribution,
            repeatability_m=repeatability_m,
            backlash_m=params.backlash_mm * 1e-3,
        )

    def on_activate(self) -> None:
        self.state.moving, self.state.waiting = False, []  # what was under way ended with the last stop
        self.device.open(self.now_ns(), self.state.device, self.rng)

    def on_resume(self) -> None:
        self.device.open(self.now_ns(), self.state.device, self.rng)

    def on_deactivate(self) -> None:
        self.device.stop(self.now_ns(), self.state.device)
        self.device.close()

    @on(command)
    def follow_policy(self, command: RingCommand) -> None:
        self._follow(command)

    @on(ring)
    def follow_experiment(self, command: RingCommand) -> None:
        self._follow(command)

    def _follow(self, command: RingCommand) -> None:
        state = self.state
        if command.rehome:
            settled_ns = self.device.rehome(self.now_ns(), state.device, self.rng)
            self._begin(command.trial, command.iteration, settled_ns, rehome=True)
        elif state.moving and state.rehome:
            state.waiting.append((command.trial, command.iteration, command.ring_m))
        else:
            self._move(command.trial, command.iteration, command.ring_m)

    def _move(self, trial: int, iteration: int, ring_m: float) -> None:
        settled_ns = self.device.command(ring_m, self.now_ns(), self.state.device, self.rng)
        self._begin(trial, iteration, settled_ns, rehome=False)

    def _begin(self, trial: int, iteration: int, settled_ns: int, *, rehome: bool) -> None:
        state = self.state
        state.trial, state.iteration, state.rehome = trial, iteration, rehome
        state.moving = settled_ns > self.now_ns()
        if state.moving:
            self._publish(settled=False)
            self.settled.set(settled_ns)
        else:
            self._rest()

    @on(settled)
    def settle(self) -> None:
        self.state.moving = False
        self._rest()
        if self.state.waiting:
            self._move(*self.state.waiting.pop(0))

    def _rest(self) -> None:
        state = self.state
        self._publish(settled=True)
        if isinstance(self.device, SimRing):
            self.truth.publish(
                RingTruth(
                    stamp_ns=self.now_ns(),
                    trial=state.trial,
                    iteration=state.iteration,
                    ring_m=self.device.true_position_m(self.now_ns(), state.device),
                )
            )

    def _publish(self, *, settled: bool) -> None:
        state, reading = self.state, self.device.read(self.now_ns(), self.state.device)
        self.ring_state.publish(
            RingState(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.iteration,
                rehome=state.rehome,
                target_m=reading.target_m,
                measured_m=reading.measured_m,
                settled=settled,
            )
        )
