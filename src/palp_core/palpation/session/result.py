"""The result of a session: what ``result.json`` holds, in the order in which a person reads it.

Two runs of one launch file and seed give the same file but for :data:`TIME_KEYS`. A field that is
:data:`msgspec.UNSET` is not in the file.
"""

from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec import UNSET, UnsetType

from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import Incident
from palp_core.palpation.session.methods.record import MethodRecord
from palp_core.palpation.session.plan import planned, policy_name
from palp_core.palpation.session.policy_changes import NodeChange, PolicySwap
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
    """Right trials, of all and by depth in mm."""

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
    """A trial that was dropped."""

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
    """How trials ended."""

    decided: int
    undecided: int


class CalibrationBin(msgspec.Struct, kw_only=True):
    """Trials of about one confidence."""

    low: float
    high: float
    mean_confidence: float
    accuracy: Share


class CalibrationResult(msgspec.Struct, kw_only=True):
    """Stated confidence against accuracy."""

    expected_error: float
    overconfidence: float
    bins: list[CalibrationBin]


class Confusion(msgspec.Struct, kw_only=True):
    """Counts of trials, a row per actual depth, a column per estimate."""

    depths_mm: list[float]
    actual_by_estimated: list[list[int]]


class StopRuleUsed(msgspec.Struct, kw_only=True):
    """The stop rule and its numbers."""

    name: str
    settings: dict[str, Any]


class PhantomModel(msgspec.Struct, kw_only=True):
    """The contact model of a phantom; ``guards``: what sweeps met, None where that was not recorded."""

    rung: str
    bound: float | None
    reason: str
    guards: list[str] | None


class Based(msgspec.Struct, kw_only=True):
    """A value, and what it rests on."""

    value: Any
    basis: str


class MechanicsResult(msgspec.Struct, kw_only=True):
    """How the touch was simulated."""

    rung: str
    bound: float
    output: str
    tolerance: float
    per_phantom: dict[str, PhantomModel]
    scene: dict[str, dict[str, Based]]


class WorldParameter(msgspec.Struct, kw_only=True):
    """A number of a simulated world."""

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
    swapped_by_hand: list[PolicySwap] | UnsetType = UNSET
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

    @property
    def planned_swaps(self) -> dict[int, str]:
        """The class by the number of the trial in which it was to take over."""
        swaps = self.protocol_of("experiment").get("swaps")
        return planned(swaps.value) if swaps else {}

    @property
    def by_hand(self) -> list[PolicySwap]:
        """Policies that took over though no plan had them."""
        return self.swapped_by_hand or []

    def unfinished_words(self) -> str:
        """Return ``unfinished: 124 of 300 trials``; empty where the run came to its end."""
        if self.unfinished is None:
            return ""
        of = f" of {self.unfinished.of}" if self.unfinished.of else ""
        return f"unfinished: {self.unfinished.done}{of} {self.unfinished.what}"

    def policy_spans(self) -> list["PolicySpan"]:
        """Return which policy chose from which palpation on; one that chose nothing is left out."""
        begun = self.trials_done + len(self.trials_dropped) + self.trials_unfinished
        took_over = [
            PolicySpan(trial, 2, policy_name(run))  # the one before begins the trial
            for trial, run in self.planned_swaps.items()
            if 1 <= trial <= begun
        ]
        took_over += [PolicySpan(one.trial, one.palpation, one.policy) for one in self.by_hand]
        spans = [PolicySpan(1, 1, self.policy or "unnamed"), *sorted(took_over, key=lambda one: one[:2])]
        while len(spans) > 1 and spans[1][:2] == (1, 1):
            del spans[0]
        return spans

    def policy_label(self) -> str:
        """Return the policy that chose first and those that took over; the last with its ring, if any.

        Where no trial was begun, the policies that were there follow in their order.
        """
        first, *later = self.policy_spans()
        label = first.policy
        if self.policy_class and label == self.policy:
            label += f" ({self.policy_class})"
        label += "".join(f", from trial {one.trial} on {one.policy}" for one in later)
        node = self.roles.get("policy", "policy")
        present = [
            policy_name(one.run) for one in self.changes or () if one.node == node and one.run != one.before
        ]
        nothing_begun = not (self.trials_done or self.trials_dropped or self.trials_unfinished)
        if nothing_begun:
            label += "".join(f", then {policy}" for policy in present)
        ring = self.protocol_of("policy").get("ring_mm")  # of the policy that was there last
        last_chose = nothing_begun or not present or present[-1] == [first, *later][-1].policy
        return label + (f", {ring.value:g} mm" if ring and last_chose else "")


class PolicySpan(NamedTuple):
    """A policy, and the trial and palpation of estimation from which on it chose."""

    trial: int
    palpation: int
    policy: str


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
