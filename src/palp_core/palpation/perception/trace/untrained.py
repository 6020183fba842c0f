"""Sweeps that training did not make, foretold by the mechanics and what training adds.

Training at one indentation and in one direction tells by how much this rig's sweeps differ from the nominal
mechanics: each class's offsets x, by least squares with what was known of them before::

    trained - mechanics = slope x + bend x^2 + remainder

At another setting a sweep is the mechanics there, answering to the same x. The remainder, what no offset
explains, goes with it where the sweep has training's direction; a surface, which it has in it, answers
otherwise to a sweep back. What training leaves open of x is an offset of its own, shared by all sweeps of
untrained settings. A bin in which training's tip may have stuck tells nothing of how sweeps scatter by
stick-slip: it is read nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.trace.filters import TraceKnowledge
from palp_core.palpation.perception.trace.model import Stays, near
from palp_core.palpation.perception.trace.training import UNREAD_N_M, TrainedTraces, sticking
from palp_core.units import Float64Array

_TURNS = 4  # of Gauss and Newton: offsets are small, their answers nearly straight


@dataclass(frozen=True, eq=False)
class Setting:
    """A setting of the model that is to be made.

    Attributes:
        ring: Index of the trained ring position.
        known: What is known of sweeps there, at all trained ring positions; see :class:`.TraceKnowledge`.
        from_bin: Bin of training's path at which it begins.
        taught: Whether training was at its indentation, in its direction: then its traces are training's.
        reversed: Whether it goes the other way than training; its torques count with the other sign.
        faster: Its speed over that of training.
    """

    ring: int
    known: TraceKnowledge
    from_bin: int = 0
    taught: bool = True
    reversed: bool = False
    faster: float = 1.0

    def __post_init__(self) -> None:
        if self.taught and (self.reversed or self.from_bin < 0):
            raise PerceptionError("a sweep back, or one that begins before training's path, was not trained")


@dataclass(frozen=True, eq=False)
class RigOffsets:
    """What training tells of a class's offsets from the nominal rig.

    Attributes:
        mean: Shape (l,).
        root: Lower root of what is left open of them, shape (l, l).
        remainder: What no offset explains, shape (k, b); 0 where training was not read.
    """

    mean: Float64Array
    root: Float64Array
    remainder: Float64Array

    def answer(self, slope: Float64Array, bend: Float64Array) -> Float64Array:
        """Return what the offsets add to a trace of such slopes and bends, shape (b, l) each."""
        return np.asarray(slope @ self.mean + bend @ self.mean**2)


def rig_offsets(trained: TrainedTraces, known: TraceKnowledge, of: int) -> RigOffsets:
    """Return what training tells of the offsets of a class.

    Args:
        trained: What training taught.
        known: What is known at training's own settings.
        of: The class, by index.
    """
    read = ~sticking(known.place_m)  # (k, b)
    felt = (trained.mean[of] - known.mean_n_m[of])[read]
    stays = [one == "trial" for one in known.stays]
    unit = np.where(stays, known.sd, 0.0)  # what passes is in the error: training has averaged it
    slope, bend = (known.slope[of] * unit)[read], (known.bend[of] * unit**2)[read]
    weight = np.linalg.inv(_error(trained, known, of, read))
    mean, left = np.zeros(len(unit)), np.eye(len(unit))
    for _ in range(_TURNS):
        step = slope + 2.0 * bend * mean
        left = np.linalg.inv(step.T @ weight @ step + np.eye(len(unit)))
        mean = left @ (step.T @ weight @ (felt - slope @ mean - bend @ mean**2 + step @ mean))
    remainder = np.zeros(read.shape)
    remainder[read] = felt - slope @ mean - bend @ mean**2
    return RigOffsets(unit * mean, unit[:, None] * np.linalg.cholesky(left), remainder)


def _error(trained: TrainedTraces, known: TraceKnowledge, of: int, read: NDArray[np.bool_]) -> Float64Array:
    """Return the covariance of what else a class's mean traces have in them, in the bins that are read."""
    place_m, settings = known.place_m[of][read], np.nonzero(read)[0]
    found = known.texture.covariance(place_m, place_m) / trained.mountings[of]
    spread = known.slope[of][read] * known.sd
    stays = np.array([one == "trial" for one in known.stays])
    wrong = spread[:, stays] @ spread[:, stays].T * known.slope_error**2
    found = found + wrong * near(place_m, place_m)
    passing = spread[:, ~stays] @ spread[:, ~stays].T
    for setting in np.unique(settings):
        here = settings == setting
        within = np.ix_(here, here)
        new = trained.scatter[setting][np.ix_(read[setting], read[setting])] + passing[within]
        found[within] += new / trained.landings[of, setting]
    return np.asarray(found)


