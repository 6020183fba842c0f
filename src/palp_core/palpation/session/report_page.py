"""The report of a session as one page that needs no other file, for reading and for printing."""

import json
import shlex
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any

from palp_core.counted import counted
from palp_core.palpation.reporting.html_page import Picture, percent, write_page
from palp_core.palpation.session.methods.record import paragraphs
from palp_core.palpation.session.policy_changes import NodeChange
from palp_core.palpation.session.recorded_session import RecordedTrial, mm
from palp_core.palpation.session.result import SessionResult
from palp_core.palpation.session.sheet.of_run import sheet_lines
from palp_core.palpation.session.sheet.sheet import SessionSheet

SIMULATED = "sim"
"""The device of a node that has none, but is one in simulation."""

PUBLISHED = {"2": 0.80, "4": 0.60, "8": 0.60, "overall": 0.667}
"""Accuracy at a fixed ring position by depth in mm, average over the five positions.

N. Sornkarn and T. Nanayakkara, "Can a soft robotic probe use stiffness control like a human finger to improve
efficacy of haptic perception?", IEEE Transactions on Haptics.
"""

HUMAN_STRATEGY = "slightly above 90 %"


def headline(result: SessionResult) -> str:
    """Return the session in a sentence, or two where it is unfinished."""
    if result.unfinished is not None:
        words = result.unfinished_words().capitalize()
        return f"{words}, because: {result.unfinished.why}. {_in_a_sentence(result)}"
    return _in_a_sentence(result)


def _in_a_sentence(result: SessionResult) -> str:
    overall, dropped = result.accuracy.overall, result.trials_dropped
    if overall.value is None or overall.ci is None:
        why = ""
        if dropped:
            reasons = "; ".join(dict.fromkeys(one.reason for one in dropped))
            were = "was" if len(dropped) == 1 else "were"
            why = f": {counted(len(dropped), 'trial')} {were} dropped ({reasons}); "
            why += "train it by rings_mm, or let the policy choose what was trained"
        return f"{result.palpations} palpations were recorded and no trial of estimation came to an end{why}."
    low, high = (100.0 * bound for bound in overall.ci)
    world = result.world
    simulated = f" Simulated in the world “{world.name}”, not in the paper's own design." if world else ""
    return (
        f"The policy “{result.policy_label()}” found the right depth in {overall.right} of {overall.of} "
        f"trials: {100.0 * overall.value:.1f} % (95 % interval {low:.1f} to {high:.1f} %, this session "
        f"only), with {result.probes_mean or 0.0:.1f} palpations a trial; "
        f"chance is {100.0 * (result.chance or 0.0):.1f} %.{simulated}"
    )


def write_report(
    path: Path,
    result: SessionResult,
    pictures: Sequence[Picture],
    *,
    trials: Sequence[RecordedTrial] = (),
    given: Sequence[str] = (),
    sheet: SessionSheet | None = None,
) -> Path:
    """Write the page; ``given`` are the arguments that the launch was given, ``name:=value``."""
    guards = (result.mechanics.guards if result.mechanics else None) or {}
    confusion, accuracy, world = result.confusion, result.accuracy, result.world
    depths = [f"{depth:g} mm" for depth in confusion.depths_mm]
    bars = [(f"{depth} mm", share) for depth, share in accuracy.per_depth_mm.items() if share.of]
    return write_page(
        path,
        "session.html",
        result=result,
        label=result.policy_label(),
        unfinished=result.unfinished_words(),
        headline=headline(result),
        folder=path.parent.resolve(),
        bars=[*bars, ("overall", accuracy.overall)] if accuracy.overall.of else [],
        marks={name if name == "overall" else f"{name} mm": share for name, share in PUBLISHED.items()},
        pictures=pictures,
        sheet=sheet_lines(sheet) if sheet is not None else [],
        command=_command(result, given),
        policies=[
            [one.policy, str(one.trial), str(one.palpation), f"{one.at_s:,.1f} s"]
            for one in result.policies or ()
        ],
        changes=[_change_row(one) for one in result.changes or ()],
        rig=_rig(result),
        trials=[_trial_row(trial) for trial in trials],
        methods=paragraphs(result.methods),
        published=PUBLISHED,
        human_strategy=HUMAN_STRATEGY,
        confusion={
            "estimated": [f"estimated {depth}" for depth in depths],
            "rows": [[d, *line] for d, line in zip(depths, confusion.actual_by_estimated, strict=True)],
        },
        met=[(code, words) for code, met in guards.items() for words in met],
        warnings=[
            f"phantom {code}, {met[-1]}"  # of its stiffest ring
            + (f" (and {len(met) - 1} more, under Mechanics)" if met[1:] else "")
            for code, met in guards.items()
            if met
        ],
        scene=_by_line(
            (thing, (name, entry.value, entry.basis))
            for thing, quantities in (result.mechanics.scene if result.mechanics else {}).items()
            for name, entry in quantities.items()
        ),
        world=[(name, one.value, one.unit, one.basis) for name, one in world.parameters.items()]
        if world
        else [],
    )


def _by_line(things: Iterable[tuple[str, tuple[Hashable, ...]]]) -> list[list[Any]]:
    """Return lines of a table, each with the things that share it first."""
    alike: dict[tuple[Hashable, ...], list[str]] = {}
    for thing, line in things:
        alike.setdefault(line, []).append(thing)
    return [[", ".join(names), *line] for line, names in alike.items()]


def _command(result: SessionResult, given: Sequence[str]) -> str:
    """Return the command line that runs the session again, with the arguments that it was given."""
    composed = ["--compose"] if result.composed else []
    return shlex.join(["palp", "launch", result.launch_file, *composed, *given])


def _change_row(change: NodeChange) -> list[str]:
    """Return when a node was changed, before which palpation, which node, and what of it."""
    number = change.palpation
    before = "after the last" if number is None else f"{number}, of {change.phase}"
    words = [f"{name} = {json.dumps(value)}" for name, value in change.params.items()]
    if change.run:
        words.insert(0, f"{change.before} → {change.run}")
    return [f"{change.at_s:,.1f} s", before, f"/{change.node}", "; ".join(words)]


def _rig(result: SessionResult) -> str:
    """Return what was swept, by devices or in simulation, and whether the stage had a link for stopping."""
    links = (node.get("stop_link") for node in result.protocol.values())
    linkless = any(link is not None and link.value == "none" for link in links)
    link = ", without a link of the safety node's own to the stage (stop_link: none)" if linkless else ""
    if result.mechanics is None:
        return f"rig with devices{link}"
    device = result.protocol_of("stage").get("device")
    simulated = device is None or device.value == SIMULATED
    return "simulated rig" if simulated else f"emulated devices, simulated phantoms{link}"


def _trial_row(trial: RecordedTrial) -> list[str]:
    last = trial.probes[-1]
    estimate = "–" if last.estimate_m is None else f"{mm(last.estimate_m)} mm"
    rings = ", ".join(mm(probe.ring_m) for probe in trial.probes)
    return [
        *(str(last.trial), last.phantom, f"{mm(trial.depth_m)} mm", str(len(trial.probes)), rings),
        *(estimate, "right" if trial.right else "wrong", percent(trial.confidence), trial.verdict),
    ]
