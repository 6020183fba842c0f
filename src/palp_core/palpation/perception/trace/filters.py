"""Models by which a belief follows a sweep, as methods of the register: task ``trace_filter``."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.methods import declare_task, find, method
from palp_core.palpation.perception.belief.rig_noise import on_depths
from palp_core.palpation.perception.trace.model import Stays, TraceModel, on_grid
from palp_core.palpation.perception.trace.texture import Texture
from palp_core.palpation.perception.trace.training import LANDING, TraceOffsets, TrainedTraces, trace_model
from palp_core.units import Float64Array

NODES = 5
"""Of a grid over an offset: they stand one standard deviation apart."""


@dataclass(frozen=True, eq=False)
class TraceKnowledge:
    """What is known of a rig beside what its training taught: how sweeps differ, and by how much.

    Attributes:
        names: Of the offsets; ``landing`` takes its slope from training.
        sd: Spread of each, in its unit, shape (l,).
        stays: How long each stays.
        slope: Change of the trace by a unit of each by the mechanics, shape (m, k, b, l).
        bend: What its square adds, shape (m, k, b, l).
        texture: What the surface adds along a track.
        place_m: Where the ball touches in each bin, shape (m, k, b).
    """

    names: tuple[str, ...]
    sd: Float64Array
    stays: tuple[Stays, ...]
    slope: Float64Array
    bend: Float64Array
    texture: Texture
    place_m: Float64Array

    @property
    def offsets(self) -> TraceOffsets:
        """Without the bends."""
        return TraceOffsets(self.names, self.sd, self.stays, self.slope)

    def most_curved(self) -> int:
        """Return the index of the offset to which the torque answers least in a straight line.

        Raises:
            PerceptionError: Nothing is known to differ but the landing.
        """
        curved = np.abs(self.bend).max(axis=(0, 1, 2)) * self.sd**2
        curved = np.where(np.array(self.names) == LANDING, -1.0, curved)
        if not (curved >= 0.0).any():
            raise PerceptionError("a grid needs an offset that stays; give one a spread, as friction_sd: 0.1")
        return int(np.argmax(curved))


declare_task(
    "trace_filter",
    "What do torques along a sweep say of the class, with what stays accounted for?",
    per="a sweep",
    output="decision",
    tolerance=0.05,
)


@method(
    task="trace_filter",
    name="linear",
    cost_s=6e-4,
    evidence="tests/palpation/perception/trace/test_filters.py",
    fails="offsets to which the torque does not answer in a straight line: it states more than it knows",
    survivor="grid",
)
def linear(trained: TrainedTraces, known: TraceKnowledge) -> TraceModel:
    """Return a model with one component a class: the torque answers to every offset in a straight line."""
    return trace_model(trained, known.offsets, known.texture, known.place_m)


@method(
    task="trace_filter",
    name="grid",
    cost_s=2.4e-3,
    evidence="tests/palpation/perception/trace/test_filters.py",
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


def model_of(name: str, trained: TrainedTraces, known: TraceKnowledge, depths_m: Float64Array) -> TraceModel:
    """Return the model of a method of task ``trace_filter``.

    Args:
        name: The method.
        trained: What training taught.
        known: What else is known.
        depths_m: Depths to decide among: the trained ones, or a grid over their range.

    Raises:
        MethodError: There is no such method.
        PerceptionError: It needs to know of an offset and is told of none.
    """
    taught_m = trained.depths_m
    if depths_m.size != taught_m.size:
        trained = replace(
            trained,
            depths_m=depths_m,
            mean=on_depths(trained.mean, taught_m, depths_m),
            mountings=np.full(depths_m.size, trained.mountings.min()),
            landings=np.tile(trained.landings.min(axis=0), (depths_m.size, 1)),
        )
        between = (on_depths(one, taught_m, depths_m) for one in (known.slope, known.bend, known.place_m))
        slope, bend, place_m = between
        known = replace(known, slope=slope, bend=bend, place_m=place_m)
    model: TraceModel = find("trace_filter", name).target(trained, known)
    return model
