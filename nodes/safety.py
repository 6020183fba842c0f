"""Watch torque, stage and actuator; stop motion on a link of its own; stay stopped until acknowledged."""

from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar, get_args

import numpy as np

from msgs.safety import (
    AcknowledgeReply,
    AcknowledgeRequest,
    LoadReport,
    RingReport,
    SafetyBeat,
    SafetyCheck,
    StageReport,
    StatusReply,
    StatusRequest,
    StopRequest,
    Trip,
)
from palp_core import DiagnosticStatus, Node, Params, Pub, Qos, ReadOnly, Srv, State, Sub, every, on, serve
from palp_core.errors import DeviceError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.limits import TravelLimits, WrenchLimits
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.reconnection import Reconnection
from palp_core.palpation.devices.protocols import Direction, StopLink
from palp_core.palpation.devices.registry import find_device_mistakes, open_stop_link, require_stop_link
from palp_core.palpation.devices.safety.link_check import LinkCheck, StagePlace
from palp_core.palpation.devices.safety.process_watch import ProcessWatch
from palp_core.palpation.devices.safety.state_machine import Action, Cause, Event, SafetyMachine
from palp_core.palpation.devices.safety.state_machine import SafetyState as Standing
from palp_core.palpation.devices.safety.watchdog import (
    LimitViolation,
    Watchdog,
    WatchedLoad,
    WatchedStage,
    WatchLimits,
)
from palp_core.palpation.nano17 import RANGE_N, RANGE_N_M
from palp_core.units import (
    DeadlineMilliseconds,
    HertzPositive,
    Metres,
    MetresPerSecondPositive,
    MillimetresNonNegative,
    MillimetresPositive,
    MillisecondsPositive,
    NewtonMillimetresPositive,
    NewtonsPositive,
)

SEARCH_NS = 1_000_000_000
KEEP_NS = 1_000_000_000
ADVICE = "motion is stopped; when all is well, type: palp safety ack"
GOES_ON = (
    "once all that is watched has reported again, the rig goes on by itself: the stage raises the probe "
    "slowly, and a palpation that was cut is done again, in the same trial; nothing is to be pressed"
)
"""What follows an acknowledgement, by the rig's own stage and experiment."""
NO_LINK = "none"
"""What ``stop_link`` says of a rig without a link of the safety node's own."""
ONE_LINK = (
    "stop_link: none: a stop reaches the stage through its node alone, and homing is "
    "stopped by nothing but the emergency stop: keep a hand on it; give the stage segment_m: 0.002 and "
    "home_on_open: false"
)
DIRECTIONS: tuple[Direction, ...] = get_args(Direction)
NOT_VERIFIED = {
    "emergency stop": "no software can see it: press it, and see that the drives lose power",
    "death of processes": "not tried in this run: the guard of each link is to stop the stage",
    "loss of the host or of the controller's link": (
        "nothing stops the stage: it goes on to the end of the move it was sent, a whole sweep at most,"
        " or segment_m of the stage"
    ),
    "ring": "if its node or link dies, it goes on to the end of its move",
}
"""What no check of this node covers."""
UNSEEN = "own link not yet seen to follow the stage: no sweep before that"


