"""Recorded sweeps of a session, from its folder or from a bag of its run, ready to be decided again."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.launch.summary import RunSummary
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.palpation.session.audit import left_out
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from palp_core.units import Float64Array
from palp_core.whole_file import read_whole

_NEEDED = ("Mount", "Trial", "Palpation")  # types of messages; what their topics are called is the graph's
_TOLD = ("RingState", "PhantomTruth", "SweepStatus")


@dataclass(frozen=True, eq=False)
class RecordedSweep:
    """A sweep and what is known of it.

    Attributes:
        phase: ``training``, ``estimation``, or a condition of the plan ``repeatability``.
        phantom: Code of the phantom.
        trial: Number of its trial.
        iteration: Number of the sweep within it, from 1.
        remount: Number of the mounting.
        depth_m: Nodule's true depth; None where nobody told.
        ring_m: Ring position as commanded.
        torque_n_m: As measured, shape (n,).
        rate_hz: Sampling rate.
        landed: Whether the ring was moved or re-homed since the sweep before; None where nobody told.
        start_ns: Time of the first sample; None where nobody told, as for the two below.
        enter_ns: When the stage would come over the path, as it said when the sweep began.
        leave_ns: When it would leave it.
    """

    phase: str
    phantom: str
    trial: int
    iteration: int
    remount: int
    depth_m: float | None
    ring_m: float
    torque_n_m: Float64Array
    rate_hz: float
    landed: bool | None = None
    start_ns: int | None = None
    enter_ns: int | None = None
    leave_ns: int | None = None


@dataclass(frozen=True, eq=False)
class RecordedSweeps:
    """A session's sweeps in their order.

    Attributes:
        path: Its folder or bag.
        sweeps: Every sweep.
        ring_moves_each_time: Whether the ring was homed before every palpation; None where nobody told.
        read_by: Parameters of the node that made readings of them; empty where nobody told.
    """

    path: Path
    sweeps: tuple[RecordedSweep, ...]
    ring_moves_each_time: bool | None = None
    read_by: Mapping[str, Any] = field(default_factory=dict)

    def phase(self, name: str) -> list[RecordedSweep]:
        """Return the sweeps of a phase."""
        return [sweep for sweep in self.sweeps if sweep.phase == name]


def read_sessions(paths: Sequence[Path]) -> list[RecordedSweeps]:
    """Read sessions, each its own: one that counts twice makes intervals too narrow.

    Raises:
        PalpError: One is named twice, also as folder and bag, or cannot be read.
        BagError: A bag cannot be read.
    """
    places = [path.resolve() for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise PalpError(f"{path}: named twice; a session counts once")
    sessions = [read_sweeps(path) for path in paths]
    seen: dict[bytes, Path] = {}
    for session in sessions:
        other = seen.setdefault(_fingerprint(session), session.path)
        if other is not session.path:
            raise PalpError(f"{session.path}: holds the sweeps of {other}; a session counts once")
    return sessions


def _fingerprint(session: RecordedSweeps) -> bytes:
    """Return what two copies of a session have in common: every sample of every sweep."""
    digest = hashlib.sha256()
    for sweep in session.sweeps:
        digest.update(np.ascontiguousarray(sweep.torque_n_m, dtype=np.float64).tobytes())
    return digest.digest()


def read_sweeps(path: Path) -> RecordedSweeps:
    """Read a session's folder (``trials.csv`` and ``sweeps/``) or a bag of a run.

    Raises:
        PalpError: It is neither, or holds no sweep.
        BagError: The bag cannot be read.
    """
    if (path / "trials.csv").exists():
        sweeps, each, read_by = tuple(_of_record(path)), _rehomes(path), _read_by(path)
    elif path.suffix == ".mcap" or any(path.glob("*.mcap")):
        sweeps, each, read_by = tuple(_of_bag(path)), None, _read_by_of_bag(path)
    else:
        raise PalpError(f"{path}: neither a session's folder (trials.csv) nor a bag (*.mcap)")
    if not sweeps:
        raise PalpError(f"{path}: holds no sweep")
    return RecordedSweeps(path, sweeps, each, read_by)


def _of_record(folder: Path) -> Iterator[RecordedSweep]:
    decided = left_out(folder)
    for row in read_rows(folder):
        if (row.phase, row.trial) in decided:
            continue
        torque_n_m, rate_hz = read_sweep(folder, row.row)
        yield RecordedSweep(
            row.phase, row.phantom, row.trial, row.iteration, row.remount, row.depth_m, row.ring_m,
            torque_n_m, rate_hz, row.landed, row.start_ns, row.enter_ns, row.leave_ns,
        )  # fmt: skip


def _rehomes(folder: Path) -> bool | None:
    try:
        result = json.loads(read_whole(folder / "result.json"))
        said = [node["rehome"]["value"] for node in result["protocol"].values() if "rehome" in node]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return said == ["palpation"] if said else None


def _read_by(folder: Path) -> dict[str, Any]:
    try:
        result = json.loads(read_whole(folder / "result.json"))
        node = result["roles"]["estimator"]
        said = {name: one["value"] for name, one in result["protocol"][node].items()}
        used = {one["task"]: one["method"] for one in result.get("methods", ()) if one["node"] == node}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return _as_chosen(said, used)


def _read_by_of_bag(path: Path) -> dict[str, Any]:
    with Bag(path) as bag:
        attached = bag.attachments().get(LAUNCH_ATTACHMENT)
        try:
            roles = roles_of(msgspec.json.decode(attached or b"", type=RunSummary))
        except (msgspec.MsgspecError, PalpError):  # another tool wrote it, or it is of part of a rig
            return {}
        topic = f"/{roles.node.get('estimator', '')}/methods"
        told = bag.messages([topic]) if topic in bag.topics() else ()
        used = {use.task: use.name for message in told for use in message.value.uses}
    return _as_chosen(roles.params("estimator"), used)


def _as_chosen(params: Mapping[str, Any], used: Mapping[str, str]) -> dict[str, Any]:
    """Return parameters with the methods that were used where they left one to the register."""
    return {name: used.get(name, value) if value == AUTO else value for name, value in params.items()}


def _of_bag(path: Path) -> Iterator[RecordedSweep]:
    """Yield the bag's sweeps; a phantom's depth is what was recorded of it, else what training told."""
    with Bag(path) as bag:
        type_of = _topics(path, {name: topic.type for name, topic in bag.topics().items()})
        messages = list(bag.messages(list(type_of)))  # as recorded: a mount follows its last sweep
    told = "RingState" in type_of.values()
    depths: dict[str, float] = {}
    code, remount, trial = "", -1, None
    homed, ring_m = False, -1.0
    over: tuple[int | None, int | None] = (None, None)
    for message in messages:
        value: Any = message.value
        match type_of[message.topic]:
            case "Mount":
                code, remount = value.code, value.remount
            case "Trial":
                trial = value
                if value.label_known:
                    depths[code] = value.depth_m
            case "PhantomTruth":
                depths[value.code] = value.depth_m
            case "RingState":
                homed = homed or value.rehome
            case "SweepStatus" if value.status == "sweeping":
                over = (value.enter_ns, value.leave_ns)
            case "Palpation" if trial is not None and value.trial == trial.trial:
                landed = (homed or value.ring_m != ring_m) if told else None
                homed, ring_m = False, value.ring_m
                yield RecordedSweep(
                    trial.phase, code, trial.number, value.iteration, remount, depths.get(code), value.ring_m,
                    value.torque_n_m, value.rate_hz, landed, value.start_ns, *over,
                )  # fmt: skip


def _topics(path: Path, types: dict[str, str]) -> dict[str, str]:
    """Return type by topic of those that a session is read from.

    Raises:
        PalpError: One is missing, or there are two of a type.
    """
    found = {name: kind for name, kind in types.items() if kind in (*_NEEDED, *_TOLD)}
    missing = [kind for kind in _NEEDED if kind not in found.values()]
    if missing:
        raise PalpError(
            f"{path}: has no topic of {', '.join(missing)}; "
            "record the whole run: palp launch FILE --record DIR"
        )
    for kind in set(found.values()):
        alike = sorted(name for name, one in found.items() if one == kind)
        if len(alike) > 1:
            raise PalpError(
                f"{path}: {' and '.join(alike)} are both of {kind}, and a session has one; write a bag "
                "without the other: palp bag filter"
            )
    return found
