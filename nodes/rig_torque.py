"""Stream the torque of a real sensor, and report its loads to the safety node at once."""

from math import isfinite
from operator import or_
from typing import Any, Literal

import numpy as np

from msgs.safety import LoadReport
from msgs.torque import TorqueBlock
from palp_core import Params, Pub, ReadOnly, Timer, on
from palp_core.errors import DeviceError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.blocks import check_block, late_blocks
from palp_core.palpation.devices.device_node import DeviceNodeState, SensorNode
from palp_core.palpation.devices.protocols import TorqueSamples as Samples
from palp_core.palpation.devices.protocols import TorqueSensor
from palp_core.palpation.devices.registry import find_device_mistakes, open_device
from palp_core.palpation.nano17 import RANGE_N_M
from palp_core.units import CountPositive, HertzPositive, MillisecondsPositive, NewtonMillimetresPositive

LARGEST_N_M, LARGEST_N = 1e3, 1e4  # bounds of the message's fields


class RigTorqueParams(Params):
    """Set in the launch file.

    ``load_hz`` is how often the sensor is asked for what came, ``block_samples`` how many samples make a
    block. ``tare`` takes the mean of the first ``tare_samples`` for zero: the probe must hang free then;
    ``never`` keeps the zero that the state brings. ``largest_gap_ms`` is the longest time between two samples
    of one block. ``range_n_mm`` is the largest torque that the sensor can measure (the maker's figure for
    SI-12-0.12), as of the safety node.
    """

    def driver_options(self) -> dict[str, Any]:
        """Return the options of the driver, those of ``options`` last."""
        return {"rate_hz": self.rate_hz, "range_n_m": self.range_n_mm * 1e-3, **self.options}

    device: ReadOnly[str] = "ati"
    options: ReadOnly[dict[str, Any]] = {}
    rate_hz: ReadOnly[HertzPositive] = 1000.0
    range_n_mm: ReadOnly[NewtonMillimetresPositive] = RANGE_N_M * 1e3
    load_hz: HertzPositive = 1000.0
    block_samples: CountPositive = 20
    tare: Literal["start", "never"] = "start"
    tare_samples: CountPositive = 500
    largest_gap_ms: MillisecondsPositive = 3.0


class RigTorqueState(DeviceNodeState):
    """What a replacement inherits: the bias is in the record with the data."""

    tared: bool = False


