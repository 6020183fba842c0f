"""Methods of perception, and the sessions in which their errors were measured.

The nightly rows of ``test_method_bounds.py`` measure them again; a bound is the largest error that was seen
in the range and about a third more.
"""

from collections.abc import Mapping

from palp_core.methods import Bound, Method, Range, Task

_Ranges = Mapping[str, Range]
_ENDLESS = 1e9
_STEP_N_M = 1.5625e-5 * 1.001
"""A step of the sensor's resolution, 1/64 N mm, with what rounding takes."""

_TOUCH: _Ranges = {
    "bead_radius_m": (0.0074, 0.0076),
    "height_m": (0.0295, 0.0305),
    "poisson": (0.485, 0.495),
    "tip_radius_m": (0.0059, 0.0061),
    "tip_mass_kg": (0.007, 0.009),
    "speed_m_s": (0.0195, 0.0205),
    "sample_hz": (990.0, 1010.0),
    "depth_m": (0.0015, 0.012),
    "class_ratio": (2.0, _ENDLESS),
}
_USUAL: _Ranges = {
    **_TOUCH,
    "modulus_pa": (19.5e3, 20.5e3),
    "friction": (0.29, 0.31),
    "indentation_m": (0.0039, 0.0041),
    "class_count": (2.0, 3.0),
}
"""The published touch."""
_ABOUT: _Ranges = {
    **_TOUCH,
    "modulus_pa": (15e3, 30e3),
    "friction": (0.25, 0.45),
    "indentation_m": (0.003, 0.005),
    "class_count": (2.0, 4.0),
}
"""Touches about it, measured at the corners."""
_FELT: _Ranges = {"ring_m": (0.004, 0.016)}
"""Rings at which there is something to feel."""
_RIG: _Ranges = {
    **_USUAL,
    "noise_n_m": (0.0, _STEP_N_M),
    "stiffest_m": (0.0159, 0.0161),
    "training_count": (25.0, _ENDLESS),
    "probe_count": (15.0, 15.0),
    "outlier_share": (0.0, 0.0),
}
"""The published rig, but for how it lands and is mounted."""
_LANDS_M = 0.175e-3
"""Largest spread of a landing: the published +-0.3 mm, read as uniform."""


def _by_noise(usual: tuple[float, float, float], about: tuple[float, float, float]) -> list[Bound]:
    """Return bounds on a feature's error for noise up to 1, 2 and 5 steps of the sensor's resolution."""
    steps = (1.0, 2.0, 5.0)
    return [
        Bound("feature", error, {**touch, **_FELT, "noise_n_m": (0.0, step * _STEP_N_M)})
        for touch, errors in ((_USUAL, usual), (_ABOUT, about))
        for step, error in zip(steps, errors, strict=True)
    ]


def _on_rig(
    output: str,
    error: float,
    *,
    ring_sd_m: float = _LANDS_M,
    ring_from_m: float = 0.0,
    height_sd_m: float = 1e-4,
    training_count: float = 25.0,
) -> Bound:
    """Return a bound on the published rig, for landings and heights that spread up to so much."""
    spread = {"ring_sd_m": (ring_from_m, ring_sd_m), "height_sd_m": (0.0, height_sd_m)}
    return Bound(output, error, {**_RIG, **spread, "training_count": (training_count, _ENDLESS)})


def _stays(error: float, ring_sd_m: float, height_sd_m: float) -> Bound:
    """Return a bound on the calibration error of trials whose ring and height spread up to so much."""
    return _on_rig("calibration", error, ring_sd_m=ring_sd_m, height_sd_m=height_sd_m, training_count=10.0)


def _decided(error: float, touch: _Ranges, height_sd_m: float) -> Bound:
    """Return a bound on the share of wrong decisions from one reading at the stiffest ring."""
    session = {
        "ring_sd_m": (0.0, _LANDS_M),
        "noise_n_m": (0.0, 5.0 * _STEP_N_M),
        "training_count": (25.0, _ENDLESS),
        "stiffest_m": (0.0159, 0.0161),
        "height_sd_m": (0.0, height_sd_m),
    }
    return Bound("decision", error, {**touch, **session})


