"""Move the anchor ring, and with it the stiffness of the probe's joint."""

from typing import Any, Literal

from msgs.actuator import RingCommand, RingState, RingTruth
from palp_core import Alarm, Params, Pub, ReadOnly, Sub, on
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.device_node import DeviceNode, DeviceNodeState
from palp_core.palpation.devices.protocols import RingDevice, RingReading
from palp_core.palpation.devices.registry import find_device_mistakes, open_device
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.perception.belief.rig_noise import read_noise
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.units import MillimetresNonNegative


class RingNodeState(DeviceNodeState):
    """What a replacement inherits: the commands that are not fulfilled, the one under way first."""

    commands: list[RingCommand] = []
    moving: bool = False


class RingNode(DeviceNode):
    """Follow ring commands one after another; one that was stopped is begun again."""

    moves = True
    state: RingNodeState
    device: RingDevice[Any]
    command = Sub(RingCommand)
    ring = Sub(RingCommand)
    ring_state = Pub(RingState)

    def on_activate(self) -> None:
        self.state.moving = False
        super().on_activate()

    @on(command)
    def follow_policy(self, command: RingCommand) -> None:
        self.follow(command)

    @on(ring)
    def follow_experiment(self, command: RingCommand) -> None:
        self.follow(command)

    def follow(self, command: RingCommand) -> None:
        """Do as commanded, once what was commanded before is done."""
        self.state.commands.append(command)
        self.go_on()

    def go_on(self) -> None:
        """End the move under way if the ring has settled; begin the next if it may."""
        state, begun = self.state, False
        while state.commands:
            if not state.moving:
                if not self.begin(state.commands[0]):
                    return
                state.moving = begun = True
            if not self.read().settled:
                if begun:
                    self.publish_ring(state.commands[0], settled=False)
                return
            state.moving = begun = False
            self.end(state.commands.pop(0))

    def begin(self, command: RingCommand) -> bool:
        """Begin to move; return whether the device does."""
        raise NotImplementedError

    def end(self, command: RingCommand) -> None:
        """Publish that a command is fulfilled."""
        self.publish_ring(command, settled=True)

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


class ActuatorParams(Params):
    """Set in the launch file. The defaults are an L12-50-210-06-I as its data sheet gives it.

    ``ring_error`` says how the data sheet's +-0.3 mm is read: ``uniform`` as hard limits, ``normal`` as the
    band of 95 %. ``backlash_mm`` lets the ring lag by half of it behind the direction it came from (not
    known: 0). Where a noise file (plan ``repeatability``) is named in ``noise``, the ring's error is normal
    with its standard deviation, and the two parameters of it are not used.
    """

    device: ReadOnly[str] = "sim"
    ring_error: ReadOnly[Literal["uniform", "normal"]] = "uniform"
    repeatability_mm: ReadOnly[MillimetresNonNegative] = 0.3
    backlash_mm: ReadOnly[MillimetresNonNegative] = 0.0
    noise: ReadOnly[str] = ""


class Actuator(RingNode):
    """Move a simulated ring, which settles when it says; publish where it is in truth."""

    simulates = True
    params: ActuatorParams
    truth = Pub(RingTruth)
    settled = Alarm()

    @classmethod
    def find_mistakes(cls, params: ActuatorParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)
        find_device_mistakes("ring", params.device, None, mistakes)

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
        super().on_activate()
        self.go_on()

    def on_deactivate(self) -> None:
        self.device.stop(self.now_ns(), self.memory)
        super().on_deactivate()

    def begin(self, command: RingCommand) -> bool:
        if (settled_ns := self.send(command)) > self.now_ns():
            self.settled.set(settled_ns)
        return True

    @on(settled)
    def settle(self) -> None:
        self.go_on()

    def end(self, command: RingCommand) -> None:
        super().end(command)
        if isinstance(self.device, SimRing):
            self.truth.publish(
                RingTruth(
                    stamp_ns=self.now_ns(),
                    trial=command.trial,
                    iteration=command.iteration,
                    ring_m=self.device.true_position_m(self.now_ns(), self.memory),
                )
            )
