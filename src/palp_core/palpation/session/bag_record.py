"""The record of a session from a bag of its run: rows, sweeps and primitives as the experiment wrote them.

The experiment writes down what other nodes publish. The same messages are in the bag, and are followed here
in the order in which they were published: between processes a recorder may have received them in another.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.counted import counted
from palp_core.errors import BagDamaged, MechanicsError, PalpError, in_words
from palp_core.graph.bag.reader import Bag, BagMessage
from palp_core.graph.launch.run_journal import RunJournal
from palp_core.graph.launch.summary import RunSummary
from palp_core.graph.messages.builtin import DiagnosticStatus, MethodsUsed
from palp_core.graph.node.qos_events import EVENTS_PORT
from palp_core.graph.node.spec import GRAPH_EVENTS
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.trial_filter import classes_of
from palp_core.palpation.session.plan import policy_name
from palp_core.palpation.session.roles import GUARD, NoSession, Roles, roles_of
from palp_core.palpation.session.row_facts import RowFacts
from palp_core.palpation.session.session_folder import RUN, cannot_write, refuse_input, refuse_occupied
from palp_core.palpation.session.trials_csv import Row, SessionWriter, primitives_json
from palp_core.whole_file import write_json

_NAMED_BY = "--out"
_BY_EXPERIMENT = ("Trial", "SweepGoal", "Mount", "Progress", "Swap")
_TO_EXPERIMENT = (
    *("Belief", "Palpation", "PrimitivesLearnt", "RingState", "RingTruth", "PhantomTruth", "SweepStatus"),
    *("PolicyChange", GUARD),
)
_OF_ANY_NODE = ("DiagnosticStatus", "MethodsUsed")
_NEEDED = ("Palpation", "Trial", "SweepGoal", "Mount", "Progress", "RingState", "RingTruth", "PhantomTruth")
_NEEDED_IN_ESTIMATION = ("Belief", "PrimitivesLearnt")


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag, or one of its files, and no session's folder."""
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
    summary: RunSummary  # how the run went, as far as the bag has it
    rows: list[Row]
    palpations: list[Any]  # the message of each row, with its torque
    believed_m: Sequence[float]  # depths that the beliefs are about
    learnt: list[Any]  # messages of memory primitives


def read_record(path: Path) -> BagRecord:
    with Bag(path) as bag:
        launch = launch_of(bag)
        roles = _roles(launch, path)
        kind_of = _topics(launch, roles)
        messages, damage = _read(bag, list(kind_of))
        journal = _journal(bag, launch, kind_of, messages)
        recorded = bag.topics()
    by_kind: dict[str, list[Any]] = {}
    builder, made = _RecordBuilder(roles.params("experiment")), []
    for message in messages:
        kind = kind_of[message.topic]
        by_kind.setdefault(kind, []).append(message.value)
        if (pair := builder.feed(kind, message.value)) is not None:
            made.append(pair)
    present = {message.topic for message in messages}
    _refuse_lacking(path, kind_of, present, by_kind)
    if not made:
        raise PalpError(f"{path}: holds no palpation whose trial and phantom are in it, too")
    rows = [row for row, _ in made]
    ended = _why_unfinished(rows, by_kind, damage)
    clock_s = messages[-1].log_ns / 1e9
    summary = msgspec.structs.replace(
        launch,
        listens=_listens(launch, roles, kind_of, present, recorded),
        exit_code=-1 if ended else 0,
        ended=ended,
        clock_s=clock_s,
        wall_s=clock_s if launch.clock == "wall" else 0.0,
        activation_count=None,
        incidents=journal.entries.incidents,
        methods=journal.entries.methods,
        changes=journal.entries.changes,
    )
    palpations = [palpation for _, palpation in made]
    believed_m = _believed_m(roles.params("experiment"), by_kind)
    return BagRecord(summary, rows, palpations, believed_m, by_kind.get("PrimitivesLearnt", []))


def _read(bag: Bag, topics: Sequence[str]) -> tuple[list[BagMessage], str]:
    """Return the messages of topics in the order in which they were published, and how the bag is damaged."""
    messages: list[BagMessage] = []
    damage = ""
    try:
        for message in bag.messages(topics):
            messages.append(message)  # noqa: PERF402, what is before the damage is kept
    except BagDamaged as error:
        damage = str(error)
    return sorted(messages, key=lambda message: message.publish_ns), damage


def _journal(
    bag: Bag, launch: RunSummary, kind_of: Mapping[str, str], messages: Iterable[BagMessage]
) -> RunJournal:
    """Return what went wrong, which methods were used and what was changed of nodes."""
    owner = {name: node for node, topics in launch.publishes.items() for name in topics}
    journal = RunJournal()
    for message in messages:
        topic, kind = message.topic, kind_of[message.topic]
        if kind == "DiagnosticStatus":
            status = msgspec.convert(message.value, DiagnosticStatus, from_attributes=True)
            at = f"at {status.stamp_ns / 1e9:.1f} s"  # the time of day is not in the bag
            journal.add_status(topic, owner[topic], status, at)
        elif kind == "MethodsUsed":
            used = msgspec.convert(message.value, MethodsUsed, from_attributes=True)
            journal.add_methods(owner[topic], used)
    names = [name for name in bag.topics() if name == GRAPH_EVENTS or name.endswith(f"/{EVENTS_PORT}")]
    with contextlib.suppress(BagDamaged):
        for message in bag.messages(names) if names else ():
            journal.add_event(message.topic, message.value)
    return journal


