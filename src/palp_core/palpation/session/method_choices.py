"""Which methods a session is decided with: every task put to the register, with what it may know."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from palp_core.methods import Candidate, Method, Quantities, Task, methods, weigh
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M

PUBLISHED: Mapping[str, float] = {
    "class_count": 3.0,
    "training_count": 25.0,
    "probe_count": 15.0,
    "ring_sd_m": 0.0003 / 3.0**0.5,
    "height_sd_m": 0.0001,
    "noise_n_m": RESOLUTION_N_M,
    "sample_hz": 1000.0,
    "wall_clock": 1.0,
    "process_count": 10.0,
    "array_bytes": 160.0,
}
"""What methods that are not of the mechanics may know of a session, beside its scene, SI: depths told apart,
training palpations a cell, palpations a trial at most, spread of the ring's landing (published, uniform), of
the mounting's height (assumed) and of a torque sample (assumed, a step of the sensor's resolution), and the
sensor's rate (published); and that the rig's graph is ten processes on the wall clock, with blocks of 20
samples."""

_OF_THE_SCENE = ("contact", "motion")  # whose output and tolerance are what the scene asks for


@dataclass(frozen=True)
class TaskChoice:
    """What a task comes to in a session.

    Attributes:
        task: The task.
        output: What must be right.
        tolerance: How right.
        candidates: Every method, cheapest first; one is marked as chosen, if any is good enough or asked for.
    """

    task: Task
    output: str
    tolerance: float
    candidates: tuple[Candidate, ...]

    @property
    def chosen(self) -> Candidate | None:
        """The method that is used; None where none is good enough and none was asked for."""
        return next((one for one in self.candidates if one.mark == "chosen"), None)

    def declared(self) -> list[tuple[Method, Candidate]]:
        """Return every method as declared, with what it offers here."""
        by_name = {one.name: one for one in methods(self.task.name)}
        return [(by_name[one.name], one) for one in self.candidates]


def session_quantities(scene: Scene, given: Mapping[str, float] = PUBLISHED) -> Quantities:
    """Return what methods may know of a session, SI.

    Args:
        scene: Gel, probe, path and rings.
        given: What else is known; see :data:`PUBLISHED`.
    """
    return {**scene.quantities(), "speed_m_s": scene.path.speed_m_s, **given}


def choose_for(
    task: Task, scene: Scene, *, asked: str = "", given: Mapping[str, float] = PUBLISHED
) -> TaskChoice:
    """Return what a task comes to in a session.

    Args:
        task: The task.
        scene: Gel, probe, path and rings; its tolerance says what contact and motion must get right, other
            tasks have their own.
        asked: Name of the method that the launch file gives, if it does.
        given: See :data:`PUBLISHED`.

    Raises:
        MethodError: There is no method of the name asked for.
    """
    output, tolerance, uses = task.output, task.tolerance, 1
    if task.name in _OF_THE_SCENE:
        output, tolerance = scene.tolerance.output, scene.tolerance.relative
    if task.name == "contact":
        output, uses = scene.tolerance.bound_on, len(scene.phantoms)
    if task.name == "motion" and output not in ("peak", "contrast"):
        output = "peak"
    quantities = session_quantities(scene, given)
    candidates = weigh(task.name, output, tolerance, quantities, asked=asked, uses=uses)
    return TaskChoice(task, output, tolerance, candidates)
