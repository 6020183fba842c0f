"""The register's own rows: the ten tasks of palpation, their methods, and the quantities of ranges.

Functions and classes are named and not imported: to list methods loads none of them.
"""

from palp_core.palpation.method_table import mechanics, perception

TASKS = [*mechanics.TASKS, *perception.TASKS]
METHODS = [*mechanics.METHODS, *perception.METHODS]

QUANTITIES: dict[str, tuple[str, str]] = {
    # of what is touched, and with what
    "modulus_pa": ("Pa", "Young's modulus of the gel"),
    "poisson": ("1", "Poisson's ratio of the gel"),
    "height_m": ("m", "thickness of the gel"),
    "beads": ("1", "how many beads the gel holds"),
    "bead_radius_m": ("m", "radius of the bead"),
    "depth_m": ("m", "gel over the bead"),
    "beside_m": ("m", "distance of the bead from the path, seen from above"),
    "depth_per_tip": ("1", "gel over the bead, in radii of the ball"),
    "depth_ratio": ("1", "least ratio of neighbouring depths that are compared"),
    "tip_radius_m": ("m", "radius of the ball"),
    "tip_mass_kg": ("kg", "mass of the tip link"),
    "friction": ("1", "Coulomb's coefficient between ball and gel"),
    "indentation_m": ("m", "nominal indentation"),
    "ring_m": ("m", "position of the anchor ring over the pivot"),
    "yielding": ("1", "moment of the gel's force over what the joint can hold"),
    "pressed_share": ("1", "how deep the tip comes, over the ball's radius or the gel over the bead"),
    "margin_m": ("m", "how far the path goes past the bead, on its shorter side"),
    "speed_m_s": ("m/s", "speed of the stage in a sweep"),
    # of a session and what is decided in it
    "class_count": ("1", "depths told apart"),
    "class_ratio": ("1", "each depth over the next smaller one"),
    "class_gap_sd": ("1", "least distance of depths over a reading's spread, at the stiffest ring"),
    "training_count": ("1", "palpations in training, per depth and ring"),
    "probe_count": ("1", "palpations in a trial at most"),
    "ring_sd_m": ("m", "spread of the ring's landing"),
    "height_sd_m": ("m", "spread of a mounting's height"),
    "stiffest_m": ("m", "largest position of the ring"),
    "noise_n_m": ("N m", "noise of a sample of torque"),
    "sample_hz": ("Hz", "samples a second"),
    "outlier_share": ("1", "share of readings that are outliers"),
    # of what a filter of whole traces takes as different between sweeps
    "trace_height_sd_m": ("m", "spread of the surface's height"),
    "friction_sd": ("1", "spread of the friction, as a share of it"),
    "modulus_sd": ("1", "spread of the gel's modulus, as a share of it"),
    "place_sd_m": ("m", "spread of the bead's place along and across the path"),
    "tip_sd_m": ("m", "spread of the ball's radius"),
    "slope_error": ("1", "what the mechanics' slopes are wrong by, as a share of them"),
    "texture_sd_n_m": ("N m", "torque that the surface adds, where training does not show it"),
    "bin_m": ("m", "stretch of the path over which the torque is averaged"),
}
"""SI unit, ``1`` where it has none, and meaning of what a scene or session can name, by name.

A range is checked only where the scene has its quantity: bare gel has no bead's depth, and a bound on
contrast need not hold there.
"""
