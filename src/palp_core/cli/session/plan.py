"""``palp session plan``: a session with a person, run dry."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Literal

from palp_core.cli.options import JsonOption, option
from palp_core.cli.output import print_json, print_table, print_text
from palp_core.counted import counted


def plan(
    *,
    order: Annotated[
        Literal["paper", "counterbalanced"], option("Tables 3 and 4, or balanced over subjects.")
    ] = "paper",
    subject_number: Annotated[int, option("Of the subject in the study.", min=1)] = 1,
    seed: Annotated[int, option("Of the study.", min=0)] = 1,
    repeats: Annotated[int, option("Trials per phantom and phase.", min=1)] = 5,
    limit_s: Annotated[float, option("Longest time of a trial.")] = 60.0,
    rest_s: Annotated[float, option("Rest between trials.", min=0.0)] = 20.0,
    phantoms: Annotated[str, option("YAML file of phantoms; empty: the paper's three.")] = "",
    as_json: JsonOption = False,
) -> None:
    """No rig is needed."""
    from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
    from palp_core.palpation.session.human.plan import PHASES, HumanDesign, outline
    from palp_core.palpation.session.plan import PlannedPhantom

    depths_m = {code: one.bead.depth_m for code, one in load_phantoms(phantoms).items() if one.bead}
    found = outline(
        HumanDesign(
            phantoms=tuple(PlannedPhantom(code, depth_m) for code, depth_m in depths_m.items()),
            order=order,
            subject_number=subject_number,
            seed=seed,
            repeats=repeats,
            limit_s=limit_s,
            rest_s=rest_s,
        )
    )
    if as_json:
        print_json(found)
        return
    for phase in PHASES:
        trials = [trial for trial in found.trials if trial.phase == phase]
        counts = Counter(trial.phantom for trial in trials)
        given = ", ".join(f"{code} {counted(count, 'time')}" for code, count in sorted(counts.items()))
        print_text(f"{phase}: {counted(len(trials), 'trial')}, {given}")
        print_table(
            [
                ["trial", *(str(trial.number) for trial in trials)],
                ["phantom", *(trial.phantom for trial in trials)],
                ["depth, mm", *(f"{depths_m[trial.phantom] * 1e3:g}" for trial in trials)],
            ]
        )
    print_text(
        f"{found.questions} questions, {found.mounts} changes of the phantom; "
        f"{found.shortest_s / 60:.0f} min without any palpation, {found.longest_s / 60:.0f} min at most"
    )
