"""Sweep the probe over the phantom at constant speed, and return by another path."""

import math
from collections.abc import Callable
from typing import Any, ClassVar

import msgspec
import numpy as np

from msgs.stage import StagePose, SweepGoal, SweepStatus
from palp_core import Alarm, Params, Pub, ReadOnly, Sub, Timer, on
from palp_core.errors import DeviceError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.blocks import Stream, check_block, late_blocks
from palp_core.palpation.devices.device_node import DeviceNode, DeviceNodeState
from palp_core.palpation.devices.limits import TravelLimits, check_lift
from palp_core.palpation.devices.protocols import StageDevice, StageOptions
from palp_core.palpation.devices.registry import find_device_mistakes, open_device
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import StagePath
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.units import (
    CountPositive,
    HertzPositive,
    Metres,
    MetresPerSecondPositive,
    MillimetresNonNegative,
    MillimetresPositive,
)

END_NS = 50_000_000
"""The end of a sweep is published at the next multiple of this, so that no time depends on the blocks."""


class StageParams(Params):
    """Set in the launch file.

    ``scene`` is the scene file that says how deep the probe enters the gel (empty: the default scene), which
    ``lift_mm``, the height of the way back, must clear.
    ``device`` is the stage's driver, ``options`` what it takes beyond :class:`.StageOptions`.
    ``across_from_m`` and ``across_to_m`` are the outermost lanes of sweeps, places across them, for a stage
    with a third axis; both 0: it does not move across.
    ``within_sweep``: somebody acts on torque while a sweep lasts, for whom long blocks are late.
    """

    device: ReadOnly[str] = "sim"
    options: ReadOnly[dict[str, Any]] = {}
    scene: ReadOnly[str] = ""
    lift_mm: ReadOnly[MillimetresPositive] = 20.0
    rate_hz: HertzPositive = 1000.0
    block_samples: CountPositive = 50
    within_sweep: ReadOnly[bool] = True
    sweep_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.020
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    across_from_m: ReadOnly[Metres] = 0.0
    across_to_m: ReadOnly[Metres] = 0.0
    margin_mm: ReadOnly[MillimetresNonNegative] = 4.0
    speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.050
    lift_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.020

    @property
    def block_hz(self) -> float:
        """Rate of pose blocks."""
        return self.rate_hz / self.block_samples

    @property
    def stream(self) -> Stream:
        """What its poses, and the torque that follows them, are needed for."""
        return "torque" if self.within_sweep else "sweep"


def require_clearance(params: StageParams) -> None:
    """Refuse a lift at which the raised probe would be dragged through the scene's gel."""
    path = read_scene(params.scene).path if params.scene else StagePath()
    check_lift(params.lift_mm * 1e-3, path.indentation_m)


def device_options(params: StageParams) -> dict[str, Any]:
    """Return what every stage's node hands its driver; the driver's own options come apart."""
    handed = StageOptions(
        limits=window_of(params),
        sweep_speed_m_per_s=params.sweep_speed_m_s,
        lift_speed_m_per_s=params.lift_speed_m_s,
        lift_m=params.lift_mm * 1e-3,
    )
    return msgspec.structs.asdict(handed)


def window_of(params: StageParams) -> TravelLimits:
    """Return where a stage may go and how fast, by the launch file."""
    margin_m, lift_m = params.margin_mm * 1e-3, params.lift_mm * 1e-3
    across_m = params.across_from_m, params.across_to_m
    return TravelLimits.around(
        params.from_m, params.to_m, margin_m, lift_m, params.speed_m_s, across_m=across_m
    )


def open_stage(params: StageParams) -> StageDevice[Any]:
    """Return the driver.

    Raises:
        DeviceError: An option is wrong, or lanes are given to a stage that does not move across.
    """
    device = open_device("stage", params.device, **driver_options(params))
    if window_of(params).across and not device.moves_across:
        raise DeviceError(
            f"stage device '{params.device}' has two axes and cannot go from lane to lane; name a third axis"
            " (of aerotech: axes, origin_m and sign of three), or leave across_from_m and across_to_m at 0"
        )
    return device


