"""Move a real anchor ring: its feedback decides when it has settled, and the safety node may stop it."""

from typing import Any

from msgs.actuator import RingCommand
from msgs.safety import RingReport, SafetyBeat
from nodes.actuator import RingNode, RingNodeState
from palp_core import Params, Pub, ReadOnly, Sub, Timer, on
from palp_core.errors import DeviceError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.registry import find_device_mistakes, open_device
from palp_core.palpation.devices.safety.motion_permit import MotionPermit
from palp_core.units import DeadlineMilliseconds, HertzPositive

LONG_NS = 15_000_000_000
"""A move that takes longer is logged: nothing is seen to happen meanwhile."""


class RigActuatorParams(Params):
    """Set in the launch file; ``beat_ms`` is how long it goes on without a heartbeat of the safety node."""

    device: ReadOnly[str] = "maestro"
    options: ReadOnly[dict[str, Any]] = {}
    watch_hz: ReadOnly[HertzPositive] = 50.0
    beat_ms: ReadOnly[DeadlineMilliseconds] = 50.0


class RigActuatorState(RingNodeState):
    """What a replacement inherits."""

    acknowledged_count: int = 0


class RigActuator(RingNode):
    """Move by permission of the safety node; a command that a trip has stopped is begun again after it."""

    params: RigActuatorParams
    state: RigActuatorState
    safety = Sub(SafetyBeat)
    report = Pub(RingReport)
    watch = Timer(hz="watch_hz", running=True)

    @classmethod
    def find_mistakes(cls, params: RigActuatorParams, mistakes: Mistakes) -> None:
        find_device_mistakes("ring", params.device, params.options, mistakes)

    def on_configure(self) -> None:
        self.device = open_device("ring", self.params.device, **self.params.options)
        self.permit = MotionPermit(self.params.beat_ms * 1e-3)
        self.refused = self.closed = ""  # why the device refuses, and why it is not open after a trip
        self.last_m = 0.0

    def on_activate(self) -> None:
        self.closed = ""
        super().on_activate()

    def on_resume(self) -> None:
        self.on_activate()

    def on_deactivate(self) -> None:
        try:
            self.stop_device()
        finally:
            self.device.close()

    @on(safety)
    def note_beat(self, beat: SafetyBeat) -> None:
        self.permit.renew(beat.stamp_ns, permits=beat.permits)
        if not beat.permits and self.state.moving:
            self._hold(f"the safety node is {beat.state}: {beat.cause}")
        if beat.acknowledged_count > self.state.acknowledged_count:
            self._recover(beat.acknowledged_count)

    @on(watch)
    def check(self) -> None:
        if self.state.moving and not self.permit.alive(self.now_ns()):
            self._hold(self.permit.lost_text)
        if self.closed:
            self._publish_report(self.last_m, Condition.LINK_LOST, self.closed)
            return
        self.go_on()
        reading, health = self.read(), self.device.health(self.now_ns())
        self.last_m = reading.measured_m
        self._publish_report(self.last_m, health.condition, health.cause or self.refused or reading.waits)

    def _publish_report(self, ring_m: float, condition: Condition, text: str) -> None:
        self.report.publish(
            RingReport(
                stamp_ns=self.now_ns(),
                ring_m=ring_m,
                moving=self.state.moving,
                condition=condition.value,
                text=text,
                acknowledged_count=self.state.acknowledged_count,
            )
        )

    def begin(self, command: RingCommand) -> bool:
        now_ns = self.now_ns()
        if self.closed or not self.permit.permits(now_ns):
            return False
        try:
            settled_ns = self.send(command)
        except DeviceError as error:
            if str(error) != self.refused:
                self.log.warning("%s", error)
            self.refused = str(error)  # the safety node reads it in the report, and decides
            return False
        if settled_ns - now_ns > LONG_NS:
            why = self.read().waits or "it is a long way"
            self.log.warning("the ring rests in %.0f s only: %s", (settled_ns - now_ns) / 1e9, why)
        self.refused = ""
        return True

    def _hold(self, why: str) -> None:
        """Stop where it is; the command stays the first to follow."""
        self.state.moving = False
        self.stop_device()
        self.log.warning("holds: %s", why)

    def _recover(self, count: int) -> None:
        """Leave a stall or a reported error behind, which a person has acknowledged."""
        self.state.acknowledged_count = count
        self.state.moving = False  # a device may have stopped by itself, between two beats that permit
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
