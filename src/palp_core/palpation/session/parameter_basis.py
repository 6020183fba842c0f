"""On what each number of the protocol rests: published, a data sheet, or assumed.

Keys are ``role.parameter``, the role as of :mod:`palp_core.palpation.session.roles`. What is not listed is a
choice of the run, such as its seed, or of the software, such as the length of a block.
"""

from __future__ import annotations

BASIS = {
    "experiment.wait_s": "choice: the wait of the plan 'repeatability'",
    "experiment.plan": "choice: the paper's experiment, or how well the rig repeats itself",
    "experiment.swaps": "choice: policies that take over in a trial",
    "experiment.phantoms": "published when empty: 30 mm of gel, 15 mm bead at 2, 4, 8 mm; modulus assumed",
    "experiment.trials": "published for the human strategy: 100; not stated for a fixed position",
    "experiment.training": "published: 25",
    "experiment.training_order": "not published; assumed",
    "experiment.rehome": "not published; assumed",
    "experiment.training_mounts": "not published; assumed",
    "experiment.estimation_mounts": "not published; assumed",
    "experiment.depths": "published: one per phantom's depth (0); as of the estimator",
    "experiment.from_m": "assumed",
    "experiment.to_m": "assumed",
    "policy.ring_mm": "published: one of 0, 4, 8, 12, 16 mm; 16 was the best",
    "policy.rings_mm": "published: 0, 4, 8, 12, 16 mm",
    "policy.matrices": (
        "reconstruction: eigenvalues published, entries not legible; the share of each position (mean level "
        "0.3, sd 0.08) is assumed, and results depend on it"
    ),
    "policy.reading": "the published equations allow three readings; this one is assumed",
    "policy.mixture": "published as the average strategy; how it mixes the depths is assumed",
    "policy.ring_sd_mm": "data sheet's +-0.3 mm as a uniform error: 0.3 / sqrt(3) mm",
    "policy.knows": "choice: what the policy knows to stay in a trial",
    "policy.height_sd_mm": "assumed, as of the simulated phantom",
    "policy.noise": "choice: noise file of this rig; empty: the two spreads",
    "policy.scene": "choice: scene file; empty: gel and probe of the paper and its assumptions",
    "policy.feature": "published: the peak; what the estimator reads off a sweep",
    "policy.depths": "published: the trained depths (0); as of the estimator",
    "policy.per_second": "choice: weigh bits by the seconds they cost",
    "policy.start_mm": "assumed: the stiffest",
    "policy.start_level": "assumed: the middle",
    "policy.chain": "choice: chains learnt from EMG; empty: the reconstruction of Figure 5",
    "policy.depths_mm": "published: 2, 4, 8 mm",
    "policy.mean_level": "initial level: assumed, the middle of the scale",
    "actuator.repeatability_mm": "published, and data sheet L12-50-210-06-I: ±0.3 mm",
    "actuator.ring_error": "how the data sheet's ±0.3 mm is read: assumed",
    "actuator.backlash_mm": "not known; 0 assumed",
    "actuator.noise": "choice: noise file of this rig; empty: the parameters above",
    "stage.rate_hz": "published: 1000 Hz",
    "stage.sweep_speed_m_s": "published: 20 mm/s",
    "phantom.phantoms": "published when empty: 30 mm of gel, 15 mm bead at 2, 4, 8 mm; modulus assumed",
    "phantom.scene": "choice: scene file; empty: gel and probe of the paper and its assumptions",
    "phantom.output": "choice: what the contact model must get right",
    "phantom.tolerance": "choice: how wrong the contact model may be",
    "phantom.from_m": "assumed",
    "phantom.to_m": "assumed",
    "phantom.indentation_mm": "assumed",
    "phantom.height_sd_mm": "assumed: set down by hand against a stop",
    "phantom.noise": "choice: noise file of this rig; empty: the spread above",
    "phantom.friction": "assumed",
    "phantom.tip_mass_kg": "assumed",
    "torque.noise_sd_n_mm": "assumed: one step of the resolution",
    "torque.noise": "choice: noise file of this rig; empty: the noise above",
    "torque.resolution_n_mm": "maker's figure for the Nano17 SI-12-0.12: 1/64 N mm; published: 0.015",
    "torque.bias_drift_n_mm_per_sqrt_s": "not known; 0 assumed",
    "torque.gain_drift_per_sqrt_s": "not known; 0 assumed",
    "estimator.wavelet": "published: db10",
    "estimator.level": "published: 5",
    "estimator.denoise": "rule for the coefficients not published; assumed",
    "estimator.feature": "published: the peak around the nodule; searched for over the whole sweep: assumed",
    "estimator.likelihood": "published: normal",
    "estimator.filter": "published: every reading independent (naive)",
    "estimator.depths": "published: the trained depths (0)",
    "estimator.noise": "choice: noise file of this rig; empty: the two spreads below",
    "estimator.ring_sd_mm": "data sheet's +-0.3 mm as a uniform error: 0.3 / sqrt(3) mm",
    "estimator.height_sd_mm": "assumed, as of the simulated phantom",
    "estimator.scene": "choice: scene file; empty: gel and probe of the paper and its assumptions",
    "estimator.stop_value": "choice: the stop rule's own number; 0: its default",
    "estimator.stop": "published: correlation distance below 0.0005; guards and other rules assumed",
    "estimator.rate_hz": "published: 1000 Hz",
    "estimator.largest_gap_s": "choice: a longer gap in a sweep is said; three samples",
    "estimator.max_probes": "not published; assumed",
    "estimator.resolution_n_mm": "maker's figure: 1/64 N mm; the floor of a primitive's deviation",
    "emg.rate_hz": "published: 1500 Hz",
    "emg.rest_s": "not published; assumed",
    "emg.mvc_s": "not published; assumed",
    "emg.palpation_s": "published: at most 60 s",
    "cocontraction.window_s": "not published; assumed",
    "cocontraction.prominence": "not published; assumed",
    "cocontraction.distance_s": "not published; assumed",
}


SCENE = {
    "connecting_m": "published: 143 mm",
    "base_m": "published: 80 mm",
    "tip_m": "published: 70 mm",
    "spring_n_per_m": "published: 0.24 N/mm",
    "pivot_radius_m": "published: 6.8 mm",
    "tip_radius_m": "assumed",
    "tip_mass_kg": "assumed",
    "tip_com_m": "assumed: half of the tip link",
    "friction": "assumed",
    "modulus_pa": "assumed: soft silicones lie between 5 and 30 kPa",
    "poisson": "assumed: near incompressible, as published",
    "height_m": "published: 30 mm",
    "depth_m": "published: 2, 4, 8 mm",
    "radius_m": "published: 15 mm in diameter",
}
"""What each number of the simulated probe and of the paper's phantoms rests on."""


def basis_of(role: str, parameter: str) -> str:
    """Return what a parameter of a node in a role rests on; empty where nothing is to be said."""
    return BASIS.get(f"{role}.{parameter}", "")
