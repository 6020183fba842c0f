"""Recorded sweeps of a session, from its folder or from a bag of its run, ready to be decided again."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import last_set
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.session.audit import left_out
from palp_core.palpation.session.bag_record import is_bag, read_record
from palp_core.palpation.session.method_choices import AUTO
from palp_core.palpation.session.roles import roles_of
from palp_core.palpation.session.run_note import read_note
from palp_core.palpation.session.session_folder import RUN, TABLE
from palp_core.palpation.session.trials_csv import Row, read_rows, read_sweep
from palp_core.units import Float64Array


@dataclass(frozen=True, eq=False)
class RecordedSweep:
    """A sweep and what is known of it."""

    phase: str  # ``training``, ``estimation``, or a condition of the plan ``repeatability``
    phantom: str
    trial: int
    iteration: int  # number of the sweep within it, from 1
    remount: int  # number of the mounting
    depth_m: float | None  # nodule's true depth; None where it is not known
    ring_m: float  # ring position as commanded
    torque_n_m: Float64Array  # as measured, shape (n,)
    rate_hz: float
    landed: bool = False  # whether the ring was moved or re-homed since the sweep before
    start_ns: int | None = None  # time of the first sample; None where it is not known, as for the two below
    enter_ns: int | None = (
        None  # when the stage would come over the path, as it reported when the sweep began
    )
    leave_ns: int | None = None  # when it would leave it


@dataclass(frozen=True, eq=False)
class RecordedSweeps:
    """A session's sweeps in their order."""

    path: Path
    sweeps: tuple[RecordedSweep, ...]
    # parameters of the node that made readings of them; empty where they are not known
    read_by: Mapping[str, Any] = field(default_factory=dict)

    def phase(self, name: str) -> list[RecordedSweep]:
        return [sweep for sweep in self.sweeps if sweep.phase == name]


def read_sessions(paths: Sequence[Path]) -> list[RecordedSweeps]:
    """Read sessions; a session given twice would make intervals too narrow."""
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
    """Read a session's folder (``trials.csv`` and ``sweeps/``) or a bag of a run."""
    if (path / TABLE).exists():
        decided = left_out(path)
        rows = [row for row in read_rows(path) if (row.phase, row.trial) not in decided]
        sweeps = tuple(_sweep(row, *read_sweep(path, row.row)) for row in rows)
        summary = read_note(path) if (path / RUN).exists() else None
    elif is_bag(path):
        found = read_record(path)
        sweeps = tuple(
            _sweep(row, palpation.torque_n_m, palpation.rate_hz)
            for row, palpation in zip(found.rows, found.palpations, strict=True)
        )
        summary = found.summary
    else:
        raise PalpError(f"{path}: neither a session's folder ({TABLE}) nor a bag (*.mcap)")
    if not sweeps:
        raise PalpError(f"{path}: holds no sweep")
    return RecordedSweeps(path, sweeps, _read_by(summary) if summary is not None else {})


def _sweep(row: Row, torque_n_m: Float64Array, rate_hz: float) -> RecordedSweep:
    return RecordedSweep(
        row.phase, row.phantom, row.trial, row.iteration, row.remount, row.depth_m, row.ring_m,
        torque_n_m, rate_hz, row.landed, row.start_ns, row.enter_ns, row.leave_ns,
    )  # fmt: skip


def _read_by(summary: RunSummary) -> dict[str, Any]:
    """Return the estimator's parameters as they were last, with the methods that the register chose."""
    roles = roles_of(summary)
    node = roles.node["estimator"]
    used = {one.use.task: one.use.name for one in summary.methods if one.node == node}
    params = roles.params("estimator") | last_set(summary.changes, node)
    return {name: used.get(name, value) if value == AUTO else value for name, value in params.items()}