def driver_options(params: StageParams) -> dict[str, Any]:
    """Return all that the driver is given.

    Raises:
        DeviceError: An option is the node's own parameter, too; or the limits contradict each other.
    """
    if twice := sorted(set(StageOptions.__struct_fields__) & set(params.options)):
        raise DeviceError(f"{', '.join(twice)}: the node's own parameters say this; remove it from options")
    return {**device_options(params), **params.options}


class StageState(DeviceNodeState):
    """What a replacement inherits."""

    activity: str = "ready"
    waiting: list[SweepGoal] = []
    goal_id: int = 0
    from_m: float = 0.0
    to_m: float = 0.0
    across_m: float = 0.0
    enter_ns: int = 0
    leave_ns: int = 0
    end_ns: int = 0
    next_sample: int = 0
    sample_count: int = 0
    at_start: bool = False


class Stage(DeviceNode):
    """Follow sweep goals one after another; publish positions only while over the phantom."""

    LAG_NS: ClassVar[int] = 0
    moves = True
    params: StageParams
    state: StageState
    device: StageDevice[Any]
    goal = Sub(SweepGoal)
    pose = Pub(StagePose)
    status = Pub(SweepStatus)
    block = Timer(hz="block_hz")
    ending = Alarm()
    arrival = Alarm()

    @classmethod
    def find_mistakes(cls, params: StageParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)
        if mistakes:
            return
        with mistakes.of("lift_mm"):
            require_clearance(params)
        with mistakes.of("block_samples"):
            check_block(params.block_samples, params.rate_hz)
        with mistakes.of(""):
            device_options(params)
        with mistakes.of("options"):
            find_device_mistakes("stage", params.device, driver_options(params), mistakes)
        if not mistakes:
            with mistakes.of("across_to_m"):
                open_stage(params)

    def on_configure(self) -> None:
        self.make_device()
        length_s, stream = 1.0 / self.params.block_hz, self.params.stream
        if late := late_blocks(stream, length_s, wall_clock=False):  # torque follows the poses
            self.log.warning("%s", late)

    def make_device(self) -> None:
        params = self.params
        require_clearance(params)
        self.device, self.window = open_stage(params), window_of(params)

    def on_activate(self) -> None:
        self.state.activity, self.state.at_start = "ready", False
        super().on_activate()

    def on_deactivate(self) -> None:
        self.device.stop(self.now_ns(), self.memory)
        super().on_deactivate()

    @on(goal)
    def accept(self, goal: SweepGoal) -> None:
        if not goal.cancel:
            self.state.waiting.append(goal)
            self.begin_waiting()
            return
        self.state.waiting.clear()
        if self.cancels(goal):
            self._cancel()

    def begin_waiting(self) -> None:
        """Begin the first goal that waits, if the stage is ready for it."""
        state = self.state
        if state.activity != "ready" or not state.waiting:
            return
        goal = state.waiting.pop(0)
        lane, there = (goal.from_m, goal.to_m, goal.across_m), (state.from_m, state.to_m, state.across_m)
        state.at_start = state.at_start and lane == there
        state.goal_id, (state.from_m, state.to_m, state.across_m) = goal.goal_id, lane
        if state.at_start:
            self._sweep()
        else:
            self._return("returning")

    def cancels(self, goal: SweepGoal) -> bool:
        """Return whether there is anything to cancel: not a goal that is over, nor another than asked for."""
        return goal.goal_id == self.state.goal_id and self.state.activity in ("returning", "sweeping")

    def _cancel(self) -> None:
        self.block.stop()
        self.ending.clear()
        self.state.activity, self.state.at_start = "cancelled", False
        self.arrival.set(self.device.stop(self.now_ns(), self.memory))
        self._publish_status("cancelled")

    def _return(self, activity: str) -> None:
        """Go by the other path to where the sweep starts."""
        self.state.activity = activity
        self.begin_move(self._go_back)

    def begin_move(self, move: Callable[[], int]) -> None:
        """Begin a move, which returns when it will arrive."""
        self.arrival.set(move())

    def _go_back(self) -> int:
        """Send the device to where the sweep starts; return the time of arrival in ns."""
        self.window.check_across(self.state.across_m)
        start_m = self.device.sweep_start(self.state.from_m, self.state.to_m)
        lane = {"across_m": self.state.across_m} if self.window.across else {}
        return int(self.device.return_to(start_m, self.now_ns(), self.memory, **lane))

    def _sweep(self) -> None:
        state = self.state
        times = self.device.sweep(state.from_m, state.to_m, self.now_ns(), self.memory)
        state.activity, state.at_start = "sweeping", False
        state.enter_ns, state.leave_ns, state.end_ns = times.enter_ns, times.leave_ns, times.end_ns
        state.next_sample = self._first_sample(times.enter_ns)
        state.sample_count = 0
        self.block.start()
        if self.params.block_hz * END_NS < 1e9:  # else a block ends as soon
            self.ending.set(-(-(times.leave_ns + self.LAG_NS) // END_NS) * END_NS)
        self._publish_status("sweeping")

    @on(arrival)
    def arrive(self) -> None:
        activity = self.state.activity
        if activity == "returning":
            self._sweep()
        elif activity == "swept":
            self._return("resting")
        else:
            self.state.activity, self.state.at_start = "ready", activity == "resting"
            self._publish_status("ready")
            self.begin_waiting()

    @on(ending)
    def _cut_short(self) -> None:
        """Publish the rest of a sweep, and that it is over, before a long block is full."""
        self.sample()

    @on(block)
    def sample(self) -> None:
        known_ns = self.now_ns() - self.LAG_NS  # what a polled device knows
        self._publish_pose(known_ns)
        if known_ns >= self.state.leave_ns:
            self._measure_interval()
            self._end_sweep()

    def _publish_pose(self, known_ns: int) -> None:
        """Publish where the stage was up to a time, if it was over the phantom."""
        state = self.state
        following = self._first_sample(min(known_ns, state.leave_ns) + 1)
        if following > state.next_sample:
            times_ns = np.rint(np.arange(state.next_sample, following) * 1e9 / self.params.rate_hz)
            times_ns = times_ns.astype(np.int64)
            reading = self.device.read(times_ns, self.memory)
            state.next_sample = following
            state.sample_count += len(times_ns)
            self.pose.publish(
                StagePose(
                    stamp_ns=self.now_ns(),
                    goal_id=state.goal_id,
                    start_ns=int(times_ns[0]),
                    rate_hz=self.params.rate_hz,
                    position_m=reading.y_m,
                    across_m=self._measured_across_m(),
                )
            )

    def _measured_across_m(self) -> float:
        return self.device.feedback(self.now_ns(), self.memory).x_m if self.window.across else 0.0

    def _end_sweep(self) -> None:
        self.block.stop()
        self.ending.clear()
        self.state.activity = "swept"
        self.arrival.set(self.state.end_ns)
        self._publish_status("swept")

    def _measure_interval(self) -> None:
        """Leave the times as the device has predicted them: those of a simulated one are exact."""

    def _stamp_ns(self, sample: int) -> int:
        return round(sample * 1e9 / self.params.rate_hz)

    def _first_sample(self, from_ns: int) -> int:
        """Return the number of the first sample of the grid that is not before a time."""
        sample = math.ceil(from_ns * self.params.rate_hz / 1e9)
        while self._stamp_ns(sample - 1) >= from_ns:  # the product was rounded up
            sample -= 1
        while self._stamp_ns(sample) < from_ns:
            sample += 1
        return sample

    def _publish_status(self, status: str) -> None:
        state = self.state
        self.status.publish(
            SweepStatus(
                stamp_ns=self.now_ns(),
                goal_id=state.goal_id,
                status=status,
                enter_ns=state.enter_ns,
                leave_ns=state.leave_ns,
                sample_count=state.sample_count,
            )
        )