def _refuse_lacking(
    path: Path, kind_of: Mapping[str, str], present: set[str], by_kind: Mapping[str, list[Any]]
) -> None:
    """Refuse a bag without a topic that a session cannot do without."""
    estimated = any(trial.phase == "estimation" for trial in by_kind.get("Trial", ()))
    needed = (*_NEEDED, *(_NEEDED_IN_ESTIMATION if estimated else ()))
    lacking = sorted(name for name, kind in kind_of.items() if kind in needed and name not in present)
    for name in lacking:
        if kind_of[name] == "Palpation":
            raise PalpError(f"{path}: no palpation: {name} is missing")
    if lacking:
        raise PalpError(
            f"{path}: nothing of {', '.join(lacking)} is in it, and without it there is no "
            "session; record the whole run: palp launch FILE --record DIR, or palp bag record -a"
        )


def _believed_m(params: Mapping[str, Any], by_kind: Mapping[str, list[Any]]) -> Sequence[float]:
    """Return the depths that the beliefs are about; before the first, those that the experiment has."""
    for belief in by_kind.get("Belief", ()):
        depths_m: list[float] = belief.depths_m.tolist()
        return depths_m
    try:
        phantoms = load_phantoms(params.get("phantoms", "")).values()
        taught_m = {phantom.bead.depth_m for phantom in phantoms if phantom.bead is not None}
    except MechanicsError:  # their file is not where it was
        taught_m = {truth.depth_m for truth in by_kind.get("PhantomTruth", ())}
    grid: list[float] = classes_of(sorted(taught_m), params.get("depths", 0)).tolist()
    return grid


def _why_unfinished(rows: Sequence[Row], by_kind: Mapping[str, list[Any]], damage: str) -> str:
    """Return why the bag does not hold the session to its end; "" if it does."""
    if not any(progress.phase == "done" for progress in by_kind.get("Progress", ())):
        return f"the bag is damaged: {damage}" if damage else "the bag ends before the session does"
    palpations: dict[tuple[str, int], int] = {}  # how many each trial has
    for row in rows:
        key = row.phase, row.trial
        palpations[key] = max(palpations.get(key, 0), row.iteration)
    trials = dict(sorted(palpations))  # of each phase the last one's number
    lacking = sum(palpations.values()) - len(rows) + sum(trials.values()) - len(palpations)
    lacking += "estimation" in trials and "training" not in trials  # which comes first
    if not lacking:
        return ""
    return (
        f"the bag lacks at least {counted(lacking, 'palpation')}: it begins later, or messages are missing, "
        "which `palp bag info` lists"
    )


def _listens(
    launch: RunSummary, roles: Roles, kind_of: Mapping[str, str], present: set[str], recorded: Iterable[str]
) -> dict[str, list[str]]:
    """Return what nodes read, without guards of which it is unknown whether they were recorded.

    A phantom that met nothing published no guard; another topic of it shows that its topics were recorded.
    """
    prefix = f"/{roles.node.get('phantom', '')}/"
    unknown = {name for name, kind in kind_of.items() if kind == GUARD} - present
    if any(name.startswith(prefix) and name not in kind_of for name in recorded):
        unknown = set()
    return {node: [name for name in names if name not in unknown] for node, names in launch.listens.items()}


class _RecordBuilder:
    """Makes the rows again: follows what the experiment received and published, and keeps what it kept."""

    def __init__(self, params: Mapping[str, Any]) -> None:
        self._policy, self._seed = str(params.get("policy", "")), int(params.get("seed", 0))
        self._facts = RowFacts()
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
                facts.remount = value.remount
                facts.note_phantom(value)
            case "Trial":
                facts.trial, facts.number, facts.phase = value.trial, value.number, value.phase
            case "RingState":
                facts.note_ring(value)
            case "RingTruth":
                facts.note_true_ring(value)
            case "SweepGoal":
                facts.begin_sweep()
            case "SweepStatus" if value.status == "sweeping":
                facts.note_sweeping(value)
            case "ContactGuard":
                facts.note_guard(value)
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
        self._written.add(of)
        row = facts.row_of(palpation, belief, policy=self._policy, seed=self._seed)
        facts.begin_next(palpation)
        self._palpation = self._belief = None
        return row, palpation


def launch_of(bag: Bag) -> RunSummary:
    """Return what a bag says of the run that it holds, before it ended."""
    attached = bag.attachments().get(LAUNCH_ATTACHMENT)
    if attached is None:
        raise PalpError(
            f"{bag.path}: {LAUNCH_ATTACHMENT} is missing (written by another tool?); "
            "record runs with palp launch FILE --record DIR or palp bag record -a"
        )
    try:
        return msgspec.json.decode(attached, type=RunSummary)
    except msgspec.MsgspecError as error:
        raise PalpError(f"{bag.path}: its {LAUNCH_ATTACHMENT} cannot be read: {in_words(error)}") from error


def _roles(launch: RunSummary, path: Path) -> Roles:
    try:
        return roles_of(launch)
    except NoSession as error:
        raise PalpError(
            f"{path}: not a session: graph '{launch.graph}' has no palpations and no methods "
            f"({error.why}); list its content with palp bag info {path}"
        ) from error
    except PalpError as error:
        raise PalpError(f"{path}: not a bag of a session: {error}") from error


def _topics(launch: RunSummary, roles: Roles) -> dict[str, str]:
    """Return the type of each topic of the session: what the experiment read and published."""
    experiment = roles.node["experiment"]
    read, found = set(launch.listens.get(experiment, ())), {}
    for node, topics in launch.publishes.items():
        for name, kind in topics.items():
            published = kind in _BY_EXPERIMENT and node == experiment
            if published or kind in _OF_ANY_NODE or (kind in _TO_EXPERIMENT and name in read):
                found[name] = kind
    return found
