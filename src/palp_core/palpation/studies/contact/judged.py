"""One random scene of the study ``contact-validity``: what every rung gives there, kept as a line of a file.

What is kept are errors and times. Which rung is chosen, and by which bound, is asked of the register whenever
the line is read: a bound stated anew is judged by the scenes that are there already.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from palp_core.errors import MechanicsError, MethodError
from palp_core.graph.clock import monotonic_ns
from palp_core.methods import find, methods
from palp_core.palpation.mechanics import ContactModel, Scene, choose_rung, run_scene
from palp_core.palpation.mechanics.contact.cache import code
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.mechanics.scene.guard import states_finite_strain
from palp_core.palpation.mechanics.scene.output import answer, answer_error
from palp_core.palpation.studies.contact.cost import asked_for, cold_cache, side_by_side
from palp_core.palpation.studies.contact.scenes import near_scene, random_scene
from palp_core.units import Float64Array

REFERENCE_CELL_M = 0.0005
NEAR = 1_000_000
"""Index from which on scenes are drawn near the published rig, where most bounds of L2 hold."""

_SEED = 21
_DIGITS = 9
_NORMAL_AT = (0.2, 0.5, 1.0)  # of the nominal indentation, at offsets out to the bead's reach


def scene_of(index: int) -> Scene:
    """Return the random scene of an index, from :data:`NEAR` on near the published rig.

    It is the same whatever was drawn before.
    """
    rng = np.random.default_rng([_SEED, index])
    return near_scene(rng) if index >= NEAR else random_scene(rng)


def scene_keys(scene: Scene) -> dict[str, Any]:
    """Return a scene as its file has it."""
    bead, probe, asked = scene.phantom.bead, scene.probe, scene.tolerance
    return {
        "phantom": {
            "modulus_pa": scene.phantom.modulus_pa,
            "poisson": scene.phantom.poisson,
            "height_m": scene.phantom.height_m,
            "bead": {"radius_m": bead.radius_m, "depth_m": bead.depth_m} if bead else "none",
        },
        "probe": {
            "tip_radius_m": probe.tip_radius_m,
            "friction": probe.friction,
            "tip_mass_kg": probe.tip_mass_kg,
        },
        "path": {
            "indentation_m": scene.path.indentation_m,
            "from_m": scene.path.from_m,
            "to_m": scene.path.to_m,
        },
        "ring_m": list(scene.ring_m),
        "tolerance": {
            "output": asked.output,
            "relative": asked.relative,
            "depths_m": list(asked.depths_m),
        },
    }


def rungs() -> list[str]:
    """Return the rungs to hold against L4: not another constitutive law."""
    return [one.name for one in methods("contact") if not states_finite_strain(one)]


def reference_models(scene: Scene) -> list[ContactModel]:
    """Return the finest rung, L4 at 0.5 mm, for each of a scene's phantoms."""
    return [
        HarmonicContact(phantom, scene.probe.tip_radius_m, REFERENCE_CELL_M) for phantom in scene.phantoms
    ]


@dataclass(frozen=True, eq=False)
class Judged:
    """A random scene and how every rung does there.

    Attributes:
        index: Which of the random scenes.
        scene: The scene.
        errors: True error by output, then by rung that answers; the scene's own output is among them.
        setup_s: Seconds of set-up per rung, nothing cached.
        cost_s: Seconds of runs per rung that would have done, repeats in turns, nothing to set up.
        truth: The reference's answer.
        skipped: Why there is nothing to be right about; empty if there is.
    """

    index: int
    scene: Scene
    errors: dict[str, dict[str, float]]
    setup_s: dict[str, float]
    cost_s: dict[str, list[float]]
    truth: list[Any]
    skipped: str = ""

    @property
    def failed(self) -> bool:
        """Whether it was skipped for another reason than a tip that leads: the reference itself failed."""
        return bool(self.skipped) and "no lagging equilibrium" not in self.skipped

    @functools.cached_property
    def _chosen(self) -> tuple[str, float | None]:
        try:
            choice = choose_rung(self.scene)
        except MethodError:
            return "", None
        return choice.rung, choice.bound

    @property
    def rung(self) -> str:
        """The chosen rung; empty if none vouches for the tolerance."""
        return self._chosen[0]

    @property
    def bound(self) -> float | None:
        """Its stated error."""
        return self._chosen[1]

    @property
    def own(self) -> dict[str, float]:
        """True error of the scene's output per rung that answers."""
        return self.errors.get(self.scene.tolerance.output, {})

    @property
    def wrong(self) -> bool:
        """Whether the chosen rung is less right than was asked for; nothing is where there is no answer."""
        return (
            not self.skipped
            and bool(self.rung)
            and not self.own.get(self.rung, np.inf) <= self.scene.tolerance.relative
        )

    @property
    def bounds(self) -> dict[str, dict[str, float]]:
        """Stated error by output and rung, where there is one."""
        stated: dict[str, dict[str, float]] = {}
        for output in self.errors:
            quantities = asked_for(self.scene, output).quantities()
            if output == "normal":
                quantities["indentation_m"] = tuple(self.scene.path.indentation_m * a for a in _NORMAL_AT)
            found = {name: find("contact", name).bound(output, quantities) for name in rungs()}
            stated[output] = {name: bound for name, bound in found.items() if bound is not None}
        return stated

    @property
    def broken(self) -> list[str]:
        """Stated bounds that are not kept, in words."""
        words = []
        for output, stated in self.bounds.items():
            for rung, bound in stated.items():
                error = self.errors[output].get(rung, np.inf)
                if not error <= bound:
                    words.append(
                        f"scene {self.index}: {rung}'s {output} is off by {error:.2%}, not {bound:.2%}"
                    )
        return words

    @property
    def cost_ratio(self) -> float | None:
        """Cost of the chosen rung over that of the cheapest that would have done, medians of repeats."""
        medians = {rung: float(np.median(taken)) for rung, taken in self.cost_s.items()}
        return medians[self.rung] / min(medians.values()) if self.rung in medians else None

    def line(self) -> str:
        """Return what is kept of it, as a line of JSON."""
        return json.dumps(
            {
                "index": self.index,
                "code": code().hex(),
                **scene_keys(self.scene),
                "errors": self.errors,
                "setup_s": self.setup_s,
                "cost_s": self.cost_s,
                "skipped": self.skipped,
                "truth": self.truth,
            }
        )

    @classmethod
    def of_line(cls, text: str, *, any_code: bool = False) -> Judged | None:
        """Return it again; None for a line cut short, another draw, or errors of other models.

        Args:
            text: A line.
            any_code: Take it whatever the source of the models was.
        """
        try:
            kept = json.loads(text)
            scene = scene_of(kept["index"])
            known = kept["code"] if any_code else code().hex()
            if kept["code"] != known or not all(_same(kept[k], v) for k, v in scene_keys(scene).items()):
                return None
            names = ("index", "errors", "setup_s", "cost_s", "truth", "skipped")
            return cls(scene=scene, **{name: kept[name] for name in names})
        except (ValueError, KeyError, TypeError):
            return None


