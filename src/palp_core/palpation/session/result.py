"""The result of a session: what ``result.json`` holds, in the order in which a person reads it.

Two runs of one launch file and seed give the same file but for :data:`TIME_KEYS`. A field that is
:data:`msgspec.UNSET` is not in the file.
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
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET, UnsetType

import palp_core
from palp_core.errors import MechanicsError, PalpError, in_words
from palp_core.graph.launch.run_journal import Incident, last_set
from palp_core.graph.launch.summary import RunSummary
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.stopping import stop_rule
from palp_core.palpation.perception.statistics import statistics
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED, rings_of
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.methods.record import MethodRecord, methods_of, unsaid
from palp_core.palpation.session.methods.used import rig_of, rig_uses
from palp_core.palpation.session.parameter_basis import SCENE, basis_of
from palp_core.palpation.session.plan import policy_name
from palp_core.palpation.session.plan_repeatability import RepeatDesign, sweep_count
from palp_core.palpation.session.policy_changes import NodeChange, PolicySpan, node_changes, policy_spans
from palp_core.palpation.session.recorded_session import RecordedSession, RecordedTrial, mm
from palp_core.palpation.session.roles import Roles, roles_of
from palp_core.palpation.session.session_folder import RESULT
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.world.model import basis as world_basis
from palp_core.palpation.world.model import units as world_units
from palp_core.whole_file import read_whole, write_json

TIME_KEYS = (
    "began",
    "composed",
    "launch_file",
    "out",
    "palpations_per_wall_s",
    "sweep_s_per_wall_s",
    "wall_time_s",
)
"""Fields that depend on wall time, or on where and how the graph was run."""

INTERVAL = "95 % Wilson, this session only"
_WHERE = {("experiment", name) for name in ("out", "overwrite", "session")}
_PACKAGES = {"numpy": "numpy", "scipy": "scipy", "pywt": "PyWavelets", "msgspec": "msgspec", "pyzmq": "pyzmq"}


class Share(msgspec.Struct, kw_only=True):
    """How many were right, with the interval of their share."""

    value: float | None
    ci: tuple[float, float] | None
    right: int
    of: int


class Accuracy(msgspec.Struct, kw_only=True):
    overall: Share
    per_depth_mm: dict[str, Share]
    interval: str


class HowFar(msgspec.Struct, kw_only=True):
    """How far a run came that did not come to its end, and why it did not."""

    done: int
    of: int
    what: str
    why: str


class DroppedTrial(msgspec.Struct, kw_only=True):
    trial: int
    reason: str


class MountCounts(msgspec.Struct, kw_only=True):
    """How often a phantom was put on; trials of one mounting share its error."""

    training: int
    estimation: int


class RigTime(msgspec.Struct, kw_only=True):
    mean: float | None
    trials: int


class Verdicts(msgspec.Struct, kw_only=True):
    decided: int
    undecided: int


class Confusion(msgspec.Struct, kw_only=True):
    """Counts of trials, a row per actual depth, a column per estimate."""

    depths_mm: list[float]
    actual_by_estimated: list[list[int]]


class StopRuleUsed(msgspec.Struct, kw_only=True):
    name: str
    settings: dict[str, Any]


class Based(msgspec.Struct, kw_only=True):
    value: Any
    basis: str


class MechanicsResult(msgspec.Struct, kw_only=True):
    """What was touched; ``guards``: what the sweeps over each phantom met, None if that was not recorded."""

    output: str
    tolerance: float
    guards: dict[str, list[str]] | None
    scene: dict[str, dict[str, Based]]


class WorldParameter(msgspec.Struct, kw_only=True):
    value: Any
    unit: str
    basis: str


class WorldResult(msgspec.Struct, kw_only=True):
    """What phantoms, probe and sensor had in addition to the paper's own design."""

    name: str
    parameters: dict[str, WorldParameter]


