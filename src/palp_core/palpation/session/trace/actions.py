"""The sweeps that a rig may be asked for, their limits, and what they look like after its training."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palp_core.errors import MechanicsError, MethodError, PerceptionError
from palp_core.methods import find
from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.belief.rig_noise import RigNoise
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.perception.trace.actions import ActionModel, LoadLimits, SweepAction
from palp_core.palpation.perception.trace.filters import DepthGrid, TraceKnowledge, settled
from palp_core.palpation.perception.trace.model import TraceModel
from palp_core.palpation.perception.trace.training import TrainedTraces
from palp_core.palpation.perception.trace.untrained import Setting, with_settings
from palp_core.palpation.session.trace.settings import TraceSettings

STOP = LoadLimits(torque_n_m=0.100, force_n=10.0)
"""Where the safety node stops the rig, below what the sensor can tell (assumed)."""
_NEAR_M, _NEAR = 1e-9, 1e-6


@dataclass(frozen=True)
class ActionSet:
    """Every combination of what may be chosen.

    Attributes:
        rings_m: Positions of the ring.
        indentations_m: Nominal indentations.
        speeds_m_per_s: Of the stage.
        paths_m: Beginning and end of each path; one whose end is smaller is swept back.
    """

    rings_m: tuple[float, ...]
    indentations_m: tuple[float, ...]
    speeds_m_per_s: tuple[float, ...]
    paths_m: tuple[tuple[float, float], ...]

    @property
    def actions(self) -> tuple[SweepAction, ...]:
        """All of them; the first of each attribute first."""
        return tuple(
            SweepAction(ring_m, indentation_m, speed, *path)
            for path, speed, indentation_m, ring_m in itertools.product(
                self.paths_m, self.speeds_m_per_s, self.indentations_m, self.rings_m
            )
        )


class _Touch(NamedTuple):
    """What the mechanics are asked for, at all rings at once."""

    indentation_m: float
    from_m: float
    backward: bool


class _Key(NamedTuple):
    """A setting of the model: actions that differ in where they end share it."""

    touch: _Touch
    ring: int
    speed_m_per_s: float


def action_model(
    settings: TraceSettings,
    trained: TrainedTraces,
    actions: Sequence[SweepAction],
    limits: LoadLimits = STOP,
    *,
    noise: RigNoise | None = None,
    scene: Scene | None = None,
    speed_m_per_s: float = 0.020,
) -> ActionModel:
    """Return what the sweeps of actions look like, and which are offered.

    Mean traces at training's indentation and in its direction are training's own; others are the mechanics'
    and what training adds. Every contact is by the rung that vouches for training's indentation.

    Args:
        settings: Of training: its path, and what is assumed to differ between sweeps.
        trained: What training taught.
        actions: What may be asked for.
        limits: What the expected torque and force, with their spread, must stay below.
        noise: In place of the settings' spreads of landing and height.
        scene: In place of the settings' scene; its indentation is training's.
        speed_m_per_s: Of training.

    Raises:
        PerceptionError: No action is left, or the filter needs an offset and there is none.
        MethodError: There is no such filter, or no contact rung is good enough for the scene.
    """
    rig = _rig(settings, trained, noise, scene)
    refused = {action: why for action in actions if (why := rig.misfit(action))}
    touches: dict[_Touch, TraceKnowledge] = {}
    for touch in dict.fromkeys(rig.key(action).touch for action in actions if action not in refused):
        try:
            touches[touch] = rig.knowledge(touch)
        except (MechanicsError, MethodError) as error:
            refused |= {a: str(error) for a in actions if a not in refused and rig.key(a).touch == touch}
    possible = [action for action in actions if action not in refused]
    keys = list(dict.fromkeys(rig.key(action) for action in possible))
    wanted = [rig.setting(key, touches[key.touch], key.speed_m_per_s / speed_m_per_s) for key in keys]
    offered: list[SweepAction] = []
    model = _model(settings.trace_filter, rig, wanted) if wanted else None
    for action in possible if model else ():
        assert model is not None
        key = rig.key(action)
        torque_n_m = expected_torque_n_m(model, keys.index(key), rig.bins(action), limits.spreads)
        if why := limits.refusal(torque_n_m, rig.force_n(key, rig.bins(action), limits.spreads)):
            refused[action] = why
        else:
            offered.append(action)
    if model is None or not offered:
        raise PerceptionError(f"no action is left to choose: {next(iter(refused.values()), 'none is named')}")
    return ActionModel(
        model,
        tuple(offered),
        tuple(keys.index(rig.key(action)) for action in offered),
        tuple(rig.bins(action) for action in offered),
        refused,
    )


def expected_torque_n_m(model: TraceModel, setting: int, bins: int, spreads: float) -> float:
    """Return the largest torque that is to be expected in the first bins of a first sweep."""
    read = slice(bins)
    answer = model.slope[:, setting, read] * model.offset_sd
    sd = np.sqrt((answer**2).sum(axis=-1) + model.texture.sd_n_m**2)
    return float((np.abs(model.mean[:, setting, read]) + spreads * sd).max())


@dataclass(frozen=True, eq=False)
class _Rig:
    """Training, settings and what is known, from which settings of a model are made."""

    settings: TraceSettings
    trained: TrainedTraces
    known: TraceKnowledge
    scene: Scene
    noise: RigNoise
    classes_m: list[float]
    rungs: tuple[str, ...]

    @property
    def backward(self) -> bool:
        """Whether training went towards -Y."""
        return self.settings.to_m < self.settings.from_m

    def key(self, action: SweepAction) -> _Key:
        """Return the setting of an action."""
        ring = int(np.argmin(np.abs(self.trained.rings_m - action.ring_m)))
        touch = _Touch(action.indentation_m, action.from_m, action.backward)
        return _Key(touch, ring, action.speed_m_per_s)

    def bins(self, action: SweepAction) -> int:
        """Return how many bins an action sweeps."""
        return round(action.way_m / abs(self.settings.bins.width_m))

    def misfit(self, action: SweepAction) -> str:
        """Return why an action is none of this rig's; empty if it is one."""
        bins = self.settings.bins
        if not np.isclose(self.trained.rings_m, action.ring_m, atol=_NEAR_M).any():
            return f"the ring was not trained at {action.ring_m * 1e3:g} mm"
        steps = (np.array([action.from_m, action.to_m]) - bins.from_m) / bins.width_m
        if steps.min() < -_NEAR or steps.max() > bins.count + _NEAR:
            low, high = sorted((bins.from_m, bins.from_m + bins.count * bins.width_m))
            return f"it leaves the path of training, {low * 1e3:g} to {high * 1e3:g} mm"
        if np.abs(steps - np.rint(steps)).max() > _NEAR:
            return f"it begins or ends within a bin of {abs(bins.width_m) * 1e3:g} mm"
        return ""

    def own(self, touch: _Touch) -> tuple[TraceSettings, Scene]:
        """Return settings and scene of a touch: a path as long as training's."""
        bins = self.settings.bins
        way_m = bins.count * abs(bins.width_m) * (-1.0 if touch.backward else 1.0)
        return (
            replace(self.settings, from_m=touch.from_m, to_m=touch.from_m + way_m),
            replace(self.scene, path=replace(self.scene.path, indentation_m=touch.indentation_m)),
        )

    def knowledge(self, touch: _Touch) -> TraceKnowledge:
        """Return what is known of sweeps at all rings, torques in training's sign.

        Raises:
            MechanicsError: A sweep has no solution there.
        """
        settings, scene = self.own(touch)
        rings_m = self.trained.rings_m.tolist()
        found = settings.knowledge(scene, self.noise, self.classes_m, rings_m, self.rungs)
        if touch.backward == self.backward:
            return found
        return replace(found, mean_n_m=-found.mean_n_m, slope=-found.slope, bend=-found.bend)

    def setting(self, key: _Key, known: TraceKnowledge, faster: float) -> Setting:
        """Return a setting of the model."""
        touch, bins = key.touch, self.settings.bins
        backward = touch.backward != self.backward
        alike = abs(touch.indentation_m - self.scene.path.indentation_m) < _NEAR_M
        return Setting(
            key.ring,
            known,
            0 if backward else round((touch.from_m - bins.from_m) / bins.width_m),
            taught=alike and not backward,
            reversed=backward,
            faster=faster,
        )

    def force_n(self, key: _Key, bins: int, spreads: float) -> float:
        """Return the largest normal force that is to be expected in the first bins."""
        settings, scene = self.own(key.touch)
        rings_m = self.trained.rings_m.tolist()
        found = settings.slopes(scene, self.noise, self.classes_m, rings_m, self.rungs)
        sd = np.array(list(settings.spreads(self.noise).values()))
        spread = np.sqrt(((found.normal_slope[:, key.ring] * sd) ** 2).sum(axis=-1))
        order = slice(None, None, -1) if key.touch.backward else slice(None)
        return float((found.normal_n[:, key.ring] + spreads * spread)[:, order][:, :bins].max())


def _rig(
    settings: TraceSettings, trained: TrainedTraces, noise: RigNoise | None, scene: Scene | None
) -> _Rig:
    """Return what settings are made from, at the depths to decide among."""
    scene, noise = settings.of_rig(noise, scene)
    taught_m, rings_m = trained.depths_m.tolist(), trained.rings_m.tolist()
    known = settings.knowledge(scene, noise, taught_m, rings_m)
    grid = None
    if settings.depths:
        classes_m = classes_of(taught_m, settings.depths)
        grid = DepthGrid(classes_m, settings.knowledge(scene, noise, classes_m.tolist(), rings_m))
    trained, known = settled(trained, known, grid)
    depths_m = trained.depths_m.tolist()
    rungs = tuple(choose_rung(scene.with_bead(depth_m)).rung for depth_m in depths_m)
    return _Rig(settings, trained, known, scene, noise, depths_m, rungs)


def _model(trace_filter: str, rig: _Rig, settings: Sequence[Setting]) -> TraceModel:
    """Return the filter's model of settings."""
    model: TraceModel = find("trace_filter", trace_filter).target(
        *with_settings(rig.trained, rig.known, settings)
    )
    return replace(model, backward=np.array([one.reversed for one in settings]))
