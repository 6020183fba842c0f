"""The record of a session from a bag of its run: rows, sweeps and primitives as the experiment wrote them.

The experiment writes down what other nodes tell it. The same messages are in the bag, and are followed here
in the order in which they were published: between processes a recorder may have heard them in another.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagDamaged, MechanicsError, PalpError
from palp_core.graph.bag.reader import Bag, BagMessage
from palp_core.graph.launch.run_journal import GRAPH_EVENTS, MethodSpan, RunChange, RunJournal
from palp_core.graph.launch.summary import RunSummary
from palp_core.graph.messages.builtin import DiagnosticStatus, MethodsUsed
from palp_core.graph.node.qos_events import EVENTS_PORT
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.session.plan import policy_name
from palp_core.palpation.session.policy_changes import apply_policy_changes
from palp_core.palpation.session.roles import GUARD, NoSession, Roles, roles_of
from palp_core.palpation.session.session_folder import RUN, cannot_write, refuse_input, refuse_occupied
from palp_core.palpation.session.trials_csv import Row, SessionWriter, primitives_json, row_of
from palp_core.whole_file import write_json

_NAMED_BY = "--out"
_HEARD = (
    *("Belief", "Palpation", "PrimitivesLearnt", "RingState", "RingTruth", "PhantomTruth", "SweepStatus"),
    "PolicyChange",
    GUARD,
)
_SAID = ("Trial", "SweepGoal", "Mount", "Progress", "Swap")
_DIAGNOSTIC, _METHODS = "DiagnosticStatus", "MethodsUsed"
_BEFORE_ANY_ROW = ("Trial", "SweepGoal", "Mount", "Progress", "RingState", "RingTruth", "PhantomTruth")
_BEFORE_ESTIMATION = ("Belief", "PrimitivesLearnt")


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag, or one of its files, and no session's folder."""
    return path.suffix == ".mcap" or (any(path.glob("*.mcap")) and not (path / RUN).exists())


def write_record(path: Path, folder: Path, *, overwrite: bool = False) -> RunSummary:
    """Write the record of the session that a bag holds into a folder; return how its run went."""
    if not overwrite:
        ways_on = "name another folder, --out NAME, or let this replace it, --overwrite"
        refuse_occupied(folder, ways_on, _NAMED_BY)
    refuse_input(folder, path, f"the bag '{path}'")
    found = read_record(path)
    writer = SessionWriter(str(folder), found.believed_m, _NAMED_BY)
    writer.start(overwrite=overwrite)
    try:
        for row, palpation in zip(found.rows, found.palpations, strict=True):
            writer.append(row, palpation.torque_n_m, palpation.rate_hz)
        for learnt in found.learnt:
            writer.primitives(primitives_json(learnt))
        write_json(folder / RUN, found.summary)
    except OSError as error:
        raise cannot_write(folder, error, _NAMED_BY) from error
    finally:
        writer.close()
    return found.summary


@dataclasses.dataclass(frozen=True, eq=False)
class BagRecord:
    """The record of the session that a bag holds."""

    summary: RunSummary  # how the run went, as far as the bag has it
    rows: list[Row]  # its palpations as the experiment recorded them
    palpations: list[Any]  # the message of each, with its torque
    believed_m: Sequence[float]  # depths that the beliefs are about
    learnt: list[Any]  # messages of memory primitives


def read_record(path: Path) -> BagRecord:
    """Return the record of the session that a bag holds."""
    with Bag(path) as bag:
        found = _Contents(bag)
    made = found.rows()
    rows = [row for row, _ in made]
    palpations = [palpation for _, palpation in made]
    learnt = found.values("PrimitivesLearnt")
    return BagRecord(found.summary(rows), rows, palpations, found.believed_m(), learnt)


