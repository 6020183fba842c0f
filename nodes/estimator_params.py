"""Parameters and state of the estimator."""

import msgspec

from palp_core import ReadOnly
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.session.methods.reporter import MethodReporterState
from palp_core.palpation.session.reading import ReadingMemory
from palp_core.palpation.session.reading_params import ReadingParams
from palp_core.units import HertzPositive, MetresPerSecondPositive, Seconds


class EstimatorParams(ReadingParams):
    """Set in the launch file; the names are those of the methods register.

    ``auto`` for ``denoise``, ``feature``, ``filter``, ``trace_filter``, ``likelihood`` or ``stop`` leaves it
    to the register, which goes by scene, noise, ``training``, ``max_probes`` and ``rate_hz``.
    ``stop_value`` is the stop rule's own number, 0 for its default. ``depths`` is the number of depths of a
    grid from the shallowest to the deepest trained; 0 decides among the trained ones. A ``filter`` that knows
    what stays reads it from ``noise``, a file of the plan ``repeatability``; empty: landings of
    ``ring_sd_mm``, heights of ``height_sd_mm``. ``scene`` is the scene file from whose mechanics
    it knows how a reading answers to the height.

    With the ``reading`` ``trace`` the belief follows the torque along the path in bins of ``bin_mm``, and is
    published after each as ``outlook``. Its ``trace_filter`` accounts for what differs between sweeps:
    landings as above, and by ``scene``'s mechanics what spreads as stated here (assumed), never as the
    simulated phantom does. ``run_in``: whether a sweep begins with a tip that sticks.
    """

    rate_hz: HertzPositive = 1000.0
    largest_gap_s: Seconds = 0.003
    sweep_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.020


class EstimatorState(MethodReporterState):
    """What a replacement inherits: training, the trial, the sweep under way and a stream of torque."""

    trial: int = 0
    number: int = 0
    phase: str = ""
    label_known: bool = False
    depth_m: float = 0.0
    ring_m: float = 0.0
    ring_iteration: int = 0
    landed: bool = False
    stream: SweepCut | None = None
    memory: ReadingMemory = msgspec.field(default_factory=ReadingMemory)
