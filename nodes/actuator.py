"""Move the anchor ring, and with it the stiffness of the probe's joint."""

from typing import Any, Literal

from msgs.actuator import RingCommand, RingState, RingTruth
from palp_core import Alarm, Params, Pub, Sub, on
from palp_core.palpation.devices.device_node import DeviceNode, DeviceNodeState
from palp_core.palpation.devices.protocols import RingDevice, RingReading
from palp_core.palpation.devices.registry import device_mistakes, open_device
from palp_core.palpation.devices.sim.ring import SimRing
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


class RingNode(DeviceNode):
    """A node that moves a ring, simulated or real, as policy and experiment command."""

    moves = True
    device: RingDevice[Any]
    command = Sub(RingCommand)
    ring = Sub(RingCommand)
    ring_state = Pub(RingState)

    @on(command)
    def follow_policy(self, command: RingCommand) -> None:
        self.follow(command)

    @on(ring)
    def follow_experiment(self, command: RingCommand) -> None:
        self.follow(command)

    def follow(self, command: RingCommand) -> None:
        """Do as commanded, now or later."""
        raise NotImplementedError

    def send(self, command: RingCommand) -> int:
        """Send the device where it is to go; return the time at which it will have settled, in ns."""
        if command.rehome:
            return self.device.rehome(self.now_ns(), self.memory, self.rng)
        return self.device.command(command.ring_m, self.now_ns(), self.memory, self.rng)

    def read(self) -> RingReading:
        """Return what the ring reports of itself."""
        return self.device.read(self.now_ns(), self.memory)

    def publish_ring(self, command: RingCommand, *, settled: bool) -> None:
        """Publish how far a command is."""
        reading = self.read()
        self.ring_state.publish(
            RingState(
                stamp_ns=self.now_ns(),
                trial=command.trial,
                iteration=command.iteration,
                rehome=command.rehome,
                target_m=reading.target_m,
                measured_m=reading.measured_m,
                settled=settled,
            )
        )


class ActuatorState(DeviceNodeState):
    """What a replacement inherits: the command under way or done last, and those that wait."""

    under_way: RingCommand | None = None
    moving: bool = False
    waiting: list[RingCommand] = []


class Actuator(RingNode):
    """Follow ring commands in the order they come; a command during re-homing waits for its end."""

    simulates = True
    params: ActuatorParams
    state: ActuatorState
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
        super().on_activate()

    def on_deactivate(self) -> None:
        self.device.stop(self.now_ns(), self.memory)
        super().on_deactivate()

    def follow(self, command: RingCommand) -> None:
        state = self.state
        if state.moving and state.under_way and state.under_way.rehome and not command.rehome:
            state.waiting.append(command)
            return
        settled_ns = self.send(command)
        state.under_way, state.moving = command, settled_ns > self.now_ns()
        if state.moving:
            self.publish_ring(command, settled=False)
            self.settled.set(settled_ns)
        else:
            self._rest(command)

    @on(settled)
    def settle(self) -> None:
        state = self.state
        assert state.under_way is not None
        state.moving = False
        self._rest(state.under_way)
        if state.waiting:
            self.follow(state.waiting.pop(0))

    def _rest(self, command: RingCommand) -> None:
        self.publish_ring(command, settled=True)
        if isinstance(self.device, SimRing):
            self.truth.publish(
                RingTruth(
                    stamp_ns=self.now_ns(),
                    trial=command.trial,
                    iteration=command.iteration,
                    ring_m=self.device.true_position_m(self.now_ns(), self.memory),
                )
            )
