"""The result of a session as numbers: ``result.json``.

Two runs of one launch file and seed give the same file but for :data:`TIME_KEYS`.
"""

from __future__ import annotations

import itertools
import json
import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

import palp_core
from palp_core.errors import MechanicsError, PalpError
from palp_core.graph.launch.changes_told import last_set
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.statistics import statistics
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED, rings_of
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.methods.record import methods_of, unsaid
from palp_core.palpation.session.methods.text import reason
from palp_core.palpation.session.methods.used import rig_of, rig_uses
from palp_core.palpation.session.parameter_basis import SCENE, basis_of
from palp_core.palpation.session.plan import planned, policy_name
from palp_core.palpation.session.plan_repeatability import RepeatDesign, sweep_count
from palp_core.palpation.session.recorded_session import RecordedSession, RecordedTrial, mm
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.sheet import SessionSheet
from palp_core.palpation.session.who_chose import changes_of, swapped_by_hand
from palp_core.palpation.world.model import basis as world_basis
from palp_core.palpation.world.model import units as world_units
from palp_core.whole_file import read_whole, write_json

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

TIME_KEYS = (
    "began",
    "composed",
    "launch_file",
    "out",
    "palpations_per_wall_s",
    "sweep_s_per_wall_s",
    "wall_time_s",
)
"""Top-level keys that depend on wall time, or on where and how the graph was run."""

_WHERE = {
    ("experiment", "out"),
    ("experiment", "overwrite"),
    ("experiment", "session"),
    ("experiment", "key"),
    ("phantom", "key"),
}

INTERVAL = "95 % Wilson, this session only"
_PACKAGES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "pywt": "PyWavelets",
    "msgspec": "msgspec",
    "pyzmq": "pyzmq",
}


def build(session: RecordedSession, summary: RunSummary) -> dict[str, Any]:
    """Return the result of a session and its run, in the order in which a person reads it."""
    roles, sheet = roles_of(summary), sheet_of(summary)
    experiment = {**roles.params("experiment"), **summary.args}
    sweep_s = sum(row.end_ns - row.start_ns for row in session.rows) / 1e9
    trials = session.trials
    by_hand = swapped_by_hand(session.rows, experiment.get("swaps") or "")
    return {
        **_policy(experiment.get("policy", "")),
        **({"swapped_by_hand": by_hand} if by_hand else {}),
        **({"changes": changes_of(summary.changes, session.rows)} if summary.changes else {}),
        "seed": summary.seed,
        "trials": experiment.get("trials"),
        "training": experiment.get("training"),
        "trials_done": len(trials),
        "trials_unfinished": session.unfinished_count,
        "unfinished": how_far(session, summary, roles),
        "trials_dropped": [_dropped(trial) for trial in session.dropped],
        **(
            {"left_out": {f"{phase} {trial}": why for (phase, trial), why in session.left_out.items()}}
            if session.left_out
            else {}
        ),
        "mounts": {phase: _mounts(session, phase) for phase in ("training", "estimation")},
        "accuracy": {
            "overall": _accuracy(trials),
            "per_depth_mm": {mm(d): _accuracy(session.at_depth(d)) for d in session.tried_m},
            "interval": INTERVAL,
        },
        "chance": 1.0 / len(session.depths_m) if session.depths_m else None,
        "reading": roles.params("estimator").get("reading", "feature"),
        "rig_s_per_decision": _rig_s(session),
        "probes_mean": _probes(trials),
        "probes_mean_per_depth_mm": {mm(d): _probes(session.at_depth(d)) for d in session.tried_m},
        "verdicts": {word: _verdicts(trials)[word] for word in ("decided", "undecided")},
        "calibration": _calibration(trials),
        "confusion": _confusion(session),
        "grid_depths": session.grid_count,
        "rmse_mm": _rmse_mm(trials),
        "stop_rule": _stop_rule(roles.params("estimator")),
        "mechanics": _mechanics(summary, roles, session) if roles.touch_simulated else None,
        **_world(summary),
        "methods": methods_of(summary, session.rows),
        "methods_unsaid": unsaid(summary, session.rows),
        "roles": dict(roles.node),
        "protocol": _protocol(summary, roles, by_hand=bool(by_hand)),
        "clock": summary.clock,
        "sim_time_s": summary.clock_s,
        "palpations": len(session.rows),
        "incidents": msgspec.to_builtins(summary.incidents),
        "sweep_s": sweep_s,
        "activations": summary.activation_count,
        "wall_time_s": summary.wall_s or None,
        "sweep_s_per_wall_s": sweep_s / summary.wall_s if summary.wall_s > 0.0 else None,
        "palpations_per_wall_s": len(session.rows) / summary.wall_s if summary.wall_s > 0.0 else None,
        "composed": summary.composed,
        "session": _session(sheet),
        "began": sheet.began if sheet is not None else "",
        "graph": summary.graph,
        "launch_file": summary.file,
        "out": str(session.folder),
        "versions": _versions(),
    }


