"""The report of a session as one page that needs no other file, for reading and for printing."""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palp_core.palpation.reporting.html_page import Picture, percent, write_page
from palp_core.palpation.session.methods.record import paragraphs
from palp_core.palpation.session.policy_changes import NodeChange
from palp_core.palpation.session.published import FIXED, HUMAN_STRATEGY_TEXT
from palp_core.palpation.session.recorded_session import RecordedTrial, mm
from palp_core.palpation.session.result import Based, PhantomModel, SessionResult, WorldResult
from palp_core.palpation.session.sheet.of_run import sheet_lines
from palp_core.palpation.session.sheet.sheet import SessionSheet

SIMULATED = "sim"
"""The device of a node that has none, but is one in simulation."""


def headline(result: SessionResult) -> str:
    """Return the session in a sentence, or two where it is unfinished."""
    if result.unfinished is not None:
        words = result.unfinished_words().capitalize()
        return f"{words}, because: {result.unfinished.why}. {_in_a_sentence(result)}"
    return _in_a_sentence(result)


def _in_a_sentence(result: SessionResult) -> str:
    overall = result.accuracy.overall
    if overall.value is None or overall.ci is None:
        none = f"{result.palpations} palpations were recorded and no trial of estimation came to an end"
        return f"{none}{_why_dropped(result)}."
    low, high = (100.0 * bound for bound in overall.ci)
    return (
        f"The policy “{result.policy_label()}” found the right depth in {overall.right} of {overall.of} "
        f"trials: {100.0 * overall.value:.1f} % (95 % interval {low:.1f} to {high:.1f} %, this session "
        f"only), with {result.probes_mean or 0.0:.1f} palpations a trial; "
        f"chance is {100.0 * (result.chance or 0.0):.1f} %.{_in_world(result)}"
    )


def _why_dropped(result: SessionResult) -> str:
    """Return why trials were dropped, each reason once, and what to do; "" if none was."""
    dropped = result.trials_dropped
    if not dropped:
        return ""
    trials = "1 trial was" if len(dropped) == 1 else f"{len(dropped)} trials were"
    reasons = "; ".join(dict.fromkeys(one.reason for one in dropped))
    return f": {trials} dropped ({reasons}); train it by rings_mm, or let the policy choose what was trained"


def _in_world(result: SessionResult) -> str:
    """Return a sentence where the world was not the paper's own."""
    world = result.world
    return f" Simulated in the world “{world.name}”, not in the paper's own design." if world else ""


def write_report(
    path: Path,
    result: SessionResult,
    pictures: Sequence[Picture],
    *,
    trials: Sequence[RecordedTrial] = (),
    given: Sequence[str] = (),
    sheet: SessionSheet | None = None,
) -> Path:
    """Write the page."""
    mechanics, confusion = result.mechanics, result.confusion
    depths = [f"{depth:g} mm" for depth in confusion.depths_mm]
    accuracy = result.accuracy
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
        marks={name if name == "overall" else f"{name} mm": share for name, share in FIXED.items()},
        pictures=pictures,
        sheet=sheet_lines(sheet) if sheet is not None else [],
        command=command(result, given),
        by_hand=_by_hand(result),
        nearest=_nearest(result),
        changes=[_change_row(one) for one in result.changes or ()],
        rig=_rig(result),
        trials=[_trial_row(trial) for trial in trials],
        methods=paragraphs(result.methods),
        published=FIXED,
        human_strategy=HUMAN_STRATEGY_TEXT,
        confusion={
            "estimated": [f"estimated {depth}" for depth in depths],
            "rows": [[d, *line] for d, line in zip(depths, confusion.actual_by_estimated, strict=True)],
        },
        met=_met(mechanics.per_phantom) if mechanics else [],
        warnings=_warnings(mechanics.per_phantom) if mechanics else [],
        phantoms=_phantoms(mechanics.per_phantom) if mechanics else [],
        scene=_scene(mechanics.scene) if mechanics else [],
        world=_parameters(result.world or None),
    )


def command(result: SessionResult, given: Sequence[str]) -> str:
    """Return the command line that runs the session again, with the arguments that it was given."""
    composed = ["--compose"] if result.composed else []
    return shlex.join(["palp", "launch", result.launch_file, *composed, *given])


def _by_hand(result: SessionResult) -> list[list[str]]:
    """Return the policies that took over by hand: which, from where on, and when."""
    return [[one.policy, str(one.trial), str(one.palpation), f"{one.at_s:,.1f} s"] for one in result.by_hand]


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


def _nearest(result: SessionResult) -> str:
    """Return the argument that plans what comes nearest to the swaps by hand, in words; "" if none does.

    A planned policy goes on with its trial after the first palpation, and one trial has but one of them.
    """
    swaps = result.by_hand
    numbers = [*result.planned_swaps, *(one.trial for one in swaps)]
    if not swaps or result.clock != "sim" or len({*numbers}) < len(numbers):
        return ""
    return ",".join(f"{one.trial}=MODULE:CLASS of {one.policy}" for one in swaps)


def _trial_row(trial: RecordedTrial) -> list[str]:
    last = trial.probes[-1]
    estimate = "–" if last.estimate_m is None else f"{mm(last.estimate_m)} mm"
    rings = ", ".join(mm(probe.ring_m) for probe in trial.probes)
    return [
        *(str(last.trial), last.phantom, f"{mm(trial.depth_m)} mm", str(len(trial.probes)), rings),
        *(estimate, "right" if trial.right else "wrong", percent(trial.confidence), trial.verdict),
    ]


def _phantoms(per_phantom: dict[str, PhantomModel]) -> list[list[str]]:
    """Return the phantoms' models; phantoms of one model and reason share a line."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for code, choice in per_phantom.items():
        bound = "none" if choice.bound is None else percent(choice.bound)
        alike.setdefault((choice.rung, bound, choice.reason), []).append(code)
    return [[", ".join(codes), *line] for line, codes in alike.items()]


def _met(per_phantom: dict[str, PhantomModel]) -> list[tuple[str, str]]:
    """Return code of the phantom and words of each guard."""
    return [(code, words) for code, choice in per_phantom.items() for words in choice.guards or ()]


def _warnings(per_phantom: dict[str, PhantomModel]) -> list[str]:
    """Return for each phantom the guard of its stiffest ring, and how many more its sweeps met."""
    found = []
    for code, choice in per_phantom.items():
        *others, last = choice.guards or [""]
        more = f" (and {len(others)} more, under Mechanics)" if others else ""
        found += [f"phantom {code}, {last}{more}"] if last else []
    return found


def _parameters(world: WorldResult | None) -> list[tuple[str, Any, str, str]]:
    """Return name, value, unit and basis of each parameter of a world."""
    given = world.parameters if world else {}
    return [(name, entry.value, entry.unit, entry.basis) for name, entry in given.items()]


def _scene(scene: dict[str, dict[str, Based]]) -> list[tuple[str, str, Any, str]]:
    """Return the numbers of probe and phantoms; phantoms that share one share a line."""
    alike: dict[tuple[str, Any, str], list[str]] = {}
    for thing, quantities in scene.items():
        for name, entry in quantities.items():
            alike.setdefault((name, entry.value, entry.basis), []).append(thing)
    return [(", ".join(things), name, value, basis) for (name, value, basis), things in alike.items()]
