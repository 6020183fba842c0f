"""Sweep with a real stage on the machine's clock, by permission of the safety node."""

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from msgs.safety import SafetyBeat, StageReport
from nodes.stage import Stage, StageParams, StageState, window_of
from palp_core import Pub, ReadOnly, Sub, Timer, on
from palp_core.errors import DeviceError
from palp_core.palpation.devices.health import Condition
from palp_core.palpation.devices.protocols import StageFeedback
from palp_core.palpation.devices.safety.link_check import CHECK_MOVE_M
from palp_core.palpation.devices.safety.motion_permit import MotionPermit
from palp_core.palpation.devices.stage.position_history import crossing_ns
from palp_core.units import DeadlineMilliseconds, HertzPositive, MetresPerSecondPositive

AGAIN_NS = 5_000_000
LAG_NS = 60_000_000  # positions are polled every 20 ms; older ones lie between two polls
UNFINISHED = ("returning", "sweeping", "swept")  # a goal that a stop cancels
ACTIVE = (*UNFINISHED, "resting", "retreating", "raising", "checking")
CHECK_AGAIN_NS = 500_000_000


class RigStageParams(StageParams):
    """Set in the launch file.

    The travel window is the sweep's path, the place of rest, and ``margin_mm``. ``beat_ms`` is how long the
    stage goes on without a heartbeat of the safety node; after a trip it is raised at ``retreat_speed_m_s``,
    as how the probe lies is not known. The safety node has ``device`` and ``options``, too.
    """

    device: ReadOnly[str]
    retreat_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.002
    watch_hz: ReadOnly[HertzPositive] = 100.0
    beat_ms: ReadOnly[DeadlineMilliseconds] = 50.0


class RigStageState(StageState):
    """What a replacement inherits."""

    acknowledged_count: int = 0


