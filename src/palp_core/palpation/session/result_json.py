"""Builds the result of a session from its record and its run."""

from __future__ import annotations

import itertools
import json
import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from msgspec import UNSET, UnsetType

import palp_core
from palp_core.errors import MechanicsError
from palp_core.graph.launch.run_journal import last_set
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.statistics import statistics
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED, rings_of
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.methods.record import methods_of, reason, unsaid
from palp_core.palpation.session.methods.used import rig_of, rig_uses
from palp_core.palpation.session.parameter_basis import SCENE, basis_of
from palp_core.palpation.session.plan import policy_name
from palp_core.palpation.session.plan_repeatability import RepeatDesign, sweep_count
from palp_core.palpation.session.policy_changes import node_changes, policy_spans
from palp_core.palpation.session.recorded_session import RecordedSession, RecordedTrial, mm
from palp_core.palpation.session.result import (
    Accuracy,
    Based,
    CalibrationBin,
    CalibrationResult,
    Confusion,
    DroppedTrial,
    HowFar,
    MechanicsResult,
    MountCounts,
    PhantomModel,
    RigTime,
    SessionResult,
    Share,
    StopRuleUsed,
    Verdicts,
    WorldParameter,
    WorldResult,
)
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.world.model import basis as world_basis
from palp_core.palpation.world.model import units as world_units

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

_WHERE = {("experiment", name) for name in ("out", "overwrite", "session")}
INTERVAL = "95 % Wilson, this session only"
_PACKAGES = {"numpy": "numpy", "scipy": "scipy", "pywt": "PyWavelets", "msgspec": "msgspec", "pyzmq": "pyzmq"}


def build(session: RecordedSession, summary: RunSummary) -> SessionResult:
    """Return the result of a session and its run."""
    roles, sheet = roles_of(summary), sheet_of(summary)
    experiment = {**roles.params("experiment"), **summary.args}
    sweep_s = sum(row.end_ns - row.start_ns for row in session.rows) / 1e9
    trials, verdicts = session.trials, Counter(trial.verdict for trial in session.trials)
    asked = experiment.get("policy", "")
    policy, spans = policy_name(asked), policy_spans(session.rows)
    return SessionResult(
        policy=policy,
        policy_class=asked if ":" in asked else UNSET,
        policies=UNSET if [span.policy for span in spans] in ([], [policy]) else spans,
        changes=node_changes(summary.changes, session.rows) or UNSET,
        seed=summary.seed,
        trials=experiment.get("trials"),
        training=experiment.get("training"),
        trials_done=len(trials),
        trials_unfinished=session.unfinished_count,
        unfinished=how_far(session, summary, roles),
        trials_dropped=[_dropped(trial) for trial in session.dropped],
        left_out={f"{phase} {trial}": why for (phase, trial), why in session.left_out.items()} or UNSET,
        mounts=MountCounts(training=_mounts(session, "training"), estimation=_mounts(session, "estimation")),
        accuracy=Accuracy(
            overall=_accuracy(trials),
            per_depth_mm={mm(d): _accuracy(session.at_depth(d)) for d in session.tried_m},
            interval=INTERVAL,
        ),
        chance=1.0 / len(session.depths_m) if session.depths_m else None,
        reading=roles.params("estimator").get("reading", "feature"),
        rig_s_per_decision=_rig_s(session),
        probes_mean=_probes(trials),
        probes_mean_per_depth_mm={mm(d): _probes(session.at_depth(d)) for d in session.tried_m},
        verdicts=Verdicts(decided=verdicts["decided"], undecided=verdicts["undecided"]),
        calibration=_calibration(trials),
        confusion=_confusion(session),
        grid_depths=session.grid_count,
        rmse_mm=_rmse_mm(trials),
        stop_rule=_stop_rule(roles.params("estimator")),
        mechanics=_mechanics(summary, roles, session) if roles.touch_simulated else None,
        world=_world(summary),
        methods=methods_of(summary, session.rows),
        methods_unsaid=unsaid(summary, session.rows),
        roles=dict(roles.node),
        protocol=_protocol(summary, roles),
        clock=summary.clock,
        sim_time_s=summary.clock_s,
        palpations=len(session.rows),
        incidents=summary.incidents,
        sweep_s=sweep_s,
        activations=summary.activation_count,
        wall_time_s=summary.wall_s or None,
        sweep_s_per_wall_s=sweep_s / summary.wall_s if summary.wall_s > 0.0 else None,
        palpations_per_wall_s=len(session.rows) / summary.wall_s if summary.wall_s > 0.0 else None,
        composed=summary.composed,
        session={k: v for k, v in msgspec.to_builtins(sheet).items() if k != "began"} if sheet else None,
        began=sheet.began if sheet is not None else "",
        graph=summary.graph,
        launch_file=summary.file,
        out=str(session.folder),
        versions=_versions(),
    )