class SafetyParams(Params):
    """Set in the launch file. The limits are assumed.

    ``range_n_mm`` and ``range_n`` are the largest torque and force that the sensor can measure (the maker's
    figures for SI-12-0.12); a stop above them could never trip and is refused.

    ``device`` and ``options`` are the stage's driver and its options, as the stage's node has them.
    ``stop_link`` is the address of a second link to that stage's controller, or ``none``: then a trip reaches
    the stage through its node only. ``link_ms`` is the longest wait for an answer there: 2 mm at the speed of
    a sweep. ``watch_processes`` trips when a process of the graph is stopped by a signal, or ends in a sweep.
    """

    device: ReadOnly[str]
    stop_link: ReadOnly[str]
    options: ReadOnly[dict[str, Any]] = {}
    tick_hz: ReadOnly[HertzPositive] = 100.0
    look_hz: ReadOnly[HertzPositive] = 20.0
    link_ms: ReadOnly[MillisecondsPositive] = 100.0
    warn_n_mm: ReadOnly[NewtonMillimetresPositive] = 80.0
    stop_n_mm: ReadOnly[NewtonMillimetresPositive] = 100.0
    warn_n: ReadOnly[NewtonsPositive] = 8.0
    stop_n: ReadOnly[NewtonsPositive] = 10.0
    range_n_mm: ReadOnly[NewtonMillimetresPositive] = RANGE_N_M * 1e3
    range_n: ReadOnly[NewtonsPositive] = RANGE_N
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    across_from_m: ReadOnly[Metres] = 0.0
    across_to_m: ReadOnly[Metres] = 0.0
    margin_mm: ReadOnly[MillimetresNonNegative] = 4.0
    lift_mm: ReadOnly[MillimetresPositive] = 20.0
    speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.050
    following_mm: ReadOnly[MillimetresPositive] = 0.5
    stale_ms: ReadOnly[DeadlineMilliseconds] = 25.0
    beat_ms: ReadOnly[DeadlineMilliseconds] = 50.0
    watch_processes: ReadOnly[bool] = True


def limits_of(p: SafetyParams) -> WatchLimits:
    """Return the limits of the watchdog.

    Raises:
        DeviceError: They contradict each other, or the sensor's range.
    """
    return WatchLimits(
        wrench=WrenchLimits(
            p.warn_n_mm * 1e-3, p.stop_n_mm * 1e-3, p.warn_n, p.stop_n, p.range_n_mm * 1e-3, p.range_n
        ),
        travel=TravelLimits.around(
            p.from_m,
            p.to_m,
            p.margin_mm * 1e-3,
            p.lift_mm * 1e-3,
            p.speed_m_s,
            across_m=(p.across_from_m, p.across_to_m),
        ),
        raised_m=p.lift_mm * 1e-3,
        following_m=p.following_mm * 1e-3,
        stale_s=p.stale_ms * 1e-3,
        beat_s=p.beat_ms * 1e-3,
    )


class LastSecond:
    """Remember loads, places and ring positions for a second, by when they were reported.

    A sample may be stamped with any nonsense, a report is not.
    """

    def __init__(self) -> None:
        self.loads, self.places, self.rings = (deque[tuple[int, tuple[float, ...]]]() for _ in range(3))

    def add(self, rows: deque[tuple[int, tuple[float, ...]]], reported_ns: int, *row: float) -> None:
        """Remember a row and forget what is too old."""
        rows.append((reported_ns, row))
        while rows[0][0] < reported_ns - KEEP_NS:
            rows.popleft()

    def trip(
        self, now_ns: int, cause: str, text: str, *, cause_ns: int, written_ns: int, disabled_ns: int
    ) -> Trip:
        """Return the record of a trip."""
        loads, places, rings = (
            np.array([row for _, row in rows], dtype=np.float64).reshape(-1, width)
            for rows, width in ((self.loads, 3), (self.places, 4), (self.rings, 2))
        )
        return Trip(
            stamp_ns=now_ns,
            cause=cause,
            text=text,
            cause_ns=cause_ns,
            written_ns=written_ns,
            disabled_ns=disabled_ns,
            load_time_s=(loads[:, 0] - now_ns) * 1e-9,
            torque_n_m=loads[:, 1],
            force_n=loads[:, 2],
            stage_time_s=(places[:, 0] - now_ns) * 1e-9,
            y_m=places[:, 1],
            z_m=places[:, 2],
            x_m=places[:, 3],
            ring_time_s=(rings[:, 0] - now_ns) * 1e-9,
            ring_m=rings[:, 1],
        )


class SafetyNodeState(State):
    """What a replacement inherits: a trip outlives its node."""

    standing: str = "starting"
    cause: str = ""
    text: str = ""
    acknowledged_count: int = 0