class _Contents:
    """What of a bag is about its session, in the order in which it was published."""

    def __init__(self, bag: Bag) -> None:
        self._path = bag.path
        self._launch = launch_of(bag)
        self._roles = _roles(self._launch, bag.path)
        self._kind_of = _topics(self._launch, self._roles)
        self._damage = ""
        self._messages: list[BagMessage] = []
        try:
            for message in bag.messages(list(self._kind_of)):
                self._messages.append(message)  # what stands before the damage is kept
        except BagDamaged as error:
            self._damage = str(error)
        self._messages.sort(key=lambda message: message.publish_ns)
        self._topics = bag.topics()
        self._changes = _changes(bag)

    def values(self, kind: str) -> list[Any]:
        """Return the messages of a type."""
        return [message.value for message in self._messages if self._kind_of[message.topic] == kind]

    def rows(self) -> list[tuple[Row, Any]]:
        """Return every row with its palpation."""
        builder, found = _RecordBuilder(self._roles.params("experiment")), []
        for message in self._messages:
            made = builder.feed(self._kind_of[message.topic], message.value)
            if made is not None:
                found.append(made)
        estimated = any(trial.phase == "estimation" for trial in self.values("Trial"))
        needed = {"Palpation", *_BEFORE_ANY_ROW, *(_BEFORE_ESTIMATION if estimated else ())}
        lacking = sorted(
            name for name, kind in self._kind_of.items() if kind in needed and name not in self._heard()
        )
        if self._topic_of("Palpation") in lacking:
            raise PalpError(
                f"{self._path}: holds no palpation: nothing of {self._topic_of('Palpation')} is in it"
            )
        if lacking:
            raise PalpError(
                f"{self._path}: nothing of {', '.join(lacking)} is in it, and without it the session cannot "
                "be told; record the whole run: palp launch FILE --record DIR, or palp bag record -a"
            )
        if not found:
            raise PalpError(f"{self._path}: holds no palpation whose trial and phantom are in it, too")
        return found

    def believed_m(self) -> Sequence[float]:
        """Return the depths that the beliefs are about; before the first, those that the experiment has."""
        for belief in self.values("Belief"):
            depths_m: list[float] = belief.depths_m.tolist()
            return depths_m
        params = self._roles.params("experiment")
        try:
            phantoms = load_phantoms(params.get("phantoms", "")).values()
            taught_m = {phantom.bead.depth_m for phantom in phantoms if phantom.bead is not None}
        except MechanicsError:  # their file is not where it was
            taught_m = {truth.depth_m for truth in self.values("PhantomTruth")}
        grid: list[float] = classes_of(sorted(taught_m), params.get("depths", 0)).tolist()
        return grid

    def summary(self, rows: Sequence[Row]) -> RunSummary:
        """Return how the run went, as far as the bag tells."""
        ended = self._why_unfinished(rows)
        clock_s = self._messages[-1].log_ns / 1e9
        return msgspec.structs.replace(
            self._launch,
            listens=self._listens(),
            exit_code=-1 if ended else 0,
            ended=ended,
            clock_s=clock_s,
            wall_s=clock_s if self._launch.clock == "wall" else 0.0,
            activation_count=None,
            incidents=self._incidents(),
            methods=self._methods(),
            changes=self._changes,
        )

    def _why_unfinished(self, rows: Sequence[Row]) -> str:
        """Return why the bag does not hold the session to its end; "" if it does."""
        if not any(progress.phase == "done" for progress in self.values("Progress")):
            return (
                f"the bag is damaged: {self._damage}"
                if self._damage
                else "the bag ends before the session does"
            )
        last: dict[tuple[str, int], int] = {}
        for row in rows:
            key = row.phase, row.trial
            last[key] = max(last.get(key, 0), row.iteration)
        trials = dict(sorted(last))  # of each phase the last one's number
        lacking = sum(last.values()) - len(rows) + sum(trials.values()) - len(last)
        lacking += "estimation" in trials and "training" not in trials  # which comes first
        return (
            f"the bag lacks at least {counted(lacking, 'palpation')}: it begins later, or messages "
            "are missing, which "
            "`palp bag info` lists"
            if lacking
            else ""
        )

    def _listens(self) -> dict[str, list[str]]:
        """Return what nodes hear, without guards of which it cannot be told whether they were recorded.

        A phantom that met nothing said nothing of it; then something else that it said shows that its topics
        were recorded.
        """
        phantom = self._roles.node.get("phantom", "")
        mute = {name for name, kind in self._kind_of.items() if kind == GUARD} - self._heard()
        beside = [
            name for name in self._topics if name.startswith(f"/{phantom}/") and name not in self._kind_of
        ]
        return {
            node: [name for name in names if beside or name not in mute]
            for node, names in self._launch.listens.items()
        }

    def _incidents(self) -> list[Any]:
        owner = {name: node for node, topics in self._launch.publishes.items() for name in topics}
        journal = RunJournal()
        for message in self._messages:
            if self._kind_of[message.topic] == _DIAGNOSTIC:
                status = msgspec.convert(message.value, DiagnosticStatus, from_attributes=True)
                at = f"at {status.stamp_ns / 1e9:.1f} s"  # the time of day is not in the bag
                journal.add_status(message.topic, owner[message.topic], status, at)
        return journal.entries.incidents

    def _methods(self) -> list[MethodSpan]:
        owner = {name: node for node, topics in self._launch.publishes.items() for name in topics}
        journal = RunJournal()
        for message in self._messages:
            if self._kind_of[message.topic] == _METHODS:
                used = msgspec.convert(message.value, MethodsUsed, from_attributes=True)
                journal.add_methods(owner[message.topic], used)
        return journal.entries.methods

    def _heard(self) -> set[str]:
        return {message.topic for message in self._messages}

    def _topic_of(self, kind: str) -> str:
        return next((name for name, one in self._kind_of.items() if one == kind), "")


@dataclasses.dataclass
class _Facts:
    """What the experiment's state would be."""

    row: int = 0
    phase: str = ""
    code: str = ""
    remount: int = -1
    trial: int = -1
    number: int = 0
    depth_m: float = 0.0
    true_ring_m: float | None = None
    true_height_m: float | None = None
    guards: list[str] = dataclasses.field(default_factory=list)
    ring_landed: bool = False
    last_ring_m: float = -1.0
    policy: str = ""
    next_policy: str = ""
    policy_changes: list[Any] = dataclasses.field(default_factory=list)
    touch_changed: bool = False
    enter_ns: int | None = None
    leave_ns: int | None = None