def how_far(session: RecordedSession, summary: RunSummary, roles: Roles) -> HowFar | None:
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
    return HowFar(done=done, of=of, what=what, why=summary.ended)


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


def _share(right: int, of: int) -> Share:
    if not of:
        return Share(value=None, ci=None, right=0, of=0)
    found = statistics.wilson(right, of)
    return Share(value=found.value, ci=(found.low, found.high), right=right, of=of)


def _accuracy(trials: Sequence[RecordedTrial]) -> Share:
    return _share(sum(trial.right for trial in trials), len(trials))


def _mounts(session: RecordedSession, phase: str) -> int:
    """Return how often a phantom was put on the rig; trials of one mounting share its error."""
    return len({row.remount for row in session.rows if row.phase == phase})


def _probes(trials: Sequence[RecordedTrial]) -> float | None:
    return float(np.mean([len(trial.probes) for trial in trials])) if trials else None


def _rig_s(session: RecordedSession) -> RigTime:
    """Return how long stage and ring took for a decision: from one trial's last torque to the next one's.

    So lifting, going back, moving and re-homing the ring count; putting a phantom on does not: of each
    mounting the first trial is left out.
    """
    ends = [(trial.probes[-1].remount, trial.probes[-1].end_ns) for trial in _in_order(session)]
    took = [(b - a) / 1e9 for (one, a), (other, b) in itertools.pairwise(ends) if one == other]
    return RigTime(mean=float(np.mean(took)) if took else None, trials=len(took))


def _in_order(session: RecordedSession) -> list[RecordedTrial]:
    return sorted((*session.trials, *session.dropped), key=lambda trial: trial.probes[-1].row)


def _dropped(trial: RecordedTrial) -> DroppedTrial:
    last = trial.probes[-1]
    return DroppedTrial(trial=last.trial, reason=f"ring position {last.ring_m * 1e3:g} mm was not trained")


def _calibration(trials: Sequence[RecordedTrial]) -> CalibrationResult | None:
    if not trials:
        return None
    found = statistics.calibration(
        np.array([trial.confidence for trial in trials]), [trial.right for trial in trials]
    )
    return CalibrationResult(
        expected_error=found.expected_error,
        overconfidence=found.overconfidence,
        bins=[
            CalibrationBin(
                low=one.low,
                high=one.high,
                mean_confidence=one.mean_confidence,
                accuracy=_share(one.accuracy.success_count, one.accuracy.trial_count),
            )
            for one in found.bins
        ],
    )


def _confusion(session: RecordedSession) -> Confusion:
    estimates = [(trial, trial.probes[-1].estimate_m) for trial in session.trials]
    table = statistics.confusion(
        [session.class_of(trial.depth_m) for trial, estimate_m in estimates if estimate_m is not None],
        [session.class_of(estimate_m) for _, estimate_m in estimates if estimate_m is not None],
        len(session.depths_m),
    )
    depths_mm = [round(depth_m * 1e3, 6) for depth_m in session.depths_m]
    return Confusion(depths_mm=depths_mm, actual_by_estimated=table.tolist())


def _rmse_mm(trials: Sequence[RecordedTrial]) -> float | None:
    """Return the root mean square of the belief's mean depth about the true one, mm."""
    if not trials:
        return None
    return 1e3 * float(np.sqrt(np.mean([(trial.mean_m - trial.depth_m) ** 2 for trial in trials])))


