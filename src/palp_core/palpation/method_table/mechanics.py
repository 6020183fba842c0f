"""Methods of the mechanics, and how wrong they are: the largest error seen, plus about a third, box by box.

L2 is held against L4. Boxes of geometry nest: the published phantom itself, about it, near it, in its
neighbourhood; and so do loads: the usual one, a wide one, any. L2's bead term was derived for a bead of the
ball's own size, so a smaller bead or a thicker slab costs the most. What becomes of an error of the force
depends on how far the joint gives way (``yielding``, the moment of Hertz's force over what the joint can
hold): from 1 on the peak hardly feels it, at 0.1 it is as wrong as the force. The contrast needs a path that
goes far enough past the bead (``margin_m``). The trace is off where the tip comes down the far flank of a
shallow bead. Where the bead is 2 mm beside the path (``beside_m``) the peak is off by up to twice as much as
over it, and the bounds still hold; from 4 mm on they break. The numbers are from the corners of the boxes at
depths of 1.5 to 8.5 mm, where the worst had 128 or 200 loads at four rings, up to mu = 0.6 and 60 kPa, and
from the published phantom with 200 loads at seven depths.

L4 at its usual cells of 1 mm is held against cells of 0.5 mm on the same elements. What is wrong is where the
contact ends between two cells: some 0.3 % of the force. The peak hardly feels it, as the joint yields. The
contrast is the small difference of two such forces, the smaller the deeper the bead; so is the gap between
the peaks of two depths, the smaller the closer they are. The numbers are from 250 random scenes and from the
published phantom at twelve depths with seventy loads and rings each.

Against finite strain (``finite_peak`` and its like) bounds are for the published phantom and phantoms within
2 % of its lengths, where the tip goes no deeper than 0.74 of the ball's radius and of the gel over the bead
(``pressed_share``; beyond it L5's elements may fold). L5 is held against finite elements in three dimensions,
over and beside beads under 4 and 8 mm of gel; L2 and L4 against L5, on 34 phantoms with 48 loads each, and
what L5 may be off is added. That L2's contrast is nearer than L4's is luck: it is too stiff over the bead, as
the gel is at finite strain.
"""

from collections.abc import Mapping

from palp_core.methods import Bound, Method, Range, Task

_Box = Mapping[str, Range]

FEM_SCENES: _Box = {
    "depth_m": (0.0005, 0.015),
    "poisson": (0.3, 0.4999),
    "height_m": (0.015, 0.060),
    "bead_radius_m": (0.002, 0.012),
    "tip_radius_m": (0.002, 0.012),
}
"""The scenes that the finite-element models are stated for."""

PRESSED_MAX = 0.74
"""Of the ball's radius and of the gel over the bead: how deep L5 was seen to reach everywhere."""

_ENDLESS = 1e9


def _geometry(bead_radius_m: Range, tip_radius_m: Range, height_m: Range, poisson: Range) -> _Box:
    return {
        "bead_radius_m": bead_radius_m,
        "tip_radius_m": tip_radius_m,
        "height_m": height_m,
        "poisson": poisson,
    }


def _load(modulus_pa: Range, friction: Range, indentation_m: Range) -> _Box:
    return {
        "modulus_pa": modulus_pa,
        "friction": friction,
        "indentation_m": indentation_m,
        "tip_mass_kg": (0.002, 0.020),
    }