class SessionResult(msgspec.Struct, kw_only=True):
    """The result of a session, as ``result.json`` holds it."""

    policy: str
    policy_class: str | UnsetType = UNSET
    policies: list[PolicySpan] | UnsetType = UNSET
    changes: list[NodeChange] | UnsetType = UNSET
    seed: int
    trials: int | None
    training: int | None
    trials_done: int
    trials_unfinished: int
    unfinished: HowFar | None
    trials_dropped: list[DroppedTrial]
    left_out: dict[str, str] | UnsetType = UNSET
    mounts: MountCounts
    accuracy: Accuracy
    chance: float | None
    reading: str
    rig_s_per_decision: RigTime
    probes_mean: float | None
    probes_mean_per_depth_mm: dict[str, float | None]
    verdicts: Verdicts
    calibration: statistics.ConfidenceCalibration | None
    confusion: Confusion
    rmse_mm: float | None
    stop_rule: StopRuleUsed | None
    mechanics: MechanicsResult | None
    world: WorldResult | UnsetType = UNSET
    methods: list[MethodRecord]
    methods_unsaid: list[str]
    roles: dict[str, str]
    protocol: dict[str, dict[str, Based]]
    clock: str
    sim_time_s: float
    palpations: int
    incidents: list[Incident]
    sweep_s: float
    activations: int | None
    wall_time_s: float | None
    sweep_s_per_wall_s: float | None
    palpations_per_wall_s: float | None
    composed: bool
    session: dict[str, Any] | None
    began: str
    graph: str
    launch_file: str
    out: str
    versions: dict[str, str]

    def protocol_of(self, role: str) -> dict[str, Based]:
        """Return the parameters of the node of a role; none where no node has it."""
        return self.protocol.get(self.roles.get(role, role), {})

    def unfinished_words(self) -> str:
        """Return ``unfinished: 124 of 300 trials``; empty where the run came to its end."""
        if self.unfinished is None:
            return ""
        of = f" of {self.unfinished.of}" if self.unfinished.of else ""
        return f"unfinished: {self.unfinished.done}{of} {self.unfinished.what}"

    def policy_label(self) -> str:
        """Return the policy that chose first, those that took over, and the ring position of the last.

        Where no trial was begun, the policies that were there follow in their order.
        """
        chose = [span.policy for span in self.policies or ()] or [self.policy or "unnamed"]
        label = chose[0]
        if self.policy_class and label == self.policy:
            label += f" ({self.policy_class})"
        for span in (self.policies or ())[1:]:
            label += f", from trial {span.trial} on {span.policy}"
        node = self.roles.get("policy", "policy")
        present = [policy_name(one.run) for one in self.changes or () if one.node == node and one.run]
        if not (self.policies or self.trials_done or self.trials_dropped or self.trials_unfinished):
            label += "".join(f", then {policy}" for policy in present)
            chose += present
        ring = self.protocol_of("policy").get("ring_mm")  # of the policy that was there last
        return label + (f", {ring.value:g} mm" if ring and (present or chose)[-1] == chose[-1] else "")


def write_result(result: SessionResult, folder: Path) -> Path:
    """Write ``result.json``; it appears under its name only when complete. NaN becomes null."""
    target = folder / RESULT
    write_json(target, result)
    return target


def read_result(out: str | Path) -> SessionResult:
    """Return the result in a session's folder."""
    path = Path(out) / RESULT
    try:
        return msgspec.json.decode(read_whole(path), type=SessionResult)
    except FileNotFoundError as error:
        raise PalpError(f"no result in '{out}': {path} is missing; run a session with out:={out}") from error
    except (OSError, msgspec.DecodeError) as error:
        raise PalpError(f"{path} is not a result: {in_words(error)}; palp session report makes it") from error


def build(session: RecordedSession, summary: RunSummary) -> SessionResult:
    roles, sheet = roles_of(summary), sheet_of(summary)
    experiment = {**roles.params("experiment"), **summary.args}
    sweep_s = sum(row.end_ns - row.start_ns for row in session.rows) / 1e9
    trials, verdicts = session.trials, Counter(trial.verdict for trial in session.trials)
    mounts = Counter(phase for phase, _ in {(row.phase, row.remount) for row in session.rows})
    away_m = [trial.mean_m - trial.depth_m for trial in trials]  # of the belief's mean depth
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
        trials_dropped=[
            DroppedTrial(trial=last.trial, reason=f"ring position {mm(last.ring_m)} mm was not trained")
            for last in (trial.probes[-1] for trial in session.dropped)
        ],
        left_out={f"{phase} {trial}": why for (phase, trial), why in session.left_out.items()} or UNSET,
        mounts=MountCounts(training=mounts["training"], estimation=mounts["estimation"]),
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
        rmse_mm=1e3 * float(np.sqrt(np.mean(np.square(away_m)))) if away_m else None,
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
    """Return how many phantoms have a bead to be found; 0 if that is unknown."""
    reported = {one.use.of: json.loads(one.use.scene) for one in summary.methods if one.use.task == "contact"}
    if reported:
        return sum(scene["phantom"]["bead"] is not None for scene in reported.values())
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