def judge(index: int, *, timed: bool = True) -> Judged:
    """Hold every rung against the finest one in a random scene.

    Args:
        index: Which scene.
        timed: Also time the rungs that would have done.

    Returns:
        What was found; that the reference has no answer is found too.
    """
    scene = scene_of(index)
    probe = scene.probe
    setup_s: dict[str, float] = {}
    with cold_cache():
        ready: dict[str, list[ContactModel]] = {}
        for name in rungs():
            start_ns = monotonic_ns()
            try:
                models = [rung_model(name, one, probe.tip_radius_m) for one in scene.phantoms]
                for model in models:
                    model.force(np.zeros(1), np.full(1, 1e-4))
            except (MechanicsError, MethodError):
                continue
            ready[name] = models
            setup_s[name] = round((monotonic_ns() - start_ns) / 1e9, 4)
        reference = reference_models(scene)
        try:
            truth = answer(reference, scene)
        except MechanicsError as error:
            return Judged(index, scene, {}, setup_s, {}, [], str(error))
        errors = {scene.tolerance.output: _errors(ready, truth, scene)}
        for output in ("peak", "contrast", "trace"):
            if output not in errors and not (output == "contrast" and scene.phantom.bead is None):
                other = asked_for(scene, output)
                errors[output] = _errors(ready, answer(reference, other), other)
        errors["normal"] = _normal_errors(ready, reference[0], scene)
        enough = [name for name, error in errors[scene.tolerance.output].items() if timed]
        enough = [n for n in enough if errors[scene.tolerance.output][n] <= scene.tolerance.relative]
        cost_s = side_by_side({name: functools.partial(run_scene, scene, name) for name in enough})
    if scene.tolerance.output == "decision":
        kept: list[Any] = ["".join(map(str, row)) for row in truth.astype(int).tolist()]
    else:
        kept = truth.tolist()
    return Judged(index, scene, errors, setup_s, cost_s, kept)


def _errors(ready: Mapping[str, list[ContactModel]], truth: Float64Array, scene: Scene) -> dict[str, float]:
    """Return the true error of each rung that answers."""
    errors = {}
    for name, models in ready.items():
        try:
            errors[name] = float(f"{answer_error(answer(models, scene), truth, scene):.{_DIGITS}g}")
        except MechanicsError:
            continue
    return errors


def _normal_errors(
    ready: Mapping[str, list[ContactModel]], reference: ContactModel, scene: Scene
) -> dict[str, float]:
    """Return the largest relative error of the normal force over offsets and indentations."""
    offset_m: Float64Array = np.linspace(0.0, 1.1 * reference.reach_m, 23)[:, None]
    depth_m = scene.path.indentation_m * np.array(_NORMAL_AT)
    true_n = reference.force(offset_m, depth_m)[0]
    errors = {}
    for name, models in ready.items():
        try:
            off = np.abs(models[0].force(offset_m, depth_m)[0] / true_n - 1.0).max()
        except MechanicsError:
            continue
        errors[name] = float(f"{off:.{_DIGITS}g}")
    return errors


def _same(kept: Any, drawn: Any) -> bool:
    """Tell whether what was kept of a scene is what is drawn here, but for the last digit.

    Another machine's mathematical functions may round that otherwise.
    """
    if isinstance(kept, dict) and isinstance(drawn, dict):
        return kept.keys() == drawn.keys() and all(_same(kept[key], value) for key, value in drawn.items())
    if isinstance(kept, list) and isinstance(drawn, list):
        return len(kept) == len(drawn) and all(map(_same, kept, drawn))
    if isinstance(kept, float) and isinstance(drawn, float):
        return math.isclose(kept, drawn, rel_tol=1e-12)
    return bool(kept == drawn)