_PUBLISHED = _geometry((0.00745, 0.00755), (0.00595, 0.00605), (0.0298, 0.0302), (0.489, 0.491))
_PAPER = _geometry((0.0074, 0.0076), (0.0058, 0.0062), (0.0295, 0.0305), (0.488, 0.492))
_NEAR = _geometry((0.007, 0.008), (0.0055, 0.0065), (0.028, 0.032), (0.48, 0.495))
_ABOUT = _geometry((0.006, 0.009), (0.0045, 0.0075), (0.025, 0.040), (0.46, 0.4999))
_USUAL = _load((15e3, 40e3), (0.25, 0.45), (0.003, 0.005))
_WIDE = _load((8e3, 40e3), (0.2, 0.45), (0.0025, 0.005))
_FIRM = _load((8e3, 40e3), (0.25, 0.45), (0.002, 0.005))
_ANY = _load((3e3, 60e3), (0.2, 0.6), (0.001, 0.005))
PHANTOMS: Mapping[str, _Box] = {"published": _PUBLISHED, "close": _PAPER, "near": _NEAR, "about": _ABOUT}
LOADS: Mapping[str, _Box] = {"usual": _USUAL, "wide": _WIDE, "any": _ANY, "firm": _FIRM}
"""Boxes by the names that ``docs/results/mechanics.md`` has for them."""
_ALL_RINGS, _RINGS = (0.0, 0.016), (0.004, 0.016)
_DEEPEST_M = 0.012
_BESIDE, _OVER = (0.0, 0.002), (0.0, 0.0)
_MARGIN = {"margin_m": (0.03, _ENDLESS)}


def _box(output: str, error: float, geometry: _Box, load: _Box, depth_m: Range, **more: Range) -> Bound:
    return Bound(output, error, {**geometry, **load, "depth_m": depth_m, "beside_m": _BESIDE, **more})


def _peak(error: float, geometry: _Box, load: _Box, shallowest_m: float, yielding: float) -> Bound:
    depth_m = (shallowest_m, _DEEPEST_M)
    return _box("peak", error, geometry, load, depth_m, ring_m=_ALL_RINGS, yielding=(yielding, _ENDLESS))


def _contrast(error: float, geometry: _Box, load: _Box, depth_m: Range, ring_m: Range) -> Bound:
    load = {**load, **_MARGIN}
    return _box("contrast", error, geometry, load, depth_m, ring_m=ring_m, yielding=(0.5, _ENDLESS))


def _trace(error: float, geometry: _Box, shallowest_m: float) -> Bound:
    depth_m, yields = (shallowest_m, _DEEPEST_M), (0.75, _ENDLESS)
    return _box("trace", error, geometry, _USUAL, depth_m, ring_m=_ALL_RINGS, yielding=yields)


def _depths(output: str, error: float, deepest_m: float, ring_m: Range, ratio: float, yields: float) -> Bound:
    """Return a bound on telling depths apart, the published phantom and what is near it."""
    apart = {"depth_ratio": (ratio, _ENDLESS), "yielding": (yields, _ENDLESS), "beside_m": _OVER}
    return _box(output, error, _PAPER, _WIDE, (0.0015, deepest_m), ring_m=ring_m, **apart)


_FINITE: _Box = {**_PAPER, "pressed_share": (0.0, PRESSED_MAX), "beside_m": _OVER}
_FINITE_LOAD: _Box = {**_FIRM, "ring_m": _RINGS}
_SHALLOW: _Box = {"beads": (1.0, 1.0), "depth_m": (0.0019, 0.0045)}
_BEAD: _Box = {"beads": (1.0, 1.0), "depth_m": (0.0019, 0.0085)}
_BEAD_OR_BARE: _Box = {"depth_m": (0.0019, _DEEPEST_M)}


def _finite_normal(error: float) -> Bound:
    return Bound("finite_normal", error, {**_FINITE, **_BEAD_OR_BARE})


def _finite_peak(error: float, where: _Box, yielding: float) -> Bound:
    return Bound("finite_peak", error, {**_FINITE, **_FINITE_LOAD, **where, "yielding": (yielding, _ENDLESS)})


def _finite_contrast(error: float, where: _Box, stiffest_pa: float = 40e3) -> Bound:
    more = {**_MARGIN, "modulus_pa": (8e3, stiffest_pa)}
    return Bound("finite_contrast", error, {**_FINITE, **_FINITE_LOAD, **where, **more})


_PRESSED: _Box = {"indentation_m": (0.0005, 0.005)}