def _probes(trials: Sequence[RecordedTrial]) -> float | None:
    return float(np.mean([len(trial.probes) for trial in trials])) if trials else None


def _rig_s(session: RecordedSession) -> RigTime:
    """Return how long stage and ring took for a decision: from one trial's last torque to the next one's.

    So lifting, going back, moving and re-homing the ring count; putting a phantom on does not: of each
    mounting the first trial is left out.
    """
    last = sorted(
        (trial.probes[-1] for trial in (*session.trials, *session.dropped)), key=lambda one: one.row
    )
    ends = [(probe.remount, probe.end_ns) for probe in last]
    took = [(b - a) / 1e9 for (one, a), (other, b) in itertools.pairwise(ends) if one == other]
    return RigTime(mean=float(np.mean(took)) if took else None, trials=len(took))


def _calibration(trials: Sequence[RecordedTrial]) -> statistics.ConfidenceCalibration | None:
    if not trials:
        return None
    stated = np.array([trial.confidence for trial in trials])
    return statistics.calibration(stated, [trial.right for trial in trials])


def _confusion(session: RecordedSession) -> Confusion:
    estimates = [(trial, trial.probes[-1].estimate_m) for trial in session.trials]
    table = statistics.confusion(
        [session.class_of(trial.depth_m) for trial, estimate_m in estimates if estimate_m is not None],
        [session.class_of(estimate_m) for _, estimate_m in estimates if estimate_m is not None],
        len(session.depths_m),
    )
    depths_mm = [round(depth_m * 1e3, 6) for depth_m in session.depths_m]
    return Confusion(depths_mm=depths_mm, actual_by_estimated=table.tolist())


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
    """Return the contact model of each phantom by code, as the phantom reported it; the latest counts.

    Before it has, it is the register's choice for the files that the run names.
    """
    found = {one.use.of: one.use for one in summary.methods if one.use.task == "contact"}
    return found or {use.of: use for use in rig_uses(rig_of(roles.params("phantom")), None)}


def _mechanics(summary: RunSummary, roles: Roles, session: RecordedSession) -> MechanicsResult:
    phantom, uses = roles.params("phantom"), _touched(summary, roles)
    file = phantom.get("scene") or phantom.get("phantoms", "")
    scenes = {code: json.loads(use.scene) for code, use in uses.items()}
    first = next(iter(uses))
    return MechanicsResult(
        output=uses[first].output,
        tolerance=uses[first].tolerance,
        guards={code: _guards(session, code) for code in uses} if roles.guards_recorded else None,
        scene={
            "probe": _based(scenes[first]["probe"], phantom.get("scene", "")),
            **{code: _based(_flat(scene["phantom"]), file) for code, scene in scenes.items()},
        },
    )


def _world(summary: RunSummary) -> WorldResult | UnsetType:
    """Return the world of a simulated run, as the phantom reported; nothing in the paper's own."""
    scenes = (json.loads(one.use.scene) for one in summary.methods if one.use.task == "contact")
    world = next((scene["world"] for scene in scenes if "world" in scene), None)
    if world is None:
        return UNSET
    rests, unit = world_basis(), world_units()
    parameters = {
        name: WorldParameter(value=value, unit=unit.get(name, ""), basis=rests.get(name, ""))
        for name, value in world.items()
        if name != "name"
    }
    return WorldResult(name=world["name"], parameters=parameters)


def _guards(session: RecordedSession, code: str) -> list[str]:
    """Return what the sweeps over a phantom met, by ring position, each once."""
    met = {(row.ring_m, words) for row in session.rows if row.phantom == code for words in row.guards}
    return [f"ring_m = {ring_m:g}: {words}" for ring_m, words in sorted(met)]


def _flat(phantom: dict[str, Any]) -> dict[str, float]:
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
