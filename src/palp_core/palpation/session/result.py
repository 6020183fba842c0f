"""The result of a session: what ``result.json`` holds, in the order in which a person reads it.

Two runs of one launch file and seed give the same file but for :data:`TIME_KEYS`. A field that is
:data:`msgspec.UNSET` is not in the file.
"""

from pathlib import Path
from typing import Any

import msgspec
from msgspec import UNSET, UnsetType

from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import Incident
from palp_core.palpation.session.methods.record import MethodRecord
from palp_core.palpation.session.plan import policy_name
from palp_core.palpation.session.policy_changes import NodeChange, PolicySpan
from palp_core.palpation.session.session_folder import RESULT
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
    """How long stage and ring took for a decision."""

    mean: float | None
    trials: int


class Verdicts(msgspec.Struct, kw_only=True):
    decided: int
    undecided: int


class CalibrationBin(msgspec.Struct, kw_only=True):
    low: float
    high: float
    mean_confidence: float
    accuracy: Share


class CalibrationResult(msgspec.Struct, kw_only=True):
    expected_error: float
    overconfidence: float
    bins: list[CalibrationBin]


class Confusion(msgspec.Struct, kw_only=True):
    """Counts of trials, a row per actual depth, a column per estimate."""

    depths_mm: list[float]
    actual_by_estimated: list[list[int]]


class StopRuleUsed(msgspec.Struct, kw_only=True):
    name: str
    settings: dict[str, Any]


class PhantomModel(msgspec.Struct, kw_only=True):
    """The contact model of a phantom; ``guards``: what sweeps met, None where that was not recorded."""

    rung: str
    bound: float | None
    reason: str
    guards: list[str] | None


class Based(msgspec.Struct, kw_only=True):
    value: Any
    basis: str


class MechanicsResult(msgspec.Struct, kw_only=True):
    rung: str
    bound: float
    output: str
    tolerance: float
    per_phantom: dict[str, PhantomModel]
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
    """What ``result.json`` holds."""

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
    calibration: CalibrationResult | None
    confusion: Confusion
    grid_depths: int
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
        """Return the policy that chose first, those that took over, and the ring position of the last."""
        chose = [span.policy for span in self.policies or ()] or [self.policy or "unnamed"]
        label = chose[0]
        if self.policy_class and label == self.policy:
            label += f" ({self.policy_class})"
        for span in (self.policies or ())[1:]:
            label += f", from trial {span.trial} on {span.policy}"
        node = self.roles.get("policy", "policy")
        present = [policy_name(one.run) for one in self.changes or () if one.node == node and one.run]
        ring = self.protocol_of("policy").get("ring_mm")  # of the policy that was there last
        return label + (f", {ring.value:g} mm" if ring and (present or chose)[-1] == chose[-1] else "")


def write_result(result: SessionResult, folder: Path) -> Path:
    """Write ``result.json``; it appears under its name only when complete. NaN becomes null."""
    target = folder / RESULT
    write_json(target, result)
    return target


def read_result(out: str | Path) -> SessionResult:
    """Return the result of the session recorded in a folder."""
    path = Path(out) / RESULT
    try:
        return msgspec.json.decode(read_whole(path), type=SessionResult)
    except FileNotFoundError as error:
        raise PalpError(f"no result in '{out}': {path} is missing; run a session with out:={out}") from error
    except OSError as error:
        raise PalpError(f"{path} cannot be read: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise PalpError(f"{path} is no result: {error}; run the session again") from error