L2 = [
    _box("normal", 0.15, _PAPER, _PRESSED, (0.003, _DEEPEST_M)),
    _box("normal", 0.21, _NEAR, _PRESSED, (0.003, _DEEPEST_M)),
    _box("normal", 0.42, _NEAR, _PRESSED, (0.002, _DEEPEST_M)),
    _peak(0.019, _PUBLISHED, _USUAL, 0.0019, 0.75),
    _peak(0.0125, _PUBLISHED, _USUAL, 0.0029, 0.75),
    _peak(0.022, _PAPER, _USUAL, 0.0019, 0.75),
    _peak(0.015, _PAPER, _USUAL, 0.0029, 0.75),
    _peak(0.010, _PAPER, _USUAL, 0.0015, 1.0),
    _peak(0.018, _NEAR, _USUAL, 0.0015, 1.0),
    _peak(0.037, _NEAR, _USUAL, 0.0019, 0.75),
    _peak(0.028, _PAPER, _USUAL, 0.0015, 0.3),
    _peak(0.016, _NEAR, _WIDE, 0.0015, 1.5),
    _peak(0.057, _NEAR, _ANY, 0.0015, 0.5),
    _peak(0.180, _NEAR, _ANY, 0.0015, 0.2),
    _peak(0.390, _NEAR, _ANY, 0.0015, 0.1),
    _peak(0.041, _ABOUT, _ANY, 0.0015, 1.5),
    _peak(0.126, _ABOUT, _ANY, 0.0015, 0.5),
    _peak(0.380, _ABOUT, _ANY, 0.0015, 0.2),
    _contrast(0.085, _PUBLISHED, _USUAL, (0.0019, 0.0041), _RINGS),
    _contrast(0.095, _PAPER, _USUAL, (0.0019, 0.0041), _RINGS),
    _contrast(0.120, _PAPER, _USUAL, (0.0019, 0.0045), _RINGS),
    _contrast(0.128, _PAPER, _ANY, (0.0015, 0.0041), _RINGS),
    _contrast(0.155, _PAPER, _ANY, (0.0015, 0.0045), _RINGS),
    _contrast(0.220, _PAPER, _ANY, (0.0019, 0.0045), _ALL_RINGS),
    _contrast(0.325, _PAPER, _ANY, (0.0015, 0.0085), _RINGS),
    _contrast(0.405, _PAPER, _ANY, (0.0015, 0.0085), _ALL_RINGS),
    _contrast(0.180, _NEAR, _USUAL, (0.0019, 0.0045), _RINGS),
    _contrast(0.215, _NEAR, _ANY, (0.0015, 0.0045), _RINGS),
    _contrast(0.285, _NEAR, _ANY, (0.0015, 0.0045), _ALL_RINGS),
    _contrast(0.475, _NEAR, _ANY, (0.0015, 0.0085), _RINGS),
    _contrast(0.555, _NEAR, _ANY, (0.0015, 0.0085), _ALL_RINGS),
    _contrast(0.545, _ABOUT, _ANY, (0.0015, 0.0045), _ALL_RINGS),
    _trace(0.205, _PAPER, 0.0019),
    _trace(0.081, _PAPER, 0.0029),
    _trace(0.0195, _PAPER, 0.0059),
    _depths("separation", 0.250, 0.0085, _RINGS, 1.3, 0.75),
    _depths("separation", 0.530, _DEEPEST_M, _ALL_RINGS, 1.15, 0.5),
    _depths("decision", 0.100, _DEEPEST_M, _ALL_RINGS, 1.15, 0.5),
    _finite_normal(0.17),
    _finite_peak(0.010, _SHALLOW, 0.75),
    _finite_peak(0.021, _BEAD_OR_BARE, 0.75),
    _finite_peak(0.017, _SHALLOW, 0.3),
    _finite_peak(0.046, _BEAD_OR_BARE, 0.3),
    _finite_contrast(0.115, _SHALLOW),
    _finite_contrast(0.280, _BEAD),
]

_GEL = (500.0, 500e3)
_CROSSED = {"margin_m": (0.02, _ENDLESS)}  # nearer the bead a path ends before the peak, or under it
_ASIDE = {"beside_m": (0.0, 0.006)}  # further beside the path the contrast is next to nothing
_TRACED = {"depth_m": (0.0015, 0.015), **_ASIDE}

