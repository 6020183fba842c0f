"""What ``palp methods measure`` measures of task ``contact``: error and CPU in a scene."""

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palp_core.errors import MechanicsError, MethodError
from palp_core.methods import find, names
from palp_core.methods.measured import REFERENCE, Measured, cpu_s
from palp_core.palpation.mechanics import ContactModel, Phantom, Probe, Scene, sweep
from palp_core.palpation.mechanics.scene.guard import states_finite_strain
from palp_core.palpation.mechanics.scene.output import answer, answer_error
from palp_core.units import Float64Array

SWEEP_POSITIONS = 3000
_NORMAL_AT = (0.2, 0.5, 1.0)  # of the nominal indentation, at offsets out to the bead's reach
_OFFSETS_M = np.linspace(0.0, 0.012, 7)
_OTHER_LAW = "finite strain, another law than the reference's"


@dataclass(frozen=True)
class RungVariant:
    """A rung at a resolution."""

    rung: str  # its name in the register
    resolution: str = ""  # in words; empty where there is nothing to set
    arguments: tuple[tuple[str, Any], ...] = ()  # what its constructor takes beyond phantom and ball
    usual: bool = True  # whether this is what is chosen when the rung is

    @property
    def label(self) -> str:
        """Rung and resolution."""
        return f"{self.rung.upper()} {self.resolution}".strip()

    def model(self, phantom: Phantom, probe: Probe) -> ContactModel:
        """Return the contact model, set up by its first force."""
        target, arguments = find("contact", self.rung).target, dict(self.arguments)
        made: ContactModel = target(phantom, probe.tip_radius_m, **arguments)
        return made


@dataclass(frozen=True, eq=False)
class RungAnswer:
    """What one variant takes and gives in a scene."""

    variant: RungVariant  # rung and resolution
    setup_s: float  # CPU until the first force over every phantom of the scene, nothing cached
    sweep_s: float  # CPU of a sweep of 3000 positions at the last ring; NaN where it has no equilibrium
    outputs: dict[str, Float64Array]  # answers by output, of those that it gives; normal are forces in N
    words: str = ""  # why it gives none or not all, in words


def variants() -> list[RungVariant]:
    """Return the rungs and resolutions to measure, the quick ones first; L4's are references in turn."""

    def size(rung: str, name: str, length_m: float, usual_m: float) -> RungVariant:
        return RungVariant(rung, f"{length_m * 1e3:g} mm", ((name, length_m),), usual=length_m == usual_m)

    sizes = [
        size("l4", "cell_m", 0.002, 0.001),
        size("l4", "cell_m", 0.001, 0.001),
        size("l5", "facet_m", 0.00075, 0.000375),
        size("l4", "cell_m", 0.0005, 0.001),
        size("l5", "facet_m", 0.000375, 0.000375),
    ]
    declared, sized = names("contact"), {one.rung for one in sizes}
    whole = [RungVariant(name) for name in declared if name not in sized]
    return whole + [one for one in sizes if one.rung in declared]


def measure_contact(
    scene: Scene, offered: Sequence[RungVariant] | None = None, references: Sequence[str] = ("l4",)
) -> Iterator[Measured]:
    """Measure the rungs, cheap first, each against the finest reference so far, then all by a finer one."""
    solved: list[RungAnswer] = []
    truth: RungAnswer | None = None
    asked = variants() if offered is None else offered
    solve_variant(asked[0], scene)  # what is imported on first use is no rung's cost
    for variant in asked:
        here = solve_variant(variant, scene)
        solved.append(here)
        finer = variant.rung in references and not here.words
        truth = here if finer else truth
        if truth is not None:
            for one in solved if finer else [here]:
                yield from _points(one, truth, scene)
    if truth is None:
        words = "; ".join(f"{one.variant.label}: {one.words}" for one in solved if one.words)
        raise MechanicsError(f"no contact rung to hold others against in this scene: {words}")


def solve_variant(variant: RungVariant, scene: Scene) -> RungAnswer:
    """Set a variant up with nothing cached, sweep it, and ask it for all that a scene may be asked for."""
    with cold_cache():
        begun_s = time.thread_time()
        try:
            models = [variant.model(phantom, scene.probe) for phantom in scene.phantoms]
            for model in models:
                model.force(np.zeros(1), np.full(1, 1e-4))
        except (MechanicsError, MethodError) as error:
            return RungAnswer(variant, time.thread_time() - begun_s, np.nan, {}, str(error))
        setup_s = time.thread_time() - begun_s
        depths_m = scene.path.indentation_m * np.array(_NORMAL_AT)
        depths_m = depths_m[depths_m <= models[0].indentation_max_m]  # what it reaches
        outputs = {"normal": models[0].force(_OFFSETS_M[:, None], depths_m)[0]} if depths_m.size else {}
        stage_m = np.linspace(scene.path.from_m, scene.path.to_m, SWEEP_POSITIONS)
        ring_m, pressed_m = scene.ring_m[-1], scene.path.indentation_m
        try:
            for output in _outputs(scene):
                outputs[output] = answer(models, asked_for(scene, output))
            sweep_s = cpu_s(lambda: sweep(models[0], scene.probe, ring_m, pressed_m, stage_m), rounds=2)
        except MechanicsError as error:
            return RungAnswer(variant, setup_s, np.nan, outputs, str(error))
    return RungAnswer(variant, setup_s, sweep_s, outputs)


def _outputs(scene: Scene) -> list[str]:
    """Return what a scene is asked for, its own output first."""
    plain = ("peak", "contrast") if scene.phantom.bead is not None else ("peak",)
    return list(dict.fromkeys((scene.tolerance.output, *plain)))


def _points(one: RungAnswer, truth: RungAnswer, scene: Scene) -> Iterator[Measured]:
    variant = one.variant
    law = _OTHER_LAW if states_finite_strain(find("contact", variant.rung)) else ""
    cost_s = one.setup_s + (0.0 if np.isnan(one.sweep_s) else one.sweep_s)
    for output in (*_outputs(scene), "normal"):
        if output not in truth.outputs:
            continue
        given = one.outputs.get(output)
        yield Measured(
            "contact",
            variant.rung,
            variant.resolution,
            cost_s,
            _error(given, truth.outputs[output], output, scene),
            output,
            truth.variant.label,
            usual=variant.usual,
            condition=REFERENCE if one is truth else law,
            fails="" if given is not None else one.words,
        )


def _error(given: Float64Array | None, true: Float64Array, output: str, scene: Scene) -> float:
    """Return the largest relative error; NaN where there is no answer."""
    if given is None:
        return float("nan")
    if output == "normal":
        return float(np.max(np.abs(given / true[:, : given.shape[1]] - 1.0)))
    return answer_error(given, true, asked_for(scene, output))


def asked_for(scene: Scene, output: str) -> Scene:
    """Return the scene with another output asked for; ``normal`` leaves it as it is, but for one phantom."""
    if output == scene.tolerance.output:
        return scene
    plain = "peak" if output == "normal" else output
    return replace(scene, tolerance=replace(scene.tolerance, output=plain, depths_m=()))


@contextlib.contextmanager
def cold_cache() -> Iterator[None]:
    """Let set-ups find nothing on disk, and leave nothing behind."""
    before = os.environ.get("PALP_CACHE")
    with tempfile.TemporaryDirectory(prefix="palp-cold-") as folder:
        os.environ["PALP_CACHE"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["PALP_CACHE"]
            else:
                os.environ["PALP_CACHE"] = before
