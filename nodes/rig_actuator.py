"""Move a real anchor ring: what it says it is decides, and the safety node may stop it."""

from typing import Any

from msgs.actuator import RingCommand
from msgs.safety import RingReport, SafetyBeat
from nodes.actuator import RingNode
from palp_core import Params, Pub, ReadOnly, Sub, Timer, on
from palp_core.errors import DeviceError
from palp_core.palpation.devices.device_node import DeviceNodeState
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.registry import device_mistakes, open_device
from palp_core.palpation.devices.safety.motion_permit import MotionPermit
from palp_core.units import DeadlineMilliseconds, HertzPositive

LONG_NS = 15_000_000_000
"""A move that takes longer is told: nothing is seen to happen meanwhile."""


class RigActuatorParams(Params):
    """Set in the launch file; ``beat_ms`` is how long it goes on without a word of the safety node."""

    device: ReadOnly[str] = "maestro"
    options: ReadOnly[dict[str, Any]] = {}
    watch_hz: ReadOnly[HertzPositive] = 50.0
    beat_ms: ReadOnly[DeadlineMilliseconds] = 50.0


class RigActuatorState(DeviceNodeState):
    """What a replacement inherits: the command under way and those that wait."""

    commands: list[RingCommand] = []
    activity: str = "ready"
    acknowledged_count: int = 0


class RigActuator(RingNode):
    """Follow ring commands one after another; one that was stopped is begun again after the trip."""

    moves = True
    params: RigActuatorParams
    state: RigActuatorState
    safety = Sub(SafetyBeat)
    report = Pub(RingReport)
    watch = Timer(hz="watch_hz", running=True)

    @staticmethod
    def examine(params: RigActuatorParams) -> dict[str, str]:
        return device_mistakes("ring", params.device, params.options)

    def on_configure(self) -> None:
        self.device = open_device("ring", self.params.device, **self.params.options)
        self.permit = MotionPermit(self.params.beat_ms * 1e-3)
        self.refused = self.closed = ""  # why the device refuses, and why it is not open after a trip
        self.last_m = 0.0

    def on_activate(self) -> None:
        self.state.activity, self.closed = "ready", ""
        super().on_activate()

    def on_resume(self) -> None:
        self.on_activate()

    def on_deactivate(self) -> None:
        try:
            self.device.stop(self.now_ns(), self.memory)
        except DeviceError as error:
            self.log.warning("could not be stopped at the end: %s", error)
        finally:
            self.device.close()

    def follow(self, command: RingCommand) -> None:
        self.state.commands.append(command)
        self._go_on()

    @on(safety)
    def note_beat(self, beat: SafetyBeat) -> None:
        self.permit.renew(beat.stamp_ns, permits=beat.permits)
        if not beat.permits and self.state.activity == "moving":
            self._hold(f"the safety node says: {beat.state}: {beat.cause}")
        if beat.acknowledged_count > self.state.acknowledged_count:
            self._recover(beat.acknowledged_count)

    @on(watch)
    def check(self) -> None:
        if self.state.activity == "moving" and not self.permit.alive(self.now_ns()):
            self._hold(self.permit.unheard_words)
        if self.closed:
            self._publish_report(self.last_m, Condition.LINK_LOST, self.closed)
            return
        self._go_on()
        reading, health = self.read(), self.device.health(self.now_ns())
        self.last_m = reading.measured_m
        self._publish_report(self.last_m, health.condition, health.cause or self.refused or reading.waits)

    def _publish_report(self, ring_m: float, condition: Condition, text: str) -> None:
        self.report.publish(
            RingReport(
                stamp_ns=self.now_ns(),
                ring_m=ring_m,
                moving=self.state.activity == "moving",
                condition=condition.value,
                text=text,
                acknowledged_count=self.state.acknowledged_count,
            )
        )

    def _go_on(self) -> None:
        """End the move under way if it has arrived; begin the next if it may."""
        state, now_ns = self.state, self.now_ns()
        if state.activity == "moving" and self.read().settled:
            state.activity = "ready"
            self.publish_ring(state.commands.pop(0), settled=True)
        if state.activity != "ready" or not state.commands or self.closed or not self.permit.permits(now_ns):
            return
        command = state.commands[0]
        try:
            rests_ns = self.send(command)
        except DeviceError as error:
            if str(error) != self.refused:
                self.log.warning("%s", error)
            self.refused = str(error)  # the safety node hears of it and decides
            return
        if rests_ns - now_ns > LONG_NS:
            why = self.read().waits or "it is a long way"
            self.log.warning("the ring rests in %.0f s only: %s", (rests_ns - now_ns) / 1e9, why)
        state.activity, self.refused = "moving", ""
        self.publish_ring(command, settled=False)

    def _hold(self, why: str) -> None:
        """Stop where it is; the command stays the first to follow."""
        self.state.activity = "ready"
        try:
            self.device.stop(self.now_ns(), self.memory)
        except DeviceError as error:
            self.log.warning("could not be stopped: %s", error)
        self.log.warning("holds: %s", why)

    def _recover(self, count: int) -> None:
        """Leave a stall or a reported error behind, which a person has acknowledged."""
        self.state.acknowledged_count = count
        try:
            if self.closed or self.device.health(self.now_ns()).condition is Condition.LINK_LOST:
                self.device.close()
                self.closed = "not open"
                self.device.open(self.now_ns(), self.memory, self.rng)
                self.closed = ""
            self.device.acknowledge(self.now_ns(), self.memory)
        except DeviceError as error:
            self.closed = self.closed and str(error)
            self.log.warning("%s", error)