def with_settings(
    trained: TrainedTraces, known: TraceKnowledge, settings: Sequence[Setting]
) -> tuple[TrainedTraces, TraceKnowledge]:
    """Return training and knowledge of other settings, as any method of task ``trace_filter`` takes them.

    Args:
        trained: What training taught, at the classes to decide among.
        known: What is known at training's own settings, with the texture.
        settings: The settings, in the order of the model's.

    Raises:
        PerceptionError: A setting's bins or classes are not those of training.
    """
    for one in settings:
        if one.known.mean_n_m.shape != known.mean_n_m.shape:
            raise PerceptionError(
                f"a setting of traces of shape {one.known.mean_n_m.shape} where training has "
                f"{known.mean_n_m.shape}"
            )
    held = sticking(known.place_m)
    rigs = [rig_offsets(trained, known, c) for c in range(len(trained.depths_m))]
    rings = [one.ring for one in settings]
    mean = np.stack([_mean(trained, rigs, one) for one in settings], axis=1)
    # a filter widens what stays by training's share; this is training's own
    share = np.sqrt(1.0 + 1.0 / trained.mountings)[:, None, None]
    opened = np.stack(
        [
            np.stack([one.known.slope[c, one.ring] @ rig.root for c, rig in enumerate(rigs)]) / share
            if not one.taught
            else np.zeros((len(rigs), *known.slope.shape[2:]))
            for one in settings
        ],
        axis=1,
    )
    at = [one.known for one in settings]
    left_open: list[Stays] = ["trial"] * len(known.stays)
    extended = TraceKnowledge(
        (*known.names, *(f"training's {name}" for name in known.names)),
        np.concatenate([known.sd, np.ones(len(known.sd))]),
        (*known.stays, *left_open),
        np.stack([k.mean_n_m[:, ring] for k, ring in zip(at, rings, strict=True)], axis=1),
        np.concatenate(
            [np.stack([k.slope[:, ring] for k, ring in zip(at, rings, strict=True)], axis=1), opened], axis=-1
        ),
        np.concatenate(
            [np.stack([k.bend[:, ring] for k, ring in zip(at, rings, strict=True)], axis=1), 0.0 * opened],
            axis=-1,
        ),
        known.slope_error,
        known.texture,
        np.stack([k.place_m[:, ring] for k, ring in zip(at, rings, strict=True)], axis=1),
    )
    return (
        replace(
            trained,
            rings_m=trained.rings_m[rings],
            mean=mean,
            landings=trained.landings[:, rings],
            scatter=np.stack([_scatter(trained, one, held) for one in settings]),
            between=np.zeros((0, *mean.shape[1:])),
            between_class=np.zeros(0, dtype=np.int64),
        ),
        extended,
    )


def _bins(setting: Setting, count: int) -> tuple[slice, slice]:
    """Return which bins of a setting, and of training's path, are the same."""
    first = setting.from_bin
    return slice(max(-first, 0), min(count - first, count)), slice(max(first, 0), min(count + first, count))


def _mean(trained: TrainedTraces, rigs: Sequence[RigOffsets], setting: Setting) -> Float64Array:
    """Return the mean traces of a setting, shape (m, b)."""
    known, ring = setting.known, setting.ring
    found = np.stack(
        [
            known.mean_n_m[c, ring] + rig.answer(known.slope[c, ring], known.bend[c, ring])
            for c, rig in enumerate(rigs)
        ]
    )
    if not setting.reversed:
        own, theirs = _bins(setting, found.shape[1])
        if setting.taught:
            found[:, own] = trained.mean[:, ring, theirs]
        else:
            found[:, own] += np.stack([rig.remainder[ring, theirs] for rig in rigs])
    return found


def _scatter(trained: TrainedTraces, setting: Setting, held: NDArray[np.bool_]) -> Float64Array:
    """Return what is new with every sweep of a setting, shape (b, b).

    Training's own at its indentation and speed, in its direction. Elsewhere a tip sticks and slips at another
    pace, and where along the path is not known: each bin scatters like the worst of training's, by itself. A
    faster sweep has fewer samples a bin; of a slower one nothing is promised. Bins say nothing that training
    did not read: beyond its path, or ``held`` there, shape (k, b).
    """
    learnt = trained.scatter[setting.ring]
    count = len(learnt)
    if not (setting.taught and setting.faster == 1.0):
        unread = held[setting.ring]
        worst = float(np.diag(learnt)[~unread].max(initial=0.0))
        learnt = np.diag(np.where(unread, UNREAD_N_M**2, max(1.0, setting.faster) * worst))
    found = UNREAD_N_M**2 * np.eye(count)
    own, theirs = _bins(setting, count) if not setting.reversed else (slice(count), slice(count))
    found[own, own] = learnt[theirs, theirs]
    return found
