"""Watch torque, stage and actuator; stop motion on a link of its own; stay stopped until acknowledged."""

from __future__ import annotations

from msgs.safety import (
    AcknowledgeReply,
    AcknowledgeRequest,
    LoadReport,
    RingReport,
    SafetyBeat,
    StageReport,
    StatusReply,
    StatusRequest,
    StopRequest,
    Trip,
)
from nodes.safety_limits import ONE_LINK, SafetyParams, limits_of, mistakes
from nodes.safety_record import LastSecond
from palp_core import Node, Pub, Qos, Srv, State, Sub, every, on, serve
from palp_core.errors import DeviceError
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.reconnection import Reconnection
from palp_core.palpation.devices.safety.process_watch import ProcessWatch
from palp_core.palpation.devices.safety.state_machine import Action, Cause, Event, SafetyMachine
from palp_core.palpation.devices.safety.state_machine import SafetyState as Standing
from palp_core.palpation.devices.safety.watchdog import LimitViolation, Watchdog, WatchedLoad, WatchedStage
from palp_core.palpation.devices.stage.aerotech_stop import AerotechStop

SEARCH_NS = 1_000_000_000


class SafetyNodeState(State):
    """What a replacement inherits: a trip outlives its node."""

    standing: str = "starting"
    cause: str = ""
    text: str = ""
    acknowledged_count: int = 0


