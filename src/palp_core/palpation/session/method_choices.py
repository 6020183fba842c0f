"""Which methods a session is decided with: every task put to the register, with what it may know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Literal

import msgspec

from palp_core.methods import (
    Candidate,
    Method,
    MethodChoice,
    Quantities,
    Task,
    choose,
    methods,
    names,
    tasks,
    weigh,
)
from palp_core.methods import task as task_of
from palp_core.methods.choice import CHOSEN, DEFAULT
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import Scene, motion_output
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.trial_filter import NAIVE

PUBLISHED: Mapping[str, float] = {
    "class_count": 3.0,  # published: depths
    "class_ratio": 2.0,  # published: a depth over the next shallower one
    "training_count": 25.0,  # published: palpations a cell
    "stiffest_m": 0.016,  # published: the largest ring position
    "sample_hz": 1000.0,  # published
    "ring_sd_m": 0.0003 / 3.0**0.5,  # published: +-0.3 mm of a landing, read as uniform
    "class_gap_sd": 5.3,  # simulated: the least distance of depths at that ring over a reading's spread
    "probe_count": 15.0,  # assumed: palpations a trial at most
    "height_sd_m": 0.0001,  # assumed: of a mounting
    "noise_n_m": RESOLUTION_N_M,  # assumed: of a torque sample, a step of the sensor's resolution
    "outlier_share": 0.0,  # assumed: of readings
    "trace_height_sd_m": 0.0002,  # assumed, as all below: what a filter of whole traces allows for
    "friction_sd": 0.1,
    "modulus_sd": 0.1,
    "place_sd_m": 0.001,
    "tip_sd_m": 0.0001,
    "slope_error": 0.2,
    "texture_sd_n_m": 0.0002,
    "bin_m": 0.002,
}
"""What methods that are not of the mechanics may know of a session, in addition to its scene, SI."""

AUTO = "auto"
"""In place of a method's name: let the register choose."""

_OF_THE_SCENE = ("contact", "motion")  # whose output and tolerance are what the scene asks for


@dataclass(frozen=True)
class TaskChoice:
    task: Task
    output: str
    tolerance: float
    # every method, cheapest first; one is marked as chosen, if any is accurate enough or asked for, and the
    # launch file's default as :data:`.DEFAULT` where it is another
    candidates: tuple[Candidate, ...]
    default: str = AUTO  # what ``launch/sim.yaml`` takes, :data:`AUTO` where that is the choice

    @property
    def chosen(self) -> Candidate | None:
        """The method that is used; None where none is accurate enough and none was asked for."""
        return next((one for one in self.candidates if one.mark == CHOSEN), None)

    @property
    def points(self) -> float | None:
        """Error of the default less that of the chosen method, in percentage points; None if not stated."""
        of = {one.mark: one.bound for one in self.candidates}
        default, chosen = of.get(DEFAULT), of.get(CHOSEN)
        return None if default is None or chosen is None else 100.0 * (default - chosen)

    def declared(self) -> list[tuple[Method, Candidate]]:
        by_name = {one.name: one for one in methods(self.task.name)}
        return [(by_name[one.name], one) for one in self.candidates]


def session_quantities(scene: Scene, given: Mapping[str, float] = PUBLISHED) -> Quantities:
    """Return what methods may know of a session, SI."""
    return {**scene.quantities(), "speed_m_s": scene.path.speed_m_s, **given}


def choose_for(
    task: Task, scene: Scene, *, asked: str = "", given: Mapping[str, float] = PUBLISHED, default: str = AUTO
) -> TaskChoice:
    output, tolerance, uses = _needed(task, scene)
    quantities = session_quantities(scene, given)
    candidates = weigh(task.name, output, tolerance, quantities, asked=asked, uses=uses)
    marked = (
        replace(one, mark=DEFAULT) if one.name == default and one.mark != CHOSEN else one
        for one in candidates
    )
    return TaskChoice(task, output, tolerance, tuple(marked), default)


def launch_defaults() -> dict[str, str]:
    """Return what ``launch/sim.yaml`` takes for each task that it names a method of, or ``auto``."""
    from palp_core.graph.description.resolver import resolve
    from palp_core.graph.workspaces.underlays import launch_path

    found = resolve(launch_path("rig:sim.yaml"))
    known = {name: one.value for name, one in found.shared.items()} | found.values
    return {one.name: str(known[one.name]) for one in tasks() if one.name in known}