L4 = [
    Bound("normal", 0.013),
    Bound("peak", 0.005, within={"modulus_pa": (15e3, _ENDLESS)}),
    Bound("peak", 0.008),
    Bound(
        "contrast",
        0.02,
        within={"depth_m": (0.0, 0.0082), **_PAPER, "modulus_pa": (5e3, 40e3), **_CROSSED, **_ASIDE},
    ),
    Bound("contrast", 0.02, within={"depth_m": (0.0, 0.005), "modulus_pa": _GEL, **_CROSSED, **_ASIDE}),
    Bound("contrast", 0.026, within={"depth_m": (0.0, 0.0085), "modulus_pa": _GEL, **_CROSSED, **_ASIDE}),
    Bound("contrast", 0.05, within={"margin_m": (0.016, _ENDLESS), **_ASIDE}),
    Bound("trace", 0.016, within={"modulus_pa": (15e3, _ENDLESS), **_TRACED}),
    Bound("trace", 0.019, within={"modulus_pa": (8e3, _ENDLESS), **_TRACED}),
    Bound("trace", 0.09, within={"modulus_pa": (5e3, _ENDLESS), **_TRACED}),
    Bound("separation", 0.04, within={"depth_ratio": (2.0, 1e3), "modulus_pa": _GEL, "beside_m": _OVER}),
    Bound("separation", 0.06, within={"depth_ratio": (1.3, 1e3), "beside_m": _OVER}),
    Bound("decision", 0.01, within={"depth_ratio": (1.3, 1e3), "beside_m": _OVER}),
    _finite_normal(0.11),
    _finite_peak(0.007, _SHALLOW, 0.75),
    _finite_peak(0.021, _BEAD_OR_BARE, 0.75),
    _finite_peak(0.010, _SHALLOW, 0.3),
    _finite_peak(0.052, _BEAD_OR_BARE, 0.3),
    _finite_contrast(0.175, _SHALLOW),
    _finite_contrast(0.320, _BEAD),
]

L5 = [
    Bound("normal_on_axis", 0.01),
    _finite_normal(0.012),
    _finite_peak(0.004, _BEAD_OR_BARE, 0.1),
    _finite_contrast(0.020, _SHALLOW),
    _finite_contrast(0.057, _BEAD, 25e3),
    _finite_contrast(0.105, _BEAD),
]

_RINGS_FELT: _Box = {"ring_m": (0.004, 0.020)}  # below, there may be no contrast to be relative to
_GELS: _Box = {"modulus_pa": (5e3, 1e9)}  # softer, the gel hardly pulls, and inertia is a larger share
_HERTZ_SCENES: _Box = {
    "depth_m": (0.0015, 0.015),
    "depth_per_tip": (0.25, 1e4),  # a thinner film over the bead is refused
    "poisson": (0.45, 0.5),
    "height_m": (0.015, 1.0),
    "bead_radius_m": (0.003, 0.015),
    "tip_radius_m": (0.003, 0.010),
    "indentation_m": (0.0, 0.005),
}

_MEASURES = "palp_core.palpation.studies.measures.mechanics"
_CONTACT = "palp_core.palpation.mechanics.contact"
_EQUILIBRIUM = "palp_core.palpation.mechanics.equilibrium"
_TESTS = "tests/palpation/mechanics"

TASKS = [
    Task(
        name="contact",
        question="With what force does the gel answer a ball in it?",
        per="set-up and a sweep of 3000 positions, nothing cached",
        output="peak",
        tolerance=0.02,
        measure=f"{_MEASURES}:measure_contact",
    ),
    Task(
        name="motion",
        question="Does the joint's inertia matter?",
        per="a sweep of 4 s",
        output="peak",
        tolerance=0.02,
    ),
]