class Safety(Node):
    """Trip at the first limit that is passed: ABORT, then DISABLE, hold the ring, latch, and say why."""

    moves = True
    examine = staticmethod(mistakes)
    params: SafetyParams
    state: SafetyNodeState
    load = Sub(LoadReport)
    stage = Sub(StageReport)
    ring = Sub(RingReport)
    beat = Pub(SafetyBeat)
    trip = Pub(Trip, qos=Qos(durability="transient_local", depth=20))
    stop = Srv(StopRequest, StatusReply)
    acknowledge = Srv(AcknowledgeRequest, AcknowledgeReply)
    status = Srv(StatusRequest, StatusReply)

    def on_configure(self) -> None:
        self.watchdog, state = Watchdog(limits_of(self.params)), self.state
        cause = Cause(state.cause) if state.cause else None
        self.machine = SafetyMachine(Standing(state.standing), cause, state.text)
        self.machine.acknowledged_count = state.acknowledged_count
        self.host, self.processes = HostTime(), ProcessWatch()
        self.link: AerotechStop | None = None
        self.again, self.complaint = Reconnection(self._new_link), ""
        self.memory, self.overloads = LastSecond(), list[LimitViolation]()
        self.stopped_ns = self.permitted_ns = self.search_ns = 0
        self.moving = False

    def on_activate(self) -> None:
        self.host.observe(self.now_ns())
        self.link = self._new_link() if self.params.stop_url else None
        if self.link is None:
            self.log.warning("%s", ONE_LINK)

    on_resume = on_activate

    def on_deactivate(self) -> None:
        self.again.close()
        if self.link is None:
            return
        try:
            if self.machine.state is Standing.MOVING or any(axis.moving for axis in self.link.poll()):
                self.link.trip()  # the stage's node may be gone, and before it could say that a move began
        except DeviceError as error:
            self.log.warning("the stage could not be stopped at the end: %s", error)
        finally:
            self.link.close()

    # What is heard

    @on(load)
    def note_load(self, report: LoadReport) -> None:
        self.memory.add_load(report)
        before = self.watchdog.warning
        spoilt = (report.saturated_count > 0, report.faulty_count > 0, report.condition)
        load = WatchedLoad(report.sample_ns, report.torque_n_m, report.force_n, *spoilt, report.stamp_ns)
        found = self.watchdog.check_load(load)
        if report.sample_count or found:  # silence does not take a load away
            self.overloads = found
        self._judge(found, report.sample_ns)
        if self.watchdog.warning and not before:
            self.log.warning("%s", self.watchdog.warning)

    @on(stage)
    def note_stage(self, report: StageReport) -> None:
        self.memory.add_stage(report)
        released = report.acknowledged_count == self.machine.acknowledged_count
        place = (report.stamp_ns, report.y_m, report.z_m, report.speed_m_s)
        seen = WatchedStage(*place, report.moving, report.bring_up, released, report.condition)
        self._judge(self.watchdog.check_stage(seen), report.stamp_ns)
        self.moving = report.moving
        if report.stamp_ns <= self.stopped_ns:  # said before the stop was done
            return
        if self.machine.state is Standing.STOPPING and self.link is None and not report.moving:
            self._handle(Event.STOPPED)
        elif released:
            self._handle(Event.MOVES if report.moving or report.bring_up else Event.RESTS)

    @on(ring)
    def note_ring(self, report: RingReport) -> None:
        self.memory.add_ring(report)
        released = report.acknowledged_count == self.machine.acknowledged_count
        self._judge(
            self.watchdog.check_ring(report.stamp_ns, report.condition, released=released), report.stamp_ns
        )

    @every("tick_hz")
    def watch(self) -> None:
        now_ns = self.now_ns()
        own = self.watchdog.check_itself(now_ns, 1.0 / self.params.tick_hz)
        late = [] if own is None else own or self.watchdog.overdue(now_ns)
        late += self._stopped_processes(now_ns)
        if self.machine.permits:
            self._judge(late, now_ns)
        elif self.machine.state is Standing.STARTING and own is not None and not late:
            self.permitted_ns = now_ns
            self._handle(Event.COMPLETE)
        if self.machine.state is Standing.STOPPING:
            self._act((Action.STOP,))
        else:
            self._judge_axes()
        self._publish_beat()

    def _stopped_processes(self, now_ns: int) -> list[LimitViolation]:
        if not self.params.watch_processes:
            return []
        moving = self.machine.state is Standing.MOVING
        if now_ns >= self.search_ns and not moving:
            self.search_ns = now_ns + SEARCH_NS
            self.processes.refresh()
        found = self.processes.stopped_or_ended(moving=moving)
        return [
            LimitViolation(Cause.HEARTBEAT, f"process {pid} of this graph {how}")
            for pid, how in found.items()
        ]

    def _judge_axes(self) -> None:
        """Judge what the controller has said of its axes on the own link."""
        axes = []
        try:
            axes = self.link.reports() if self.link is not None else []
        except DeviceError as error:
            self._judge([LimitViolation(Cause.LINK_LOST, f"the link of its own: {error}")], self.now_ns())
        for axis in axes:
            if not self.machine.permits:
                powered = self.machine.tripped and axis.enabled  # by an ENABLE that crossed the DISABLE
                if (axis.moving or powered) and axis.asked_ns > self.stopped_ns:
                    self._handle(Event.MOVES)
            elif axis.asked_ns > self.permitted_ns:  # before, a fault may have waited for FAULTACK
                fault = axis.fault.words if axis.fault else ""
                self._judge(self.watchdog.check_axis(axis.axis, fault, axis.following_m), self.now_ns())

    # What is done

    def _judge(self, found: list[LimitViolation], cause_ns: int) -> None:
        if found:
            self._handle(Event.TRIP, found[0], cause_ns)

    def _handle(self, event: Event, why: LimitViolation | None = None, cause_ns: int = 0) -> None:
        actions, machine, state = self.machine.handle(event, *(why or ())), self.machine, self.state
        state.standing, state.acknowledged_count = machine.state.value, machine.acknowledged_count
        state.cause, state.text = str(machine.cause or ""), machine.text
        self._act(actions, cause_ns)  # last: a trip is remembered whatever becomes of what it asks for

    def _act(self, actions: tuple[Action, ...], cause_ns: int = 0) -> None:
        written_ns, disabled_ns = self._stop_motion() if Action.STOP in actions else (0, 0)
        if Action.RECORD in actions:
            now_ns, cause, text = self.now_ns(), str(self.machine.cause), self.machine.text
            self.log.error("tripped: %s: %s", cause, text)
            times = {"cause_ns": cause_ns or now_ns, "written_ns": written_ns, "disabled_ns": disabled_ns}
            self.trip.publish(self.memory.trip(now_ns, cause, text, **times))
        if disabled_ns:
            self._handle(Event.STOPPED)

    def _stop_motion(self) -> tuple[int, int]:
        """ABORT first, then tell stage and ring, then DISABLE; return when both were written."""
        written_ns = disabled_ns = 0
        self.host.observe(self.now_ns())
        self.link = self.again.fetch() or self.link
        try:
            if self.link is not None:
                written_ns = self.link.abort()
            self._publish_beat()
            if self.link is not None:
                disabled_ns = self.link.finish_stop(written_ns).disabled_ns
            self.complaint = ""
        except DeviceError as error:
            self._publish_beat()
            if str(error) != self.complaint:  # it is tried a hundred times a second
                self.log.warning("the stage cannot be stopped on the own link: %s", error)
            self.complaint = str(error)
            if self.link is not None and self.again.start():
                self.link.close()
        self.stopped_ns = max(self.now_ns(), disabled_ns)
        return written_ns, disabled_ns

    def _new_link(self) -> AerotechStop:
        p = self.params
        timing = {"timeout_s": p.link_ms * 1e-3, "look_hz": p.look_hz}
        return AerotechStop(p.stop_url, p.axes, p.baud, **timing, clock=self.host.now_ns)

    @serve(stop)
    def obey(self, request: StopRequest) -> StatusReply:
        self._handle(Event.TRIP, LimitViolation(Cause.OPERATOR, request.reason), self.now_ns())
        return self._status()

    @serve(status)
    def tell(self, request: StatusRequest) -> StatusReply:
        return self._status()

    def _status(self) -> StatusReply:
        return StatusReply(
            state=self.state.standing,
            permits=self.machine.permits,
            cause=self.state.cause,
            text=self.state.text,
            warning=self._warning,
            acknowledged_count=self.state.acknowledged_count,
        )

    @serve(acknowledge)
    def release(self, request: AcknowledgeRequest) -> AcknowledgeReply:
        if not self.machine.tripped:
            text = "nothing to acknowledge: there is no trip"
            return AcknowledgeReply(done=False, state=self.machine.state.value, text=text)
        now_ns = self.now_ns()
        persisting = [*self.overloads, *self.watchdog.overdue(now_ns), *self._stopped_processes(now_ns)]
        if self.moving:
            persisting.append(LimitViolation(Cause.UNPERMITTED, "the stage is not known to be at rest yet"))
        self._handle(Event.ACKNOWLEDGE_EARLY if persisting else Event.ACKNOWLEDGE)
        if done := not self.machine.tripped:
            self.watchdog.arm()
            self._publish_beat()
            self.log.warning("acknowledged; motion is permitted once everything is heard again")
        text = persisting[0].text if persisting else "" if done else "the stop is not confirmed yet"
        return AcknowledgeReply(done=done, state=self.machine.state.value, text=text)

    @property
    def _warning(self) -> str:
        return self.watchdog.warning or ("" if self.params.stop_url else ONE_LINK)

    def _publish_beat(self) -> None:
        machine = self.machine
        self.beat.publish(
            SafetyBeat(
                stamp_ns=self.host.now_ns(),
                state=machine.state.value,
                permits=machine.permits,
                acknowledged_count=machine.acknowledged_count,
                cause=machine.cause or "",
                text=machine.text,
                warning=self._warning,
            )
        )