def chosen_method(
    task: str, scene: Scene, *, asked: str = AUTO, given: Mapping[str, float] = PUBLISHED
) -> MethodChoice:
    """Return the method that a session gets for a task: the one asked for, or the register's choice."""
    output, tolerance, uses = _needed(task_of(task), scene)
    name = "" if asked == AUTO else asked
    return choose(task, output, tolerance, session_quantities(scene, given), asked=name, uses=uses)


def _needed(task: Task, scene: Scene) -> tuple[str, float, int]:
    """Return what must be right, how right, and how often a method is used."""
    output, tolerance, uses = task.output, task.tolerance, 1
    if task.name in _OF_THE_SCENE:
        output, tolerance = scene.tolerance.output, scene.tolerance.relative
    if task.name == "contact":
        output, uses = scene.tolerance.bound_on, len(scene.phantoms)
    if task.name == "motion":
        output = motion_output(scene.tolerance.output)
    return output, tolerance, uses


# what a node's parameters name, or leave to the register

TRACE = "trace"
"""The reading that is the whole torque of a sweep."""

Reading = Literal["feature", "trace"]


def what_is_read(reading: str, feature: str) -> str:
    """Return what a run reads off a sweep, which its contact models must get right: see ``Scene.read_by``.

    A feature left to the register may be any: it follows from the trace.
    """
    return TRACE if reading == TRACE or feature == AUTO else feature


def _choices(task: str) -> list[str]:
    return [*names(task), AUTO]


def _of(task: str) -> Any:
    return msgspec.Meta(extra={"choices": partial(_choices, task)})


DenoiseName = Annotated[str, _of("denoise")]
FeatureName = Annotated[str, _of("feature")]
LikelihoodName = Annotated[str, _of("likelihood")]
FilterName = Annotated[str, _of("filter")]
TraceFilterName = Annotated[str, _of("trace_filter")]
StopName = Annotated[str, _of("stop")]
"""A stop rule by its name in the register, or ``auto``; a lab's own as ``package.module:name``."""


_OF_TRACES = {
    **{f"{name}_m": (f"{name}_mm", 1e-3) for name in ("trace_height_sd", "place_sd", "tip_sd", "bin")},
    **{name: (name, 1.0) for name in ("friction_sd", "modulus_sd", "slope_error")},
    "texture_sd_n_m": ("texture_sd_n_mm", 1e-3),
}
"""Parameters of a node that reads whole traces, and their units in SI, by quantity."""


def of_traces(params: Any) -> dict[str, float]:
    """Return what a filter of whole traces is given, as far as parameters have it, SI."""
    known = ((quantity, name, unit) for quantity, (name, unit) in _OF_TRACES.items() if hasattr(params, name))
    return {quantity: float(getattr(params, name)) * unit for quantity, name, unit in known}


def given_by(params: Any) -> Mapping[str, float]:
    """Return what a node's parameters say of the session; what they do not say is as published."""
    from palp_core.palpation.perception.belief.rig_noise import noise_of

    noise = noise_of(params.noise, params.ring_sd_mm * 1e-3, params.height_sd_mm * 1e-3)
    return {
        **PUBLISHED,
        **of_traces(params),
        "ring_sd_m": noise.ring_sd_m.value,
        "height_sd_m": noise.height_sd_m.value,
        "noise_n_m": noise.sample_sd_n_m.value or PUBLISHED["noise_n_m"],
        "training_count": float(params.training),
        "class_count": float(getattr(params, "depths", 0) or PUBLISHED["class_count"]),
        "probe_count": float(getattr(params, "max_probes", PUBLISHED["probe_count"])),
        "sample_hz": float(getattr(params, "rate_hz", PUBLISHED["sample_hz"])),
    }


def chosen_for(asked: Mapping[str, str], params: Any) -> dict[str, MethodChoice]:
    """Return the method of each task: the one asked for by name, or for ``auto`` the register's choice."""
    scene = read_scene(params.scene) if params.scene else Scene()
    given, found = given_by(params), dict[str, MethodChoice]()
    for task in sorted(asked):  # the filter before the likelihood
        name = asked[task]
        if task == "likelihood" and name == AUTO and "filter" in found and found["filter"].name != NAIVE:
            name = "normal"
        found[task] = chosen_method(task, scene, asked=name, given=given)
    return found


def names_of(asked: Mapping[str, str], params: Any) -> tuple[dict[str, str], list[str]]:
    """Return the name of each task's method, and of those left to the register a line that says why."""
    found = chosen_for(asked, params)
    why = [f"{task}: {found[task].reason}" for task, name in asked.items() if name == AUTO]
    return {task: one.name for task, one in found.items()}, why