class Safety(Node):
    """Trip at the first limit that is passed: ABORT, then DISABLE, hold the ring, latch, and say why."""

    moves = True
    same_params: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "stage": (
            "device", "options", "from_m", "to_m", "across_from_m", "across_to_m", "margin_mm", "lift_mm",
            "speed_m_s", "beat_ms",
        ),
        "ring": ("beat_ms",),
        "load": ("range_n_mm",),
    }  # fmt: skip
    params: SafetyParams
    state: SafetyNodeState
    load = Sub(LoadReport)
    stage = Sub(StageReport)
    ring = Sub(RingReport)
    beat = Pub(SafetyBeat)
    trip = Pub(Trip, qos=Qos(durability="transient_local", depth=20))
    diagnostics = Pub(DiagnosticStatus, qos=Qos(durability="transient_local", depth=100))
    stop = Srv(StopRequest, StatusReply)
    acknowledge = Srv(AcknowledgeRequest, AcknowledgeReply)
    status = Srv(StatusRequest, StatusReply)

    @classmethod
    def find_mistakes(cls, params: SafetyParams, mistakes: Mistakes) -> None:
        guilty = {
            "stop_n_mm": params.stop_n_mm > params.range_n_mm,
            "warn_n_mm": params.warn_n_mm > params.stop_n_mm,
            "stop_n": params.stop_n > params.range_n,
            "warn_n": params.warn_n > params.stop_n,
        }
        with mistakes.of(next((name for name, wrong in guilty.items() if wrong), "")):
            limits_of(params)
        find_device_mistakes("stage", params.device, None, mistakes)
        with mistakes.of("stop_link"):
            if not params.stop_link:
                raise DeviceError("it is empty; give the address of the stage's second link, or none")
            if params.stop_link != NO_LINK:
                require_stop_link(params.device)

    def on_configure(self) -> None:
        self.watchdog, state = Watchdog(limits_of(self.params)), self.state
        cause = Cause(state.cause) if state.cause else None
        self.machine = SafetyMachine(Standing(state.standing), cause, state.text)
        self.machine.acknowledged_count = state.acknowledged_count
        self.host, self.processes = HostTime(), ProcessWatch()
        self.link: StopLink | None = None
        self.check = LinkCheck(self.watchdog.limits.fastest_m_per_s)
        self.again, self.complaint = Reconnection(self._new_link), ""
        self.memory, self.overloads = LastSecond(), list[LimitViolation]()
        self.stopped_ns = self.permitted_ns = self.search_ns = self.looked_ns = 0
        self.moving = False

    def on_activate(self) -> None:
        self.host.observe(self.now_ns())
        self.link = self._new_link() if self.params.stop_link != NO_LINK else None
        if self.link is None:
            self.log.warning("%s", ONE_LINK)
        self._publish_status()

    on_resume = on_activate

    def on_deactivate(self) -> None:
        self.again.close()
        self.processes.close()
        if self.link is None:
            return
        try:
            if self.machine.state is Standing.MOVING or any(axis.moving for axis in self.link.poll()):
                self.link.trip()  # the stage's node may be gone, and before it could say that a move began
        except DeviceError as error:
            self.log.warning("the stage could not be stopped at the end: %s", error)
        finally:
            self.link.close()

    # What is received

    @on(load)
    def note_load(self, report: LoadReport) -> None:
        if report.sample_count:
            row = (report.sample_ns, report.torque_n_m, report.force_n)
            self.memory.add(self.memory.loads, report.stamp_ns, *row)
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
        row = (report.stamp_ns, report.y_m, report.z_m, report.x_m)
        self.memory.add(self.memory.places, report.stamp_ns, *row)
        released = report.acknowledged_count == self.machine.acknowledged_count
        place = (report.stamp_ns, report.y_m, report.z_m, report.speed_m_s)
        words = report.condition, report.text
        seen = WatchedStage(*place, report.moving, report.bring_up, released, *words, report.x_m)
        self._judge(self.watchdog.check_stage(seen), report.stamp_ns)
        self.check.note_stage(
            StagePlace(report.asked_ns, report.answered_ns, report.y_m, report.z_m, report.x_m)
        )
        self._judge_link(report.stamp_ns)
        self.moving = report.moving
        if report.stamp_ns <= self.stopped_ns:  # from before the stop was done
            return
        if self.machine.state is Standing.STOPPING and not self._link_stops and not report.moving:
            self._handle(Event.STOPPED)
        elif released:
            self._handle(Event.MOVES if report.moving or report.bring_up else Event.RESTS)

    @on(ring)
    def note_ring(self, report: RingReport) -> None:
        self.memory.add(self.memory.rings, report.stamp_ns, report.stamp_ns, report.ring_m)
        released = report.acknowledged_count == self.machine.acknowledged_count
        seen = report.stamp_ns, report.condition, report.text
        self._judge(self.watchdog.check_ring(*seen, released=released), report.stamp_ns)

    @every("tick_hz")
    def watch(self) -> None:
        now_ns = self.now_ns()
        self.host.observe(now_ns)
        own = self.watchdog.check_itself(now_ns, 1.0 / self.params.tick_hz)
        late = [] if own is None else own or self.watchdog.overdue(now_ns)
        late += self._stopped_processes(now_ns)
        if self.machine.permits:
            self._judge(late, now_ns)
        elif self.machine.state is Standing.STARTING and own is not None and not late:
            self.permitted_ns = now_ns
            self._handle(Event.COMPLETE)
        written = self.check.contradiction and not self.complaint  # to another controller: once is enough
        if self.machine.state is Standing.STOPPING and not written:
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
        """Judge what the controller has answered of its axes on the own link."""
        axes = []
        try:
            axes = self.link.reports() if self.link is not None else []
        except DeviceError as error:
            self.check.forget()
            self._judge([LimitViolation(Cause.LINK_LOST, f"the link of its own: {error}")], self.now_ns())
        for axis in axes:
            self.looked_ns = max(self.looked_ns, axis.answered_ns)
            self.check.note_axis(axis)
            self._judge_link(axis.answered_ns)
            if not self.machine.permits:
                powered = self.machine.tripped and axis.enabled  # by an ENABLE that crossed the DISABLE
                if (axis.moving or powered) and axis.asked_ns > self.stopped_ns:
                    self._handle(Event.MOVES)
            elif axis.asked_ns > self.permitted_ns:  # before, a fault may have waited for FAULTACK
                self._judge(self.watchdog.check_axis(axis.axis, axis.fault, axis.following_m), self.now_ns())

    @property
    def _link_stops(self) -> bool:
        """Whether a stop that was written to the own link counts as one of this stage."""
        return self.link is not None and not self.check.contradiction

    def _link_violation(self) -> list[LimitViolation]:
        return [LimitViolation(Cause.WRONG_LINK, text)] if (text := self.check.contradiction) else []

    def _judge_link(self, cause_ns: int) -> None:
        if self.machine.permits:
            self._judge(self._link_violation(), cause_ns)

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
            self._publish_status()
            self.trip.publish(self.memory.trip(now_ns, cause, text, **times))
        if disabled_ns and self._link_stops:
            self._handle(Event.STOPPED)

    def _stop_motion(self) -> tuple[int, int]:
        """ABORT first, then the beat for stage and ring, then DISABLE; return when both were written."""
        written_ns = disabled_ns = 0
        self.host.observe(self.now_ns())
        if (link := self.again.fetch()) is not None:
            self.link = link
            self.check.forget()
        try:
            if self.link is not None:
                written_ns = self.link.abort()
            self._publish_beat()
            if self.link is not None:
                disabled_ns = self.link.finish_stop(written_ns).disabled_ns
            self.complaint = ""
        except DeviceError as error:
            self.check.forget()
            self._publish_beat()
            if str(error) != self.complaint:  # log once: this runs at tick_hz
                self.log.warning("the stage cannot be stopped on the own link: %s", error)
            self.complaint = str(error)
            if self.link is not None and self.again.start():
                self.link.close()
        self.stopped_ns = max(self.now_ns(), disabled_ns)
        return written_ns, disabled_ns

    def _new_link(self) -> StopLink:
        p = self.params
        return open_stop_link(
            p.device,
            p.options,
            p.stop_link,
            timeout_s=p.link_ms * 1e-3,
            look_hz=p.look_hz,
            clock=self.host.now_ns,
        )

    @serve(stop)
    def obey(self, request: StopRequest) -> StatusReply:
        if self.machine.tripped and self.state.cause != Cause.OPERATOR:
            self.log.warning("stop requested (%s), already stopped", request.reason)
        self._handle(Event.TRIP, LimitViolation(Cause.OPERATOR, request.reason), self.now_ns())
        return self._status()

    @serve(status)
    def report_status(self, request: StatusRequest) -> StatusReply:
        return self._status()

    def _status(self) -> StatusReply:
        return StatusReply(
            stamp_ns=self.now_ns(),
            state=self.state.standing,
            permits=self.machine.permits,
            permits_sweep=self._permits_sweep,
            cause=self.state.cause,
            text=self.state.text,
            warning=self._warning,
            acknowledged_count=self.state.acknowledged_count,
            checks=self._checks(),
        )

    @serve(acknowledge)
    def release(self, request: AcknowledgeRequest) -> AcknowledgeReply:
        if not self.machine.tripped:
            text = "nothing to acknowledge: there is no trip"
            return AcknowledgeReply(done=False, state=self.machine.state.value, text=text)
        now_ns = self.now_ns()
        persisting = [*self.overloads, *self._link_violation()]
        persisting += [*self.watchdog.overdue(now_ns), *self._stopped_processes(now_ns)]
        if self.moving:
            persisting.append(LimitViolation(Cause.UNPERMITTED, "the stage is not known to be at rest yet"))
        self._handle(Event.ACKNOWLEDGE_EARLY if persisting else Event.ACKNOWLEDGE)
        if done := not self.machine.tripped:
            self.watchdog.arm()
            self._publish_beat()
            self._publish_status()
            self.log.warning("acknowledged; %s", GOES_ON)
        text = persisting[0].text if persisting else GOES_ON if done else "the stop is not confirmed yet"
        return AcknowledgeReply(done=done, state=self.machine.state.value, text=text)

    @property
    def _warning(self) -> str:
        if self.watchdog.warning:
            return self.watchdog.warning
        if self.link is None:
            return ONE_LINK
        return "" if self.check.verified_ns("y") else UNSEEN

    @property
    def _permits_sweep(self) -> bool:
        return self.machine.permits and (self.link is None or self.check.verified_ns("y") > 0)

    def _checks(self) -> list[SafetyCheck]:
        """Return what the rig's safety rests on, and when each was verified."""
        found = [] if self.link is None else self._link_checks(self.link)
        if self.link is None:
            found.append(SafetyCheck(name="own link", verified_ns=0, text=ONE_LINK))
        found += [
            SafetyCheck(name=name, verified_ns=at, text="reported" if at else "no report yet")
            for name, at in self.watchdog.reported_ns.items()
        ]
        found += [SafetyCheck(name=name, verified_ns=0, text=text) for name, text in NOT_VERIFIED.items()]
        return found

    def _link_checks(self, link: StopLink) -> list[SafetyCheck]:
        found = [
            SafetyCheck(
                name=f"own link, {direction}",
                verified_ns=self.check.verified_ns(direction),
                text=self.check.result(direction),
            )
            for direction in DIRECTIONS
            if direction != "x" or self.watchdog.limits.travel.across
        ]
        guarded_ns, text = (self.looked_ns, "its process is alive") if link.guarded else (0, "there is none")
        found.append(SafetyCheck(name="guard of own link", verified_ns=guarded_ns, text=text))
        return found

    def _publish_status(self) -> None:
        """Publish what a person is to see, in whichever view."""
        now_ns, tripped = self.now_ns(), f"tripped: {self.state.cause}: {self.state.text}"
        self.diagnostics.publish(
            DiagnosticStatus(stamp_ns=now_ns, level="error", text=tripped, advice=ADVICE)
            if self.machine.tripped
            else DiagnosticStatus(stamp_ns=now_ns)
        )

    def _publish_beat(self) -> None:
        machine = self.machine
        self.beat.publish(
            SafetyBeat(
                stamp_ns=self.host.now_ns(),
                state=machine.state.value,
                permits=machine.permits,
                permits_sweep=self._permits_sweep,
                acknowledged_count=machine.acknowledged_count,
                cause=machine.cause or "",
                text=machine.text,
                warning=self._warning,
            )
        )
