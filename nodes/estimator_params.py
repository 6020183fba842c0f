"""Parameters and state of the estimator."""

import msgspec

from palp_core import Params, ReadOnly
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.session_check import SessionTrials
from palp_core.palpation.perception.belief.trial_filter import DepthCount
from palp_core.palpation.perception.signal.sweep_cut import SweepCut
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED
from palp_core.palpation.session.method_choices import (
    AUTO,
    DenoiseName,
    FeatureName,
    FilterName,
    LikelihoodName,
    Reading,
    StopName,
    TraceFilterName,
)
from palp_core.palpation.session.methods.teller import MethodTellerState
from palp_core.palpation.session.trace.reader import TraceMemory
from palp_core.units import (
    CountPositive,
    HertzPositive,
    Metres,
    MetresPerSecondPositive,
    MillimetresNonNegative,
    MillimetresPositive,
    NewtonMillimetresNonNegative,
    NewtonMillimetresPositive,
    RatioNonNegative,
    Seconds,
)


class EstimatorParams(Params):
    """Set in the launch file; the names are those of the methods register.

    ``auto`` for ``denoise``, ``feature``, ``filter``, ``trace_filter``, ``likelihood`` or ``stop`` leaves it
    to the register, which goes by scene, noise, ``training``, ``max_probes`` and ``rate_hz``.
    ``stop_value`` is the stop rule's own number, 0 for its default. ``depths`` is the number of depths of a
    grid from the shallowest to the deepest trained; 0 decides among the trained ones. A ``filter`` that knows
    what stays reads it from ``noise``, a file of the plan ``repeatability``; empty: landings of
    ``ring_sd_mm``, heights of ``height_sd_mm``. ``scene`` is the scene file from whose mechanics
    it knows how a reading answers to the height.

    With the ``reading`` ``trace`` the belief follows the torque along the path in bins of ``bin_mm``, and is
    told after each as ``outlook``. Its ``trace_filter`` accounts for what differs between sweeps: landings as
    above, and by ``scene``'s mechanics what spreads as stated here (assumed), never as the simulated phantom
    does. ``run_in``: whether a sweep begins with a tip that sticks. ``sweep_speed_m_s``: of training, where
    a policy chooses others. From ``from_m`` on, of this reading only.
    """

    reading: ReadOnly[Reading] = "feature"
    wavelet: str = "db10"
    level: CountPositive = 5
    denoise: DenoiseName = "soft_universal"
    feature: FeatureName = "peak"
    likelihood: LikelihoodName = "normal"
    filter: FilterName = "naive"
    trained_mm: str = PUBLISHED
    depths: DepthCount = 0
    noise: str = ""
    ring_sd_mm: MillimetresNonNegative = 0.17
    height_sd_mm: MillimetresNonNegative = 0.1
    scene: str = ""
    stop: StopName = "paper_guarded"
    stop_value: RatioNonNegative = 0.0
    max_probes: CountPositive = 15
    training: CountPositive = 25
    resolution_n_mm: NewtonMillimetresPositive = RESOLUTION_N_M * 1e3
    rate_hz: HertzPositive = 1000.0
    largest_gap_s: Seconds = 0.003
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    bin_mm: ReadOnly[MillimetresPositive] = 2.0
    trace_filter: TraceFilterName = AUTO
    trace_height_sd_mm: MillimetresNonNegative = 0.2
    friction_sd: RatioNonNegative = 0.1
    modulus_sd: RatioNonNegative = 0.1
    place_sd_mm: MillimetresNonNegative = 1.0
    tip_sd_mm: MillimetresNonNegative = 0.1
    bias_sd_n_mm: NewtonMillimetresNonNegative = 0.02
    slope_error: RatioNonNegative = 0.2
    texture_sd_n_mm: NewtonMillimetresNonNegative = 0.2
    texture_length_mm: MillimetresPositive = 3.0
    run_in: bool = False
    sweep_speed_m_s: ReadOnly[MetresPerSecondPositive] = 0.020


class EstimatorState(MethodTellerState):
    """What a replacement inherits: the sweep under way, what was learnt, and the belief of this trial."""

    trial: int = 0
    number: int = 0
    phase: str = ""
    label_known: bool = False
    depth_m: float = 0.0
    ring_m: float = 0.0
    ring_trial: int = 0
    ring_iteration: int = 0
    start_ns: int = 0
    rate_hz: float = 0.0
    blocks: list[bytes] = []
    received_count: int = 0
    expected_count: int = -1
    stream: SweepCut | None = None
    training: list[tuple[float, float, float]] = []
    primitives: dict[str, list[float]] = {}
    landed: bool = False
    probes: list[tuple[float, int, bool]] = []
    posteriors: list[list[float]] = []
    gains: list[list[float]] = []
    trace: TraceMemory = msgspec.field(default_factory=TraceMemory)
    session: SessionTrials = msgspec.field(default_factory=SessionTrials)