METHODS = [
    Method(
        task="contact",
        name="l0",
        place=f"{_CONTACT}.l0:FittedBump",
        cost_s=0.0034,
        evidence=f"{_TESTS}/contact/test_l0.py: against what it was fitted to; "
        "measured by palp methods measure --task contact",
        valid=_HERTZ_SCENES,
        fails="anywhere but at the working point it was fitted at",
        reference="it replays forces that it was fitted to, measured ones of a phantom or another rung's",
        survivor="l2",
    ),
    Method(
        task="contact",
        name="l2",
        place=f"{_CONTACT}.l2:LayeredHertz",
        cost_s=0.0041,
        bounds=L2,
        evidence=f"{_TESTS}/scene/test_picker.py: against L4 on random scenes; "
        f"against finite strain: {_TESTS}/scene/test_finite_strain_scenes.py",
        valid={**_HERTZ_SCENES, "modulus_pa": (1e3, 1e6)},
        fails="beads and balls unlike the paper's, contrast over a deep bead, a soft gel under a light touch",
        survivor="l4",
    ),
    Method(
        task="contact",
        name="l4",
        place=f"{_CONTACT}.l4:HarmonicContact",
        cost_s=0.85,
        bounds=L4,
        evidence=f"{_TESTS}/scene/test_picker.py: against cells of 0.5 mm; {_TESTS}/contact/test_l4.py; "
        f"against finite strain: {_TESTS}/scene/test_finite_strain_scenes.py",
        valid={**FEM_SCENES, "modulus_pa": (1.0, 1e9), "indentation_m": (0.0, 0.006)},
        fails="finite strain: an indentation that nears the gel over the bead",
        survivor="l5",
    ),
    Method(
        task="contact",
        name="l5",
        place=f"{_CONTACT}.l5:FiniteStrainContact",
        cost_s=4.8,
        bounds=L5,
        evidence=f"{_TESTS}/contact/test_l5.py, test_l5_in_3d.py: against finite elements in 3D",
        valid={**FEM_SCENES, "modulus_pa": (1.0, 1e9), "pressed_share": (0.0, PRESSED_MAX)},
        fails="where the tip goes so deep that the gel's elements fold",
    ),
    Method(
        task="motion",
        name="dynamic",
        place=f"{_EQUILIBRIUM}.dynamics:simulate",
        cost_s=1.9,
        bounds=[
            Bound("peak", 0.005, {"speed_m_s": (0.0, 0.1)}),
            Bound("peak", 0.015, {"speed_m_s": (0.0, 0.5)}),
            Bound("contrast", 0.01, {"speed_m_s": (0.0, 0.02), **_RINGS_FELT}),
            Bound("contrast", 0.024, {"speed_m_s": (0.0, 0.1), **_RINGS_FELT}),
            Bound("contrast", 0.1, {"speed_m_s": (0.0, 0.5), **_RINGS_FELT}),
        ],
        evidence=f"{_TESTS}/equilibrium/test_dynamics.py: "
        "step halved, the quasi-static limit, and SciPy's LSODA",
        valid={"speed_m_s": (1e-4, 2.0)},
        fails="seconds of CPU a sweep; the gel's own inertia is left out",
    ),
    Method(
        task="motion",
        name="quasi_static",
        place=f"{_EQUILIBRIUM}.sweep:sweep",
        cost_s=0.003,
        bounds=[
            Bound("peak", 0.005, {"speed_m_s": (0.0, 0.02), **_GELS}),
            Bound("peak", 0.02, {"speed_m_s": (0.0, 0.05), **_GELS}),
            Bound("contrast", 0.02, {"speed_m_s": (0.0, 0.02), **_GELS, **_RINGS_FELT}),
            Bound("contrast", 0.08, {"speed_m_s": (0.0, 0.05), **_GELS, **_RINGS_FELT}),
        ],
        evidence=f"{_TESTS}/equilibrium/test_dynamics.py: peak and contrast against the dynamic joint",
        valid={"speed_m_s": (0.0, 0.1)},
        fails="the joint's inertia and the bead's pull at higher speeds; stick-slip",
        survivor="dynamic",
    ),
]