def _trained(outlier_share: float, *errors: float) -> list[Bound]:
    """Return bounds on the calibration error for 25, 10, 5 and 3 training readings a class and more.

    They are of trials that end at a probability of 0.95 or after 15 readings, classes being two standard
    deviations of a reading apart or more.
    """
    return [
        Bound(
            "calibration",
            error,
            {
                "training_count": (count, _ENDLESS),
                "class_gap_sd": (2.0, _ENDLESS),
                "class_count": (2.0, 3.0),
                "probe_count": (1.0, 15.0),
                "outlier_share": (0.0, outlier_share),
            },
        )
        for count, error in zip((25.0, 10.0, 5.0, 3.0), errors, strict=True)
    ]


def _traces(touch: _Ranges, most: float, **other: Range) -> dict[str, Range]:
    """Return where errors of one whole sweep were measured: offsets up to so many times the usual ones."""
    usual_sd = {
        "trace_height_sd_m": 2e-4,
        "friction_sd": 0.1,
        "modulus_sd": 0.1,
        "place_sd_m": 1e-3,
        "tip_sd_m": 1e-4,
    }
    return {
        **touch,
        **{name: (0.0, most * sd * 1.001) for name, sd in usual_sd.items()},
        "slope_error": (0.19, 0.21),
        "texture_sd_n_m": (1.9e-4, 2.1e-4),
        "bin_m": (0.0019, 0.0021),
        "stiffest_m": (0.0159, 0.0161),
        "ring_sd_m": (0.0, _LANDS_M),
        "noise_n_m": (0.0, _STEP_N_M),
        "training_count": (25.0, _ENDLESS),
        **other,
    }


_TRACES_ABOUT = _traces(
    {**_ABOUT, "indentation_m": (0.003, 0.0045), "class_ratio": (1.5, _ENDLESS), "class_count": (2.0, 31.0)},
    1.0,
    slope_error=(0.0, 0.3),
    texture_sd_n_m=(0.5e-4, 4e-4),
    noise_n_m=(0.0, 5.0 * _STEP_N_M),
    training_count=(2.0, _ENDLESS),
)
_TRACES_TRAINED = {**_TRACES_ABOUT, "training_count": (6.0, _ENDLESS)}  # of fewer, beliefs are too sure
_TRACES_USUAL, _TRACES_MUCH = _traces(_USUAL, 1.0), _traces(_USUAL, 2.0)
# trials of other phantoms than the one of training differ from it by sqrt(2) times what phantoms scatter
_TRACES_ONE_PHANTOM = _traces(_USUAL, 1.5, training_count=(2.0, _ENDLESS))

_THREE_CLASSES: _Ranges = {"class_count": (3.0, _ENDLESS)}
_DENOISED = _by_noise((0.027, 0.057, 0.167), (0.047, 0.101, 0.29))

_HERE = "palp_core.palpation.perception"
_MEASURES = "palp_core.palpation.studies.measures.perception"
_BOUNDS = "tests/palpation/studies/perception/test_method_bounds.py"

TASKS = [
    Task(
        name="denoise",
        question="What becomes of wavelet coefficients?",
        per="a sweep of 4000 samples",
        output="feature",
        tolerance=0.05,
    ),
    Task(
        name="feature",
        question="Which number is read off a sweep?",
        per="a sweep of 4000 samples",
        output="decision",
        tolerance=0.05,
    ),
    Task(
        name="likelihood",
        question="How likely is a reading, given the training?",
        per="a reading",
        output="calibration",
        tolerance=0.05,
    ),
    Task(
        name="filter",
        question="What do readings of one trial that share an error say together?",
        per="a reading",
        output="calibration",
        tolerance=0.05,
        measure=f"{_MEASURES}:measure_filters",
    ),
    Task(
        name="trace_filter",
        question="What do torques along a sweep say of the class, with what stays accounted for?",
        per="a sweep",
        output="decision",
        tolerance=0.02,  # what a rule that stops at 0.99 gets wrong by itself, and as much again
    ),
    Task(
        name="stop",
        question="When is enough known to end a trial?",
        per="a reading",
        output="decision",
        tolerance=0.05,
        measure=f"{_MEASURES}:measure_stops",
    ),
    Task(
        name="policy",
        question="How stiff is the joint for the next palpation?",
        per="a palpation",
        output="decision",
        tolerance=0.05,
        measure=f"{_MEASURES}:measure_policies",
    ),
    Task(
        name="burst",
        question="Where does co-contraction show a contraction, and how strong is it?",
        per="a second of co-contraction",
        output="contraction",
        tolerance=0.05,
    ),
]

