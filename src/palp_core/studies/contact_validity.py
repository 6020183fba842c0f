"""The study ``contact-validity``: is the chosen model right enough on random scenes, and at what cost?"""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.errors import MechanicsError, MethodError
from palp_core.mechanics import ContactModel, Scene, choose_rung, run_scene
from palp_core.mechanics.contact.l4 import HarmonicContact
from palp_core.mechanics.scene_choice import rung_model
from palp_core.mechanics.scene_output import decisions, outputs, scene_error
from palp_core.methods import methods
from palp_core.studies.charts import GREY, Chart, tidy
from palp_core.studies.contact_cost import side_by_side_s
from palp_core.studies.contact_page import figure, paragraph, write_page
from palp_core.studies.contact_scenes import random_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Judged", "judge", "reference_models", "run"]

REFERENCE_CELL_M = 0.0005
_SCENES, _QUICK = 200, 10
_SEED = 20


@dataclass(frozen=True, eq=False)
class Judged:
    """A random scene, the rung chosen for it, and how every rung does.

    Attributes:
        scene: The scene.
        rung: The chosen rung; empty if none vouches for the tolerance.
        bound: Its stated error.
        errors: True error per rung that answers.
        bounds: Stated error per rung, where there is one.
        cost_s: Seconds of a run per rung that would have done, nothing to set up.
    """

    scene: Scene
    rung: str
    bound: float | None
    errors: dict[str, float]
    bounds: dict[str, float]
    cost_s: dict[str, float]

    @property
    def wrong(self) -> bool:
        """Whether the chosen rung is less right than was asked for."""
        return bool(self.rung) and not self.errors.get(self.rung, np.inf) <= self.scene.tolerance.relative

    @property
    def broken(self) -> list[str]:
        """Rungs whose stated bound is not kept."""
        return [rung for rung, bound in self.bounds.items() if self.errors.get(rung, 0.0) > bound]

    @property
    def cost_ratio(self) -> float | None:
        """Cost of the chosen rung over that of the cheapest that would have done."""
        if not self.rung or self.rung not in self.cost_s:
            return None
        return self.cost_s[self.rung] / min(self.cost_s.values())


def reference_models(scene: Scene) -> list[ContactModel]:
    """Return the finest rung, L4 at 0.5 mm, for each of a scene's phantoms."""
    return [
        HarmonicContact(phantom, scene.probe.tip_radius_m, REFERENCE_CELL_M) for phantom in scene.phantoms
    ]


def judge(scene: Scene, *, timed: bool = True) -> Judged:
    """Choose a rung for a scene and hold every rung against the finest one.

    Raises:
        MechanicsError: The reference itself has no answer.
    """
    try:
        choice = choose_rung(scene)
        rung, bound = choice.rung, choice.bound
    except MethodError:
        rung, bound = "", None
    reference = reference_models(scene)
    _ = scene_error(reference, reference, scene)
    errors: dict[str, float] = {}
    bounds: dict[str, float] = {}
    for one in methods("contact"):
        if one.name in ("l3", "l5"):  # a cylinder, and another constitutive law: not comparable with L4
            continue
        stated = one.bound(scene.tolerance.output, scene.quantities())
        if stated is not None:
            bounds[one.name] = stated
        try:
            models = [rung_model(one.name, p, scene.probe.tip_radius_m) for p in scene.phantoms]
            errors[one.name] = scene_error(models, reference, scene)
        except (MechanicsError, MethodError):
            continue
    enough = [name for name, error in errors.items() if error <= scene.tolerance.relative] if timed else []
    costs = side_by_side_s({name: functools.partial(run_scene, scene, name) for name in enough})
    return Judged(scene, rung, bound, errors, bounds, costs)