class RigTorque(SensorNode):
    """Publish blocks always, not only while something is swept; the estimator cuts them by time."""

    params: RigTorqueParams
    state: RigTorqueState
    device: TorqueSensor[Any]
    block = Pub(TorqueBlock)
    load = Pub(LoadReport)
    tick = Timer(hz="load_hz", running=True)

    @classmethod
    def find_mistakes(cls, params: RigTorqueParams, mistakes: Mistakes) -> None:
        with mistakes.of("block_samples"):
            check_block(params.block_samples, params.rate_hz)
        with mistakes.of("options"):
            if "range_n_m" in params.options:
                raise DeviceError("range_n_m: set range_n_mm in its place, as the safety node needs it, too")
            find_device_mistakes("torque", params.device, params.driver_options(), mistakes)

    def on_configure(self) -> None:
        p = self.params
        self.device = open_device("torque", p.device, **p.driver_options())
        for late in (
            late_blocks("torque", p.block_samples / p.rate_hz, wall_clock=True),
            late_blocks("load", 1.0 / p.load_hz, wall_clock=True),
        ):
            if late:
                self.log.warning("%s", late)
        self.first: list[Samples] = []
        self.times_ns: list[int] = []
        self.torque_n_m: list[float] = []
        self.saturated_count = 0
        self.sample_ns = 0

    def on_activate(self) -> None:
        self.state.tared = self.state.tared or self.params.tare == "never"
        super().on_activate()

    def on_resume(self) -> None:
        self.on_activate()

    def drain_rest(self) -> None:
        self.drain()
        if self.times_ns:  # the block that is not full yet
            self._publish()

    @on(tick)
    def drain(self) -> None:
        samples = self.drain_device()
        if not self.state.tared:
            self._tare(samples)
            return
        self._report(samples)
        self._gather(samples)

    def _tare(self, samples: Samples) -> None:
        """Collect the first samples, unloaded; nothing is reported before, so nothing may move."""
        self.first.append(samples)
        if sum(len(s.times_ns) for s in self.first) < self.params.tare_samples:
            return
        parts, self.first = self.first, []
        try:
            zero = self.device.tare(
                Samples(
                    np.concatenate([s.times_ns for s in parts]),
                    np.concatenate([s.torque_n_m for s in parts]),
                    sum(s.saturated_count for s in parts),
                    faulty=np.concatenate([s.faulty for s in parts]),
                    wrench=np.concatenate([s.wrench for s in parts]),
                ),
                self.memory,
            )
        except DeviceError as error:
            self.log.warning("%s", error)
            return
        self.state.tared = True
        self.log.info("zero: %s", [f"{value:.5f}" for value in zero])

    def _report(self, samples: Samples) -> None:
        """Report how large the loads are; a number that is none counts as faulty.

        Plain numbers: one or two samples come at a time, of which arrays make ten times the work.
        """
        count = len(samples.times_ns)
        torque_n_m, force_n, faulty_count, gap_count = 0.0, 0.0, 0, 0
        if count:
            self.sample_ns = max(0, int(samples.times_ns[-1]))
            torque_n_m, force_n, broken = _largest(samples)
            flagged = samples.faulty.tolist() or [False] * count
            faulty_count = sum(map(or_, flagged, broken)) - samples.saturated_count
            gap_count = sum(samples.gap.tolist())
        now_ns = self.now_ns()
        self.load.publish(
            LoadReport(
                stamp_ns=now_ns,
                sample_ns=self.sample_ns,
                sample_count=count,
                torque_n_m=min(torque_n_m, LARGEST_N_M),
                force_n=min(force_n, LARGEST_N),
                saturated_count=samples.saturated_count,
                faulty_count=faulty_count,
                gap_count=gap_count,
                condition=self.device.health(now_ns).condition.value,
            )
        )

    def _gather(self, samples: Samples) -> None:
        """Make blocks of equal steps of time; a gap ends one."""
        longest_ns = round(self.params.largest_gap_ms * 1e6)
        for stamp_ns, torque_n_m in zip(samples.times_ns.tolist(), samples.torque_n_m.tolist(), strict=True):
            good = isfinite(torque_n_m)
            if self.times_ns and (not good or stamp_ns - self.times_ns[-1] > longest_ns):
                self._publish()
            if good:
                self.times_ns.append(stamp_ns)
                self.torque_n_m.append(torque_n_m)
        self.saturated_count += samples.saturated_count
        if len(self.times_ns) >= self.params.block_samples:
            self._publish()

    def _publish(self) -> None:
        count = len(self.times_ns)
        span_s = (self.times_ns[-1] - self.times_ns[0]) * 1e-9
        rate_hz = (count - 1) / span_s if count > 1 and span_s > 0.0 else self.params.rate_hz
        self.block.publish(
            TorqueBlock(
                stamp_ns=self.now_ns(),
                start_ns=max(0, self.times_ns[0]),
                rate_hz=rate_hz,
                over_phantom=False,
                saturated_count=self.saturated_count,
                torque_n_m=np.array(self.torque_n_m),
            )
        )
        self.times_ns, self.torque_n_m, self.saturated_count = [], [], 0


def _largest(samples: Samples) -> tuple[float, float, list[bool]]:
    """Return the largest torque and force of any axis, and which samples have a number that is none."""
    rows = samples.wrench.tolist() or [(0.0, 0.0, 0.0, torque) for torque in samples.torque_n_m.tolist()]
    broken = [not all(map(isfinite, row)) for row in rows]
    whole = [row for row, bad in zip(rows, broken, strict=True) if not bad]
    torque_n_m = max((max(map(abs, row[3:])) for row in whole), default=0.0)
    force_n = max((max(map(abs, row[:3])) for row in whole), default=0.0)
    return torque_n_m, force_n, broken
