"""``palp scene``: which model answers a scene and why, what comes out, and the contact forces of any rung."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import note, show, table_lines

if TYPE_CHECKING:
    from palp_core.palpation.mechanics.scene.scene import Scene

app = typer.Typer()


FileArgument = Annotated[Path, argument("Scene file (YAML).")]
RungOption = Annotated[str | None, option("Model to use, of `palp methods list contact`.")]


@app.command("explain")
def explain(file: FileArgument, *, as_json: JsonOption = False) -> None:
    """Show which contact model a scene needs and why.

    With bound, evidence and cost; no contact is computed.
    """
    from palp_core.palpation.mechanics.scene.choice import choose_rung
    from palp_core.palpation.mechanics.scene.file import read_scene

    scene = read_scene(file)
    choice = choose_rung(scene)
    heads = ("rung", "stated error", "set-up and a sweep", "verdict")
    candidates = [(c.name, _percent(c.bound), f"{c.cost_s:g} s", c.state) for c in choice.contact.candidates]
    show(
        {
            "rung": choice.rung,
            "bound": choice.bound,
            "output": scene.tolerance.output,
            "strain": scene.tolerance.strain,
            "tolerance": scene.tolerance.relative,
            "reason": choice.contact.reason,
            "evidence": choice.contact.method.evidence,
            "cost_s": choice.contact.method.cost_s,
            "motion": choice.motion.name,
            "motion_reason": choice.motion.reason,
            "candidates": [vars(candidate) for candidate in choice.contact.candidates],
        },
        [
            f"rung {choice.rung}: {_asked(scene)} {_within(choice.bound)}",
            f"why: {choice.contact.reason}",
            f"evidence: {choice.contact.method.evidence}",
            f"cost: about {choice.contact.method.cost_s:g} s for set-up and a sweep with nothing cached",
            f"motion: {choice.motion.reason}",
            "",
            *table_lines([heads, *candidates]),
        ],
        as_json=as_json,
    )


@app.command("run")
def run(file: FileArgument, *, rung: RungOption = None, as_json: JsonOption = False) -> None:
    """Sweep a scene at each ring position.

    Prints torque, angle and normal force.
    """
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.run import run_scene

    scene = read_scene(file)
    done = run_scene(scene, rung)
    for text in done.guards:
        note(text)
    rows: list[Sequence[str]] = [
        ("r_a, mm", "peak, N mm", "contrast, N mm", "peak at, mm", "largest angle, deg", "largest force, N")
    ]
    for ring_m, peak, contrast, sweep in zip(
        done.ring_m, done.peak_n_m, done.contrast_n_m, done.sweeps, strict=True
    ):
        at_m = sweep.stage_m[int(abs(sweep.torque_n_m).argmax())]
        angle_deg = math.degrees(float(abs(sweep.angle_rad).max()))
        cells = (peak * 1e3, contrast * 1e3, at_m * 1e3, angle_deg, float(sweep.normal_n.max()))
        rows.append((f"{ring_m * 1e3:g}", *(f"{cell:.4g}" for cell in cells)))
    lines = [
        f"rung {done.choice.rung}: {_asked(scene)} {_within(done.choice.bound)}",
        f"why: {done.choice.contact.reason}",
        f"motion: {done.choice.motion.reason}",
        "",
    ]
    show(done.as_json(), [*lines, *table_lines(rows)], as_json=as_json)


@app.command("fit")
def fit(
    outs: Annotated[list[Path], argument("Sessions' folders or bags.", "OUT...")],
    *,
    scene: Annotated[Path | None, option("Scene file: what is not fitted, and where to start.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a gel's modulus and friction to recorded sweeps.

    Sweeps of training and of plan:=repeatability count, since their phantoms are known.
    """
    from palp_core.palpation.identification.gel_fit import fit_gel
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.mechanics.scene.scene import Scene
    from palp_core.palpation.session.recorded_sweeps import read_sessions

    found = fit_gel(read_sessions(outs), read_scene(scene) if scene else Scene())
    modulus, friction = found.modulus_pa, found.friction
    show(
        {"modulus_pa": vars(modulus), "friction": vars(friction), "misfit": found.misfit},
        [
            f"modulus: {modulus.value:.4g} Pa (95 %: {modulus.low:.4g} to {modulus.high:.4g})",
            f"friction: {friction.value:.3f} (95 %: {friction.low:.3f} to {friction.high:.3f})",
            f"misfit: chi^2 is {found.misfit:.2g} times its degrees of freedom",
        ],
        as_json=as_json,
    )


def _percent(share: float | None) -> str:
    return "no stated bound" if share is None else f"{100.0 * share:.2g} %"


def _within(share: float | None) -> str:
    return "without a stated bound" if share is None else f"within {_percent(share)}"


def _asked(scene: Scene) -> str:
    asked = scene.tolerance
    return asked.output if asked.strain == "small" else f"{asked.output} against {asked.strain} strain"
