"""Models by which a belief follows a sweep, as methods of the register: task ``trace_filter``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.methods import Bound, Range, declare_task, find, method
from palp_core.palpation.perception.belief.rig_noise import on_depths
from palp_core.palpation.perception.ranges import ABOUT, ENDLESS, LANDS_M, STEP_N_M, USUAL
from palp_core.palpation.perception.trace.model import Stays, TraceModel, on_grid
from palp_core.palpation.perception.trace.texture import Texture, fit_texture
from palp_core.palpation.perception.trace.training import TraceOffsets, TrainedTraces, trace_model
from palp_core.units import Float64Array

NODES = 5
"""Of a grid over an offset: they stand one standard deviation apart."""
FEW = 4
"""Mountings, of classes with several, from which a texture is fitted; from fewer it is assumed."""


@dataclass(frozen=True, eq=False)
class TraceKnowledge:
    """What is known of a rig beside what its training taught: how sweeps differ, and by how much.

    Attributes:
        names: Of the offsets.
        sd: Spread of each, in its unit, shape (l,).
        stays: How long each stays.
        mean_n_m: The trace by the mechanics, shape (m, k, b).
        slope: Its change by a unit of each offset, shape (m, k, b, l).
        bend: What the offset's square adds, shape (m, k, b, l).
        slope_error: What slopes are taken to be wrong by, relative.
        texture: What the surface adds along a track, where training does not tell it.
        place_m: Where the ball touches in each bin, shape (m, k, b): where it does not move, it sticks.
    """

    names: tuple[str, ...]
    sd: Float64Array
    stays: tuple[Stays, ...]
    mean_n_m: Float64Array
    slope: Float64Array
    bend: Float64Array
    slope_error: float
    texture: Texture
    place_m: Float64Array

    @property
    def straight(self) -> TraceOffsets:
        """The offsets, to which the torque answers in straight lines."""
        return TraceOffsets(self.names, self.sd, self.stays, self.slope, self.slope_error)

    @property
    def bent(self) -> TraceOffsets:
        """The offsets and, as further ones, the squares of those whose answer bends.

        The square of a normal number of spread s has the spread sqrt(2) s^2 about its mean, which training's
        own mean has in it.
        """
        which = [i for i in range(len(self.names)) if self.bend[..., i].any()]
        return TraceOffsets(
            (*self.names, *(f"{self.names[i]} squared" for i in which)),
            np.concatenate([self.sd, 2**0.5 * self.sd[which] ** 2]),
            (*self.stays, *(self.stays[i] for i in which)),
            np.concatenate([self.slope, self.bend[..., which]], axis=-1),
            self.slope_error,
        )

    def most_curved(self) -> int:
        """Return the index of the offset to which the torque answers least in a straight line.

        Raises:
            PerceptionError: Nothing that stays for a trial answers in a curve.
        """
        curved = np.abs(self.bend).max(axis=(0, 1, 2)) * self.sd**2
        curved = np.where([stays == "trial" for stays in self.stays], curved, 0.0)
        if not (curved > 0.0).any():
            raise PerceptionError("a grid needs an offset that stays; give one a spread, as friction_sd: 0.1")
        return int(np.argmax(curved))


declare_task(
    "trace_filter",
    "What do torques along a sweep say of the class, with what stays accounted for?",
    per="a sweep",
    output="decision",
    tolerance=0.02,  # what a rule that stops at 0.99 gets wrong by itself, and as much again
)

_USUAL_SD = {
    "trace_height_sd_m": 2e-4,
    "friction_sd": 0.1,
    "modulus_sd": 0.1,
    "place_sd_m": 1e-3,
    "tip_sd_m": 1e-4,
}


def _within(touch: Mapping[str, Range], low: float, high: float, **other: Range) -> dict[str, Range]:
    """Return where errors of one sweep were measured.

    Args:
        touch: What is touched.
        low: Least that a filter is told, as a share of the usual spreads.
        high: Most.
        **other: Ranges that differ from those of the usual session.
    """
    return {
        **touch,
        **{name: (low * sd * 0.999, high * sd * 1.001) for name, sd in _USUAL_SD.items()},
        "slope_error": (0.19, 0.21),
        "texture_sd_n_m": (1.9e-4, 2.1e-4),
        "bin_m": (0.0019, 0.0021),
        "stiffest_m": (0.0159, 0.0161),
        "ring_sd_m": (0.0, LANDS_M),
        "noise_n_m": (0.0, STEP_N_M),
        "training_count": (25.0, ENDLESS),
        **other,
    }


_ABOUT = _within(
    {**ABOUT, "indentation_m": (0.003, 0.0045), "class_ratio": (1.5, ENDLESS), "class_count": (2.0, 31.0)},
    0.0,
    1.0,
    slope_error=(0.0, 0.3),
    texture_sd_n_m=(0.5e-4, 4e-4),
    noise_n_m=(0.0, 5.0 * STEP_N_M),
    training_count=(2.0, ENDLESS),
)
_TRAINED = {**_ABOUT, "training_count": (6.0, ENDLESS)}  # of fewer palpations a cell beliefs are too sure
_USUAL, _LITTLE = _within(USUAL, 0.0, 1.0), _within(USUAL, 0.0, 0.5)
_MUCH, _WIDE = _within(USUAL, 0.0, 2.0), _within(USUAL, 0.1, 2.0)
_ONE_PHANTOM = _within(USUAL, 0.0, 1.5, training_count=(2.0, ENDLESS))
# trials of other phantoms than the one of training differ from it by sqrt(2) times what phantoms scatter


@method(
    task="trace_filter",
    name="linear",
    cost_s=2.5e-4,
    bounds=[
        Bound("decision", 0.005, _LITTLE),
        Bound("calibration", 0.005, _LITTLE),
        Bound("decision", 0.056, _ABOUT),
        Bound("calibration", 0.11, _TRAINED),
    ],
    evidence="tests/palpation/studies/perception/test_method_bounds.py",
    fails="offsets to which the torque does not answer in a straight line: it states more than it knows",
    survivor="second_order",
)
def linear(trained: TrainedTraces, known: TraceKnowledge) -> TraceModel:
    """Return a model with one component a class: the torque answers to every offset in a straight line."""
    return trace_model(trained, known.straight, known.texture, known.place_m)


@method(
    task="trace_filter",
    name="second_order",
    cost_s=2.6e-4,
    bounds=[
        Bound("decision", 0.0062, _USUAL),
        Bound("calibration", 0.053, _USUAL),
        Bound("decision", 0.0186, _ABOUT),
        Bound("decision", 0.037, _ONE_PHANTOM),
        Bound("calibration", 0.1, _TRAINED),
        Bound("decision", 0.037, _MUCH),
        Bound("calibration", 0.15, _MUCH),
    ],
    evidence="tests/palpation/studies/perception/test_method_bounds.py",
    fails="answers that a parabola over two spreads of an offset does not follow, or two offsets at once; "
    "trained on one phantom and asked about others, unless it is told half as much spread again",
    survivor="grid",
)
def second_order(trained: TrainedTraces, known: TraceKnowledge) -> TraceModel:
    """Return a model with one component a class, in which squares of offsets are offsets of their own."""
    return trace_model(trained, known.bent, known.texture, known.place_m)


@method(
    task="trace_filter",
    name="grid",
    cost_s=2.8e-4,
    bounds=[Bound("decision", 0.028, _WIDE), Bound("calibration", 0.15, _WIDE)],
    evidence="tests/palpation/studies/perception/test_method_bounds.py",
    fails="two offsets at once to which the torque answers in a curve",
)
def grid(trained: TrainedTraces, known: TraceKnowledge) -> TraceModel:
    """Return a model that is straight only about nodes of the offset with the most curved answer."""
    of, straight = known.most_curved(), linear(trained, known)
    # an offset counts against that of training's mountings: of few of them it spreads more
    scale = float(np.sqrt(1.0 + 1.0 / trained.mountings.min()))
    slope_of, bend_of = known.slope[..., of], known.bend[..., of]
    nodes = []
    for at in known.sd[of] * scale * (np.arange(NODES) - 0.5 * (NODES - 1)):
        slope = straight.slope.copy()
        slope[..., of] = scale * (slope_of + 2.0 * bend_of * at)
        nodes.append((slope_of * at + bend_of * at**2, slope))
    return on_grid(straight, of, nodes, 0.5 * float(known.sd[of]))


@dataclass(frozen=True, eq=False)
class DepthGrid:
    """Depths to decide among that are not those of training.

    Attributes:
        depths_m: The depths, increasing, within the trained range.
        known: What :class:`TraceKnowledge` says there.
    """

    depths_m: Float64Array
    known: TraceKnowledge


def model_of(
    name: str, trained: TrainedTraces, known: TraceKnowledge, grid: DepthGrid | None = None
) -> TraceModel:
    """Return the model of a method of task ``trace_filter``.

    The texture is that of training's mountings where there are several, else the one that is assumed.

    Args:
        name: The method.
        trained: What training taught.
        known: What else is known, at the trained depths.
        grid: Depths to decide among; None: the trained ones.

    Raises:
        MethodError: There is no such method.
        PerceptionError: It needs to know of an offset and is told of none.
    """
    model: TraceModel = find("trace_filter", name).target(*settled(trained, known, grid))
    return model


def settled(
    trained: TrainedTraces, known: TraceKnowledge, grid: DepthGrid | None = None
) -> tuple[TrainedTraces, TraceKnowledge]:
    """Return what a method of task ``trace_filter`` is given: at the depths to decide among, with a texture.

    Arguments as of :func:`model_of`.
    """
    texture = _texture(trained, known)
    if grid is not None:
        trained, known = _between(trained, known, grid), grid.known
    return trained, replace(known, texture=texture)


def _texture(trained: TrainedTraces, known: TraceKnowledge) -> Texture:
    """Return the texture of the mountings at the stiffest ring, or the assumed one."""
    if len(trained.between) < FEW:
        return known.texture
    of, stiffest, offsets = trained.between_class, len(trained.rings_m) - 1, known.bent
    shrunk = np.sqrt(
        1.0 - 1.0 / trained.mountings[of]
    )  # a mounting is part of the mean that it is held against
    return fit_texture(
        trained.between[:, stiffest] / shrunk[:, None],
        offsets.slope[of, stiffest],
        offsets.sd,
        trained.scatter[stiffest] * trained.mountings.max() / trained.landings[:, stiffest].min(),
        known.place_m[of, stiffest],
    )


def _between(trained: TrainedTraces, known: TraceKnowledge, grid: DepthGrid) -> TrainedTraces:
    """Return training at other depths: the mechanics' traces there, and over them what training adds.

    A trace changes its form with depth more than a curve through a few depths tells; what training differs by
    from the mechanics changes slowly.
    """
    added = on_depths(trained.mean - known.mean_n_m, trained.depths_m, grid.depths_m)
    count = grid.depths_m.size
    return replace(
        trained,
        depths_m=grid.depths_m,
        mean=grid.known.mean_n_m + added,
        mountings=np.full(count, trained.mountings.min()),
        landings=np.tile(trained.landings.min(axis=0), (count, 1)),
    )