METHODS = [
    Method(
        task="denoise",
        name="soft_universal",
        place=f"{_HERE}.signal.wavelet:soft_universal",
        cost_s=1.4e-4,
        bounds=_DENOISED,
        evidence=_BOUNDS,
        fails="noise that is not white: the finest level's median no longer measures the coarser "
        "levels' noise",
    ),
    Method(
        task="denoise",
        name="approximation",
        place=f"{_HERE}.signal.wavelet:approximation",
        cost_s=1.05e-4,
        bounds=_DENOISED,
        evidence=_BOUNDS,
        fails="steps and edges overshoot; everything above rate / 2^(level + 1) is deleted, wanted or not",
        survivor="soft_universal",
    ),
    Method(
        task="feature",
        name="peak",
        place=f"{_HERE}.signal.features:peak",
        cost_s=3e-6,
        bounds=[
            _decided(0.005, _ABOUT, 1e-6),
            _decided(0.077, _USUAL, 1e-4),
            _decided(0.35, _USUAL, 2e-4),
            _decided(0.29, _ABOUT, 1e-4),
            _decided(0.62, _ABOUT, 2e-4),
        ],
        evidence=_BOUNDS,
        fails="a height error moves it by about one depth class; without a signal it is the noise's maximum",
        survivor="contrast",
    ),
    Method(
        task="feature",
        name="contrast",
        place=f"{_HERE}.signal.features:contrast",
        cost_s=2.3e-5,
        # the path goes past the bead by edge cone, reach and flank at 20 mm/s and 1 kHz at the least
        bounds=[_decided(0.005, {**_ABOUT, "margin_m": (0.026, _ENDLESS)}, 2e-4)],
        evidence=_BOUNDS,
        fails="flanks closer than the nodule is wide still carry it; far ones carry the phantom's rim",
    ),
    Method(
        task="likelihood",
        name="normal",
        place=f"{_HERE}.belief.likelihoods:normal",
        cost_s=5e-6,
        bounds=[*_trained(0.0, 0.018, 0.043, 0.118, 0.235), *_trained(0.01, 0.037, 0.066, 0.14, 0.256)],
        evidence=_BOUNDS,
        fails="cells of few readings, and outliers: it is sure of whatever class is nearest",
        survivor="student_t",
    ),
    Method(
        task="likelihood",
        name="student_t",
        place=f"{_HERE}.belief.likelihoods:student_t",
        cost_s=1.3e-5,
        bounds=[*_trained(0.0, 0.008, 0.018, 0.055, 0.128), *_trained(0.01, 0.02, 0.025, 0.061, 0.132)],
        evidence=_BOUNDS,
        fails="readings of one trial that share an error: it widens for the training's size only",
    ),
    Method(
        task="filter",
        name="latent",
        place=f"{_HERE}.belief.latent:latent",
        cost_s=5.8e-5,
        bounds=[_stays(0.035, _LANDS_M, 0.1e-3)],
        evidence=_BOUNDS,
        fails="errors that are not small against the readings' curvature: slopes are straight lines",
    ),
    Method(
        task="filter",
        name="naive",
        place=f"{_HERE}.belief.latent:naive",
        cost_s=4.5e-5,
        bounds=[
            _stays(0.018, 0.058e-3, 1e-6),
            _stays(0.064, _LANDS_M, 1e-6),
            _stays(0.082, _LANDS_M, 0.03e-3),
            _stays(0.22, _LANDS_M, 0.1e-3),
        ],
        evidence=_BOUNDS,
        fails="readings of a trial that share an error: it takes each for a new fact and becomes "
        "over-confident",
        survivor="latent",
    ),
    Method(
        task="trace_filter",
        name="second_order",
        place=f"{_HERE}.trace.filters:second_order",
        cost_s=2.6e-4,
        bounds=[
            Bound("decision", 0.0062, _TRACES_USUAL),
            Bound("calibration", 0.053, _TRACES_USUAL),
            Bound("decision", 0.0186, _TRACES_ABOUT),
            Bound("decision", 0.037, _TRACES_ONE_PHANTOM),
            Bound("calibration", 0.1, _TRACES_TRAINED),
            Bound("decision", 0.037, _TRACES_MUCH),
            Bound("calibration", 0.15, _TRACES_MUCH),
        ],
        evidence=_BOUNDS,
        fails="answers that a parabola over two spreads of an offset does not follow, or two "
        "offsets at once; trained on one phantom and asked about others, unless it is given half as much "
        "spread again",
    ),
    Method(
        task="stop",
        name="paper",
        place=f"{_HERE}.belief.stopping:PaperVerbatim",
        cost_s=2.4e-5,
        bounds=[_on_rig("decision", 0.135), _on_rig("calibration", 0.05)],
        evidence=_BOUNDS,
        valid=_THREE_CLASSES,
        fails="a belief that grows along one direction has distance 0 and stops early; two classes",
        survivor="posterior_threshold",
    ),
    Method(
        task="stop",
        name="paper_guarded",
        place=f"{_HERE}.belief.stopping:PaperGuarded",
        cost_s=2.6e-5,
        bounds=[_on_rig("decision", 0.133), _on_rig("calibration", 0.05)],
        evidence=_BOUNDS,
        valid=_THREE_CLASSES,
        fails="probes that share an error agree with each other and stop it, however wrong; two classes",
        survivor="posterior_threshold",
    ),
    Method(
        task="stop",
        name="posterior_threshold",
        place=f"{_HERE}.belief.stopping:PosteriorThreshold",
        cost_s=3.5e-6,
        bounds=[
            _on_rig("decision", 0.041, ring_from_m=0.16e-3),
            _on_rig("decision", 0.052),
            _on_rig("calibration", 0.05),
        ],
        evidence=_BOUNDS,
        fails="over-confident likelihoods pass any level at once",
    ),
    Method(
        task="stop",
        name="fixed_number",
        place=f"{_HERE}.belief.stopping:FixedNumber",
        cost_s=3e-6,
        bounds=[_on_rig("decision", 0.055), _on_rig("calibration", 0.021)],
        evidence=_BOUNDS,
        fails="easy trials take as many probes as hard ones",
        survivor="posterior_threshold",
    ),
    Method(
        task="policy",
        name="fixed",
        place=f"{_HERE}.strategy.policies:FixedRing",
        cost_s=5e-8,
        bounds=[_on_rig("decision", 0.044)],
        evidence=_BOUNDS,
        fails="an error of the ring's position is shared by all probes of a trial and does not average out",
        survivor="information_gain_latent",
    ),
    Method(
        task="policy",
        name="uniform",
        place=f"{_HERE}.strategy.policies:UniformRings",
        cost_s=5.7e-6,
        bounds=[_on_rig("decision", 0.061)],
        evidence=_BOUNDS,
        fails="it spends as many probes on uninformative positions as on good ones",
        survivor="information_gain_latent",
    ),
    Method(
        task="policy",
        name="markov",
        place=f"{_HERE}.strategy.policies:MarkovPolicy",
        cost_s=2e-5,
        bounds=[_on_rig("decision", 0.148)],
        evidence=_BOUNDS,
        fails="the reading 'mean' freezes at the middle level; the matrices are a reconstruction "
        "unless learned",
        survivor="information_gain_latent",
    ),
    Method(
        task="policy",
        name="reposition",
        place=f"{_HERE}.strategy.policies_informed:Reposition",
        cost_s=4.6e-6,
        bounds=[_on_rig("decision", 0.04)],
        evidence=_BOUNDS,
        fails="an error of the phantom's height, which re-positioning the ring does not touch; it "
        "costs seconds",
        survivor="information_gain_latent",
    ),
    Method(
        task="policy",
        name="emg_driven",
        place=f"{_HERE}.strategy.policies_informed:EmgDriven",
        cost_s=5.6e-6,
        evidence="tests/palpation/perception/strategy/test_policies_informed.py",
        fails="a person who rests: without a burst it stays where it began",
        survivor="markov",
    ),
    Method(
        task="policy",
        name="information_gain_latent",
        place=f"{_HERE}.strategy.policies_informed:InformationGainLatent",
        cost_s=2.8e-4,
        bounds=[_on_rig("decision", 0.005)],
        evidence=_BOUNDS,
        fails="offsets that are not as its model says; it looks one probe ahead only",
    ),
    Method(
        task="policy",
        name="information_gain",
        place=f"{_HERE}.strategy.policies_informed:information_gain",
        cost_s=1.3e-4,
        bounds=[_on_rig("decision", 0.053)],
        evidence=_BOUNDS,
        fails="readings of a trial that share an error: it returns to the position it is already "
        "over-sure of",
        survivor="information_gain_latent",
    ),
    Method(
        task="burst",
        name="two_thresholds",
        place=f"{_HERE}.emg.bursts:BurstRule",
        cost_s=1e-4,
        bounds=[Bound("contraction", 0.01)],
        evidence="tests/benchmarks/test_emg_known.py; benchmarks/emg_bursts.py: simulated EMG whose "
        "contractions are known",
        fails="crosstalk of a third muscle from 10 % on joins bursts: a fifth of contractions is missed",
    ),
]