class RigStage(Stage):
    """Move only while the safety node permits it; a sweep that was stopped is cancelled, not resumed."""

    LAG_NS: ClassVar[int] = LAG_NS
    params: RigStageParams
    state: RigStageState
    safety = Sub(SafetyBeat)
    report = Pub(StageReport)
    watch = Timer(hz="watch_hz", running=True)

    def on_configure(self) -> None:
        self.make_device()
        self.permit = MotionPermit(self.params.beat_ms * 1e-3)
        self.permits_sweep, self.check_ns = False, 0
        self.trouble = ""
        self.text = ""

    def on_activate(self) -> None:
        self.state.activity, self.state.at_start = "down", False

    def on_resume(self) -> None:
        """Connect once that is permitted; a move that was under way the predecessor stops as it leaves."""
        _ = self.memory  # what another device remembered is refused while the predecessor is still there
        self.block.stop()
        self.arrival.clear()
        was, self.state.activity, self.state.at_start = self.state.activity, "down", False
        if was in UNFINISHED:
            self._publish_status("cancelled")

    def on_deactivate(self) -> None:
        try:
            self.stop_device()
        finally:
            self.device.close()

    # Permission to move

    @on(safety)
    def note_beat(self, beat: SafetyBeat) -> None:
        self.permit.renew(beat.stamp_ns, permits=beat.permits)
        self.permits_sweep = beat.permits_sweep
        if not beat.permits and self.state.activity in ACTIVE:
            self._halt("halted", f"the safety node is {beat.state}: {beat.cause}")
        if beat.acknowledged_count > self.state.acknowledged_count:
            self._recover(beat.acknowledged_count)

    @on(watch)
    def check(self) -> None:
        now_ns, activity = self.now_ns(), self.state.activity
        if activity in ACTIVE and not self.permit.alive(now_ns):
            self._halt("no heartbeat", self.permit.lost_text)
        elif activity in ACTIVE and not (health := self.device.health(now_ns)).ok:
            self._halt(health.condition, health.cause)
        elif activity == "sweeping":
            self._end_passed_sweep()
        elif self.permit.permits(now_ns) and not self.trouble:
            if activity == "down":
                self._bring_up()
                return  # it took long: the next report has a fresh stamp
            elif activity == "halted":
                self._raise_probe("retreating", self.params.retreat_speed_m_s)
            elif activity == "ready" and not self.permits_sweep:
                self._check_link(now_ns)
            elif activity == "ready":
                super().begin_waiting()
        self._publish_report()

    def _halt(self, trouble: str, text: str) -> None:
        """Stop at once; the goal under way is cancelled."""
        self.block.stop()
        self.arrival.clear()
        was, self.state.activity, self.state.at_start = self.state.activity, "halted", False
        self.trouble, self.text = trouble, text
        self.stop_device()
        self.log.warning("halted: %s", text)
        if was in UNFINISHED:
            self._publish_status("cancelled")

    def _recover(self, count: int) -> None:
        """Leave the trip behind, which a person has acknowledged; the device may disagree."""
        now_ns = self.now_ns()
        self.state.acknowledged_count = count
        self.trouble = self.text = ""
        if self.state.activity == "down":
            return
        self.state.activity = "halted"
        try:
            self.device.acknowledge(now_ns, self.memory)
        except DeviceError as error:
            self.log.warning("%s", error)
            if self.device.health(now_ns).condition is Condition.LINK_LOST:
                self.device.close()
                self.state.activity = "down"  # it connects again
            else:
                self.trouble, self.text = "device fault", str(error)

    def _bring_up(self) -> None:
        self._publish_report(bring_up=True)
        try:
            self.device.open(self.now_ns(), self.memory, self.rng)
        except DeviceError as error:
            self.trouble, self.text = "device fault", str(error)
            self.log.warning("%s", error)
            self.device.close()
            return
        self._be_ready()

    def _raise_probe(self, activity: str, speed_m_s: float) -> None:
        """Raise the probe where it is: rings move and phantoms are changed above the phantom."""
        self.state.activity = activity
        self.begin_move(lambda: self.device.retreat(speed_m_s, self.now_ns(), self.memory))

    def _check_link(self, now_ns: int) -> None:
        """Move a little, raised, so that the safety node can see its own link follow this stage."""
        if now_ns < self.check_ns:
            return
        y_m, lift_m = self._feedback().y_m, self.params.lift_mm * 1e-3
        middle_m = 0.5 * sum(window_of(self.params).y_m)
        to_m = y_m + math.copysign(CHECK_MOVE_M, middle_m - y_m)
        self.state.activity, self.state.at_start = "checking", False
        self.begin_move(lambda: self.device.return_to(to_m, self.now_ns(), self.memory, height_m=lift_m))

    def _be_ready(self) -> None:
        self.state.activity, self.state.at_start = "ready", False
        self._publish_status("ready")

    # Motion

    def begin_waiting(self) -> None:
        """Wait for the next check, which knows whether a sweep is permitted."""

    def _cancel(self) -> None:
        try:
            super()._cancel()
        except DeviceError as error:
            self._halt("device fault", str(error))

    def begin_move(self, move: Callable[[], int]) -> None:
        """Begin a move that arrives, if it may begin."""
        try:
            if not self.permit.permits(self.now_ns()):
                raise DeviceError("the safety node does not permit motion")
            super().begin_move(move)
        except DeviceError as error:
            self._halt("device fault", str(error))

    def _sweep(self) -> None:
        if not self.permit.permits(self.now_ns()):
            self._halt("no heartbeat", "the safety node does not permit motion")
            return
        try:
            super()._sweep()
        except DeviceError as error:
            self._halt("device fault", str(error))

    @on(Stage.arrival)
    def arrive(self) -> None:
        if self._feedback().moving:
            self.arrival.set(self.now_ns() + AGAIN_NS)
        elif self.state.activity == "returning":
            self._sweep()
        elif self.state.activity == "swept":
            self._raise_probe("resting", self.params.lift_speed_m_s)
        elif self.state.activity == "cancelled":  # a goal may come, and waits until the probe is raised
            self._publish_status("ready")
            self._raise_probe("raising", self.params.lift_speed_m_s)
        elif self.state.activity == "checking":
            self.state.activity, self.check_ns = "ready", self.now_ns() + CHECK_AGAIN_NS
        elif self.state.activity == "raising":
            self.state.activity = "ready"
        else:
            self._be_ready()

    @on(Stage.block)
    def sample(self) -> None:
        known_ns = self.now_ns() - LAG_NS
        try:
            if known_ns >= self.state.leave_ns and self._feedback().moving:
                self.state.leave_ns = self.now_ns()  # later than predicted
            super().sample()
        except DeviceError as error:
            self._halt("stale", str(error))

    def _end_passed_sweep(self) -> None:
        """End the sweep once a poll has seen the stage beyond it: its end lies between two polls then."""
        state = self.state
        if (self._feedback().y_m - state.to_m) * (state.to_m - state.from_m) <= 0.0:
            return
        try:
            self._measure_interval()
            self._publish_pose(state.leave_ns)
        except DeviceError as error:
            self._halt("stale", str(error))
            return
        state.sample_count = 0
        self._end_sweep()

    def _measure_interval(self) -> None:
        """Replace the predicted times over the phantom by those at which the stage was there."""
        state, now_ns = self.state, self.now_ns()
        since_ns = max(0, state.enter_ns - 500_000_000)
        times_ns = np.append(np.arange(since_ns, now_ns, 1_000_000, dtype=np.int64), now_ns)  # seen beyond it
        y_m = self.device.read(times_ns, self.memory).y_m
        state.enter_ns, state.leave_ns = (
            crossing_ns(times_ns, y_m, place_m) for place_m in (state.from_m, state.to_m)
        )
        state.sample_count = 0  # the torque streams: who reads it cuts it by these times

    def _feedback(self) -> StageFeedback:
        return self.device.feedback(self.now_ns(), self.memory)

    # Report

    def _publish_report(self, *, bring_up: bool = False) -> None:
        now_ns, condition, text = self.now_ns(), self.trouble, self.text
        seen = StageFeedback(0.0, 0.0, 0.0, moving=False, asked_ns=0, answered_ns=0)
        if self.state.activity == "down":
            condition = condition or "closed"
        else:
            health = self.device.health(now_ns)
            if not (condition and health.ok):  # what it suffers from now says more than what it refused
                condition, text = health.condition, health.cause
            seen = self._feedback()
        self.report.publish(
            StageReport(
                stamp_ns=now_ns,
                y_m=seen.y_m,
                z_m=seen.z_m,
                speed_m_s=seen.speed_m_per_s,
                moving=seen.moving,
                asked_ns=seen.asked_ns,
                answered_ns=seen.answered_ns,
                bring_up=bring_up,
                acknowledged_count=self.state.acknowledged_count,
                condition=condition,
                text=text,
                x_m=seen.x_m,
            )
        )