class _RecordBuilder:
    """Makes the rows again: follows what the experiment heard and said, and keeps what it kept."""

    def __init__(self, params: Mapping[str, Any]) -> None:
        self._policy, self._seed = str(params.get("policy", "")), int(params.get("seed", 0))
        self._facts = _Facts()
        self._palpation: Any = None
        self._belief: Any = None
        self._written: set[tuple[int, int]] = set()

    def feed(self, kind: str, value: Any) -> tuple[Row, Any] | None:
        """Take a message; return the row that it completes, and its palpation."""
        facts = self._facts
        match kind:
            case "Mount":
                facts.code = ""
            case "PhantomTruth":
                facts.code, facts.remount, facts.touch_changed = value.code, value.remount, True
                facts.depth_m, facts.true_height_m = value.depth_m, value.height_offset_m
            case "Trial":
                facts.trial, facts.number, facts.phase = value.trial, value.number, value.phase
            case "RingState":
                facts.ring_landed |= value.rehome
                facts.touch_changed |= not value.settled and facts.true_ring_m is None
            case "RingTruth":
                facts.touch_changed |= value.ring_m != facts.true_ring_m
                facts.true_ring_m = value.ring_m
            case "SweepGoal":
                if facts.touch_changed:  # what the sweep meets is told anew
                    facts.guards, facts.touch_changed = [], False
            case "SweepStatus" if value.status == "sweeping":
                facts.enter_ns, facts.leave_ns = value.enter_ns, value.leave_ns
            case "ContactGuard" if value.code == facts.code:
                facts.guards = list(value.words)
            case "Swap":
                facts.next_policy = policy_name(value.run)
            case "PolicyChange":
                facts.policy_changes.append(value)
            case "Palpation":
                self._palpation = value
            case "Belief":
                self._belief = value
        return self._row() if kind in ("Palpation", "Belief") else None

    def _row(self) -> tuple[Row, Any] | None:
        facts, palpation, belief = self._facts, self._palpation, self._belief
        if palpation is None or palpation.trial != facts.trial or facts.remount < 0:
            return None
        of = (palpation.trial, palpation.iteration)
        if facts.phase != "estimation":
            belief = None
        elif belief is None or (belief.trial, belief.iteration) != of:
            return None
        if of in self._written:  # a message that is in the bag twice
            return None
        apply_policy_changes(facts, palpation)
        row = row_of(facts, palpation, belief, policy=self._policy, seed=self._seed)
        self._written.add(of)
        facts.row += 1
        facts.ring_landed, facts.last_ring_m = False, palpation.ring_m
        facts.policy, facts.next_policy = facts.next_policy or facts.policy, ""
        self._palpation = self._belief = None
        return row, palpation


def _changes(bag: Bag) -> list[RunChange]:
    """Return what was changed of nodes, as launcher and nodes said before any damage."""
    names = [name for name in bag.topics() if name == GRAPH_EVENTS or name.endswith(f"/{EVENTS_PORT}")]
    journal = RunJournal()
    with contextlib.suppress(BagDamaged):
        for message in bag.messages(names) if names else ():
            journal.add_event(message.topic, message.value)
    return journal.entries.changes


def launch_of(bag: Bag) -> RunSummary:
    """Return what a bag says of the run that it holds, before it ended."""
    attached = bag.attachments().get(LAUNCH_ATTACHMENT)
    if attached is None:
        raise PalpError(
            f"{bag.path}: does not say of what run it is ({LAUNCH_ATTACHMENT} is missing): another tool or "
            "an earlier palp wrote it; record runs by palp launch FILE --record DIR or palp bag record -a"
        )
    try:
        return msgspec.json.decode(attached, type=RunSummary)
    except msgspec.MsgspecError as error:
        raise PalpError(f"{bag.path}: its {LAUNCH_ATTACHMENT} cannot be read: {error}") from error


def _roles(launch: RunSummary, path: Path) -> Roles:
    try:
        return roles_of(launch)
    except NoSession as error:
        raise PalpError(
            f"{path}: no bag of a session: graph '{launch.graph}' has no palpations and no methods to tell "
            f"of ({error.why}); what the bag holds says palp bag info {path}"
        ) from error
    except PalpError as error:
        raise PalpError(f"{path}: no bag of a session: {error}") from error


def _topics(launch: RunSummary, roles: Roles) -> dict[str, str]:
    """Return the type of each topic that tells of the session: what the experiment heard and said."""
    experiment = roles.node["experiment"]
    heard, found = set(launch.listens.get(experiment, ())), {}
    for node, topics in launch.publishes.items():
        for name, kind in topics.items():
            said = kind in _SAID and node == experiment
            if said or kind in (_DIAGNOSTIC, _METHODS) or (kind in _HEARD and name in heard):
                found[name] = kind
    return found