def _stop_rule(estimator: dict[str, Any]) -> StopRuleUsed | None:
    if "stop" not in estimator:
        return None
    settings: dict[str, Any] = {}
    if estimator["stop"] != AUTO:
        rule: Any = stop_rule(estimator["stop"], estimator.get("stop_value", 0.0))
        settings = asdict(rule)
    limit = {"max_probes": estimator["max_probes"]} if "max_probes" in estimator else {}
    return StopRuleUsed(name=estimator["stop"], settings=settings | limit)


def _touched(summary: RunSummary, roles: Roles) -> dict[str, MethodUse]:
    """Return what the phantom said of the rung of each phantom, by code; the latest counts.

    A run that is older than that record is told from the files that it names, as they are now.
    """
    said = {one.use.of: one.use for one in summary.methods if one.use.task == "contact"}
    if said:
        return said
    uses = rig_uses(rig_of(roles.params("phantom")), None)
    return {use.of: use for use in uses if use.task == "contact"}


def _mechanics(summary: RunSummary, roles: Roles, session: RecordedSession) -> MechanicsResult:
    """Return every phantom's rung, its stated bound, its guards, and the scene.

    Guards are what the run's sweeps met, as the phantom told; None where the experiment did not hear it.
    """
    phantom, uses = roles.params("phantom"), _touched(summary, roles)
    file = phantom.get("scene") or phantom.get("phantoms", "")
    scenes = {code: json.loads(use.scene) for code, use in uses.items()}
    first = next(iter(uses))
    return MechanicsResult(
        rung=", ".join(sorted({use.name for use in uses.values()})),
        bound=max(use.bound for use in uses.values()),
        output=uses[first].output,
        tolerance=uses[first].tolerance,
        per_phantom={
            code: PhantomModel(
                rung=use.name,
                bound=use.bound if use.bounded else None,
                reason=reason(use),
                guards=_guards(session, code) if roles.guards_heard else None,
            )
            for code, use in uses.items()
        },
        scene={
            "probe": _based(scenes[first]["probe"], phantom.get("scene", "")),
            **{code: _based(_flat(scene["phantom"]), file) for code, scene in scenes.items()},
        },
    )


def _world(summary: RunSummary) -> WorldResult | UnsetType:
    """Return the world in which the run was simulated, as the phantom told; nothing in the paper's own."""
    scenes = (json.loads(one.use.scene) for one in summary.methods if one.use.task == "contact")
    told = next((scene["world"] for scene in scenes if "world" in scene), None)
    if told is None:
        return UNSET
    rests, unit = world_basis(), world_units()
    parameters = {
        name: WorldParameter(value=value, unit=unit.get(name, ""), basis=rests.get(name, ""))
        for name, value in told.items()
        if name != "name"
    }
    return WorldResult(name=told["name"], parameters=parameters)


def _guards(session: RecordedSession, code: str) -> list[str]:
    """Return what the sweeps over a phantom met, by ring position, each once."""
    met = {(row.ring_m, words) for row in session.rows if row.phantom == code for words in row.guards}
    return [f"ring_m = {ring_m:g}: {words}" for ring_m, words in sorted(met)]


def _flat(phantom: dict[str, Any]) -> dict[str, float]:
    """Return the numbers of a phantom and of its bead."""
    return {name: value for name, value in phantom.items() if name != "bead"} | (phantom["bead"] or {})


def _based(values: dict[str, float], file: str = "") -> dict[str, Based]:
    basis = dict.fromkeys(values, f"given by {file}") if file else SCENE
    return {name: Based(value=value, basis=basis[name]) for name, value in values.items()}


def _protocol(summary: RunSummary, roles: Roles) -> dict[str, dict[str, Based]]:
    """Return every node's parameters, each with what it rests on; where to record is no part of it."""
    found = {
        node: {
            name: Based(value=value, basis=basis_of(roles.of.get(node, ""), name))
            for name, value in values.items()
            if (roles.of.get(node), name) not in _WHERE
        }
        for node, values in summary.params.items()
    }
    for node, parameters in found.items():
        given = last_set(summary.changes, node)
        for name in given.keys() & parameters.keys():
            rests = filter(None, [parameters[name].basis, "set while the session ran (changes)"])
            parameters[name] = Based(value=given[name], basis="; ".join(rests))
    return found


def _versions() -> dict[str, str]:
    found = {"palp": palp_core.__version__, "python": platform.python_version()}
    for name, package in _PACKAGES.items():
        try:
            found[name] = version(package)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