def run(out: Path, *, quick: bool = False) -> Path:
    """Judge random scenes, write the record, the chart and the page, and return the page.

    Args:
        out: Folder for the files; made if missing.
        quick: 10 scenes rather than 200.
    """
    rng = np.random.default_rng(_SEED)
    judged: list[Judged] = []
    skipped = 0
    while len(judged) < (_QUICK if quick else _SCENES):
        try:
            judged.append(judge(random_scene(rng)))
        except MechanicsError:
            skipped += 1  # no equilibrium with a lagging tip: nothing to be right about
    out.mkdir(parents=True, exist_ok=True)
    (out / "reference.json").write_text(
        json.dumps([_record(one) for one in judged], indent=1) + "\n", encoding="utf-8"
    )
    chosen = [one for one in judged if one.rung]
    ratios = [one.cost_ratio for one in chosen if one.cost_ratio is not None]
    counts = {name: sum(one.rung == name for one in chosen) for name in sorted({one.rung for one in chosen})}
    said = [
        f"{len(judged)} random scenes, {len(chosen)} answered "
        f"({', '.join(f'{n} by {name}' for name, n in counts.items())}), "
        f"{len(judged) - len(chosen)} refused because no rung vouches for the tolerance; "
        f"{skipped} more had no equilibrium with a lagging tip and were drawn again.",
        f"Chosen and less right than asked for: {sum(one.wrong for one in chosen)}. "
        f"Stated bounds not kept: {sum(bool(one.broken) for one in judged)}.",
        f"Cost of the choice over the cheapest rung that would have done: at most "
        f"{max(ratios, default=1.0):.2f}, "
        f"median {np.median(ratios or [1.0]):.2f} (a run, set-ups in the cache).",
    ]
    parts = [*(paragraph(text, "lead") for text in said), figure(_chart(judged), out)]
    return write_page(out, "Is the chosen contact model right enough?", parts)


def _record(one: Judged) -> dict[str, Any]:
    scene = one.scene
    bead = scene.phantom.bead
    reference = reference_models(scene)
    if scene.tolerance.output == "decision":
        made = decisions(reference, scene, np.random.default_rng(1))
        truth: list[Any] = ["".join(map(str, row)) for row in made.tolist()]
    else:
        truth = outputs(reference, scene).tolist()
    return {
        "phantom": {
            "modulus_pa": scene.phantom.modulus_pa,
            "poisson": scene.phantom.poisson,
            "height_m": scene.phantom.height_m,
            "bead": {"radius_m": bead.radius_m, "depth_m": bead.depth_m} if bead else "none",
        },
        "probe": {
            "tip_radius_m": scene.probe.tip_radius_m,
            "friction": scene.probe.friction,
            "tip_mass_kg": scene.probe.tip_mass_kg,
        },
        "path": {"indentation_m": scene.path.indentation_m},
        "ring_m": list(scene.ring_m),
        "tolerance": {
            "output": scene.tolerance.output,
            "relative": scene.tolerance.relative,
            "depths_m": list(scene.tolerance.depths_m),
        },
        "rung": one.rung,
        "bound": one.bound,
        "errors": one.errors,
        "bounds": one.bounds,
        "truth": truth,
    }


def _chart(judged: Sequence[Judged]) -> Chart:
    points = [
        (rung, one.scene.tolerance.output, bound, one.errors[rung], int(rung == one.rung))
        for one in judged
        for rung, bound in one.bounds.items()
        if rung in one.errors
    ]

    def draw(to: Figure) -> None:
        axes = to.subplots()
        for rung, marker, colour in (("l2", "o", "#009E73"), ("l4", "s", "#0072B2"), ("l0", "v", "#56B4E9")):
            x = [p[2] for p in points if p[0] == rung]
            y = [max(p[3], 1e-6) for p in points if p[0] == rung]
            axes.scatter(x, y, s=16, marker=marker, color=colour, alpha=0.7, label=rung.upper())
        ends = [1e-3, 1.0]
        axes.plot(ends, ends, color=GREY, lw=0.9)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.legend(fontsize=8)
        tidy(axes, "stated and true error", "stated bound", "true error, against L4 at 0.5 mm")

    return Chart(
        "validity",
        "Stated bounds against true errors",
        "A point per scene and rung that states a bound for the scene's output. Above the line a bound "
        "is not kept.",
        (6.0, 4.4),
        ("rung", "output", "bound", "error", "chosen"),
        points,
        draw,
    )