def _policy(asked: str) -> dict[str, str]:
    """Return what the first policy is called in the record, and its class if that was asked for."""
    return {"policy": policy_name(asked), **({"policy_class": asked} if ":" in asked else {})}


def _session(sheet: SessionSheet | None) -> dict[str, Any] | None:
    """Return what the session's sheet says, but for when it began; None of a run that has none."""
    if sheet is None:
        return None
    found: dict[str, Any] = msgspec.to_builtins(sheet)
    del found["began"]
    return found


def write_result(result: dict[str, Any], folder: Path) -> Path:
    """Write ``result.json``; it appears under its name only when complete. NaN becomes null."""
    target = folder / "result.json"
    write_json(target, result)
    return target


def read_result(out: str | Path) -> dict[str, Any]:
    """Return the result of the session recorded in a folder.

    Raises:
        PalpError: There is none, or it is not JSON.
    """
    path = Path(out) / "result.json"
    try:
        result: dict[str, Any] = msgspec.json.decode(read_whole(path), type=dict[str, Any])
    except FileNotFoundError as error:
        raise PalpError(f"no result in '{out}': {path} is missing; run a session with out:={out}") from error
    except OSError as error:
        raise PalpError(f"{path} cannot be read: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise PalpError(f"{path} is no result: {error}; run the session again") from error
    return result


def unfinished_words(result: dict[str, Any]) -> str:
    """Return ``unfinished: 124 of 300 trials``; empty where the run came to its end."""
    found = result["unfinished"]
    if not found:
        return ""
    of = f" of {found['of']}" if found["of"] else ""
    return f"unfinished: {found['done']}{of} {found['what']}"


def policy_label(result: dict[str, Any]) -> str:
    """Return the policy that chose first and those that took over from it; the last with its ring, if any.

    One that was to take over in a trial that was never begun did not, and one that went before any trial
    chose nothing. Where no trial was begun, the policies that were there are told in their order.
    """
    begun = result["trials_done"] + len(result.get("trials_dropped", ())) + result["trials_unfinished"]
    took_over = [
        (trial, 2, policy_name(run)) for trial, run in planned_swaps(result).items() if 1 <= trial <= begun
    ]
    took_over += [
        (one["trial"], one["palpation"], one["policy"]) for one in result.get("swapped_by_hand", ())
    ]
    first = str(result["policy"] or "unnamed")
    chose = [(1, 1, first), *sorted(took_over, key=lambda one: one[:2])]
    chose = [one for one, later in itertools.pairwise([*chose, (0, 0, "")]) if later[:2] != (1, 1)]
    label = chose[0][2]
    if "policy_class" in result and label == first:
        label += f" ({result['policy_class']})"
    label += "".join(f", from trial {trial} on {policy}" for trial, _, policy in chose[1:])
    there = _policies_there(result)
    if not begun:
        label += "".join(f", then {policy}" for policy in there)
    ring = _of_role(result, "policy").get("ring_mm")
    last_chose = not begun or not there or there[-1] == chose[-1][2]
    return label + (f", {ring['value']:g} mm" if ring and last_chose else "")  # parameters are the last one's


def _policies_there(result: dict[str, Any]) -> list[str]:
    """Return the policies that took over, in time's order, whether they chose anything or not."""
    node = result.get("roles", {}).get("policy", "policy")
    return [
        policy_name(one["run"])
        for one in result.get("changes", ())
        if one["node"] == node and one["run"] != one["before"]
    ]


def planned_swaps(result: dict[str, Any]) -> dict[int, str]:
    """Return the class by the number of the trial in which it was to take over."""
    return planned(_of_role(result, "experiment").get("swaps", {}).get("value", ""))


def _of_role(result: dict[str, Any], role: str) -> dict[str, dict[str, Any]]:
    """Return the protocol of the node of a role; results without roles are of graphs that called it so."""
    node = result.get("roles", {}).get(role, role)
    found: dict[str, dict[str, Any]] = result["protocol"].get(node, {})
    return found


def how_far(session: RecordedSession, summary: RunSummary, roles: Roles) -> dict[str, Any] | None:
    """Return how far a run came that did not come to its end, and why it did not; else None."""
    if summary.exit_code == 0:
        return None
    experiment, phases = roles.params("experiment"), {row.phase for row in session.rows}
    count = _phantom_count(summary, roles)
    training, trials = experiment.get("training", 0), experiment.get("trials", 0)
    ring_count = len(rings_of(experiment.get("rings_mm") or PUBLISHED))
    done, of, what = len(session.rows), training * count * ring_count, "palpations of training"
    if experiment.get("plan") == "repeatability":
        of, what = sweep_count(RepeatDesign("")), "palpations"
    elif "estimation" in phases or done >= of > 0:
        ended = len(session.trials) + len(session.dropped) + session.left_out_count
        done, of, what = ended, trials * count, "trials"
    return {"done": done, "of": of, "what": what, "why": summary.ended}


def _phantom_count(summary: RunSummary, roles: Roles) -> int:
    """Return how many phantoms have a bead to be found; 0 where nobody can tell any more."""
    said = {one.use.of: json.loads(one.use.scene) for one in summary.methods if one.use.task == "contact"}
    if said:
        return sum(scene["phantom"]["bead"] is not None for scene in said.values())
    try:
        phantoms = load_phantoms(roles.params("experiment").get("phantoms", "")).values()
    except MechanicsError:
        return 0
    return sum(phantom.bead is not None for phantom in phantoms)


def _share(proportion: statistics.Proportion) -> dict[str, Any]:
    return {
        "value": proportion.value,
        "ci": [proportion.low, proportion.high],
        "right": proportion.success_count,
        "of": proportion.trial_count,
    }


def _accuracy(trials: Sequence[RecordedTrial]) -> dict[str, Any]:
    if not trials:
        return {"value": None, "ci": None, "right": 0, "of": 0}
    return _share(statistics.wilson(sum(trial.right for trial in trials), len(trials)))


def _mounts(session: RecordedSession, phase: str) -> int:
    """Return how often a phantom was put on the rig; trials of one mounting share its error."""
    return len({row.remount for row in session.rows if row.phase == phase})


def _probes(trials: Sequence[RecordedTrial]) -> float | None:
    return float(np.mean([len(trial.probes) for trial in trials])) if trials else None


def _rig_s(session: RecordedSession) -> dict[str, Any]:
    """Return how long stage and ring took for a decision: from one trial's last torque to the next one's.

    So lifting, going back, moving and re-homing the ring count; putting a phantom on does not: of each
    mounting the first trial is left out.
    """
    ends = [(trial.probes[-1].remount, trial.probes[-1].end_ns) for trial in _in_order(session)]
    took = [(b - a) / 1e9 for (one, a), (other, b) in itertools.pairwise(ends) if one == other]
    return {"mean": float(np.mean(took)) if took else None, "trials": len(took)}


def _in_order(session: RecordedSession) -> list[RecordedTrial]:
    return sorted((*session.trials, *session.dropped), key=lambda trial: trial.probes[-1].row)


def _dropped(trial: RecordedTrial) -> dict[str, Any]:
    last = trial.probes[-1]
    return {"trial": last.trial, "reason": f"ring position {last.ring_m * 1e3:g} mm was not trained"}


def _verdicts(trials: Sequence[RecordedTrial]) -> Counter[str]:
    return Counter(trial.verdict for trial in trials)


def _calibration(trials: Sequence[RecordedTrial]) -> dict[str, Any] | None:
    if not trials:
        return None
    found = statistics.calibration(
        np.array([trial.confidence for trial in trials]), [trial.right for trial in trials]
    )
    return {
        "expected_error": found.expected_error,
        "overconfidence": found.overconfidence,
        "bins": [
            {
                "low": b.low,
                "high": b.high,
                "mean_confidence": b.mean_confidence,
                "accuracy": _share(b.accuracy),
            }
            for b in found.bins
        ],
    }


def _confusion(session: RecordedSession) -> dict[str, Any]:
    """Return counts, a row per actual depth, a column per estimate."""
    estimates = [(trial, trial.probes[-1].estimate_m) for trial in session.trials]
    table = statistics.confusion(
        [session.class_of(trial.depth_m) for trial, estimate_m in estimates if estimate_m is not None],
        [session.class_of(estimate_m) for _, estimate_m in estimates if estimate_m is not None],
        len(session.depths_m),
    )
    return {"depths_mm": [round(d * 1e3, 6) for d in session.depths_m], "actual_by_estimated": table.tolist()}


def _rmse_mm(trials: Sequence[RecordedTrial]) -> float | None:
    """Return the root mean square of the belief's mean depth about the true one, mm."""
    if not trials:
        return None
    return 1e3 * float(np.sqrt(np.mean([(trial.mean_m - trial.depth_m) ** 2 for trial in trials])))


def _stop_rule(estimator: dict[str, Any]) -> dict[str, Any] | None:
    if "stop" not in estimator:
        return None
    settings: dict[str, Any] = {}
    if estimator["stop"] != AUTO:
        rule: Any = stop_rule(estimator["stop"], estimator.get("stop_value", 0.0))
        settings = asdict(rule)
    limit = {"max_probes": estimator["max_probes"]} if "max_probes" in estimator else {}
    return {"name": estimator["stop"], "settings": settings | limit}


def _touched(summary: RunSummary, roles: Roles) -> dict[str, MethodUse]:
    """Return what the phantom said of the rung of each phantom, by code; the latest counts.

    A run that is older than that record is told from the files that it names, as they are now.
    """
    said = {one.use.of: one.use for one in summary.methods if one.use.task == "contact"}
    if said:
        return said
    uses = rig_uses(rig_of(roles.params("phantom")), None)
    return {use.of: use for use in uses if use.task == "contact"}


def _mechanics(summary: RunSummary, roles: Roles, session: RecordedSession) -> dict[str, Any]:
    """Return every phantom's rung, its stated bound, its guards, and the scene.

    Guards are what the run's sweeps met, as the phantom told; None where the experiment did not hear it.
    """
    phantom, uses = roles.params("phantom"), _touched(summary, roles)
    file = phantom.get("scene") or phantom.get("phantoms", "")
    scenes = {code: json.loads(use.scene) for code, use in uses.items()}
    first = next(iter(uses))
    return {
        "rung": ", ".join(sorted({use.name for use in uses.values()})),
        "bound": max(use.bound for use in uses.values()),
        "output": uses[first].output,
        "tolerance": uses[first].tolerance,
        "per_phantom": {
            code: {
                "rung": use.name,
                "bound": use.bound if use.bounded else None,
                "reason": reason(use),
                "guards": _guards(session, code) if roles.guards_heard else None,
            }
            for code, use in uses.items()
        },
        "scene": {
            "probe": _based(scenes[first]["probe"], phantom.get("scene", "")),
            **{code: _based(_flat(scene["phantom"]), file) for code, scene in scenes.items()},
        },
    }


def _world(summary: RunSummary) -> dict[str, Any]:
    """Return the world in which the run was simulated, as the phantom told; nothing in the paper's own."""
    scenes = (json.loads(one.use.scene) for one in summary.methods if one.use.task == "contact")
    told = next((scene["world"] for scene in scenes if "world" in scene), None)
    if told is None:
        return {}
    rests, unit = world_basis(), world_units()
    parameters = {
        name: {"value": value, "unit": unit.get(name, ""), "basis": rests.get(name, "")}
        for name, value in told.items()
        if name != "name"
    }
    return {"world": {"name": told["name"], "parameters": parameters}}


def _guards(session: RecordedSession, code: str) -> list[str]:
    """Return what the sweeps over a phantom met, by ring position, each once."""
    met = {(row.ring_m, words) for row in session.rows if row.phantom == code for words in row.guards}
    return [f"ring_m = {ring_m:g}: {words}" for ring_m, words in sorted(met)]


def _flat(phantom: dict[str, Any]) -> dict[str, float]:
    """Return the numbers of a phantom and of its bead."""
    return {name: value for name, value in phantom.items() if name != "bead"} | (phantom["bead"] or {})


def _based(values: dict[str, float], file: str = "") -> dict[str, dict[str, Any]]:
    basis = dict.fromkeys(values, f"given by {file}") if file else SCENE
    return {name: {"value": value, "basis": basis[name]} for name, value in values.items()}


def _protocol(summary: RunSummary, roles: Roles, *, by_hand: bool) -> dict[str, dict[str, Any]]:
    """Return every node's parameters, each with what it rests on; where to record is no part of it."""
    found = {
        node: {
            name: {"value": value, "basis": basis_of(roles.of.get(node, ""), name)}
            for name, value in values.items()
            if (roles.of.get(node), name) not in _WHERE
        }
        for node, values in summary.params.items()
    }
    for node in found:
        _tell_set(found[node], last_set(summary.changes, node))
    if by_hand:
        entry = found[roles.node["experiment"]].setdefault("swaps", {"value": "", "basis": ""})
        entry["basis"] = "; ".join(
            filter(None, [entry["basis"], "others took over by hand (swapped_by_hand)"])
        )
    return found


def _tell_set(protocol: dict[str, dict[str, Any]], given: dict[str, Any]) -> None:
    """Have a node's protocol tell what its parameters were set to while it ran."""
    for name in given.keys() & protocol.keys():
        basis = protocol[name]["basis"]
        words = "; ".join(filter(None, [basis, "set while the session ran (changes)"]))
        protocol[name] = {"value": given[name], "basis": words}


def _versions() -> dict[str, str]:
    found = {"palp": palp_core.__version__, "python": platform.python_version()}
    for name, package in _PACKAGES.items():
        try:
            found[name] = version(package)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
