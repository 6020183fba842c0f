"""The simulated rig: a small session, run once for all who only read it, and runs without another process."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import msgspec
import pytest

from palp_core.graph.description.check import load
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspect_classes
from palp_core.graph.launch import graph
from palp_core.graph.launch.checking import check_in, succeed
from palp_core.graph.launch.graph import Graph
from palp_core.graph.launch.summary import RunSummary
from tests.support.palp import SIM, Palp, own_palp
from tests.support.sessions import no_charts

MINUTE_S, MOMENT_S = 60.0, 0.5


@dataclasses.dataclass(frozen=True)
class RigSession:
    """Two trials a phantom after two training sweeps a setting, policy ``markov``; only to be read."""

    folder: Path

    @property
    def out(self) -> Path:
        """The record: trials.csv, sweeps, result.json, report."""
        return self.folder / "out"

    @property
    def bag(self) -> Path:
        return self.folder / "bag"

    @property
    def digest(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "digest.json").read_text()))

    @property
    def result(self) -> dict[str, Any]:
        return dict(json.loads((self.out / "result.json").read_text()))

    def run(self, palp: Palp, folder: Path, *extra: object) -> RigSession:
        """Run it again, for another folder; it is written where the first was: that is an argument."""
        written = self.folder / "written"
        folder.mkdir(parents=True, exist_ok=True)
        small = ("trials:=2", "training:=2", "seed:=1", "policy:=markov", f"out:={written}")
        done = palp.run("launch", SIM, *small, "--digest", folder / "digest.json", *extra)
        assert done.returncode == 0, done.stderr
        written.rename(folder / "out")
        return RigSession(folder)


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers of a run have in common."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session")
def rig_session(shared_folder: Path) -> RigSession:
    """The session, made by the first worker that wants it."""
    session = RigSession(shared_folder / "rig-session")
    with (shared_folder / "rig-session.lock").open("w") as lock, own_palp() as palp:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not session.out.exists():
            session.folder.mkdir()
            session.run(palp, session.folder, "--compose", "--record", session.bag)
    return session


def check_here(path: str | Path, overrides: Sequence[str] = ()) -> CheckedGraph:
    """Check a launch file as :func:`.check_file` does; its workspace is one that this process may import."""
    return load(Path(path), overrides, inspect_classes, succeed)


class _NoServer:
    """In a fork server's place: looks at node classes here."""

    def __init__(self, *_: object) -> None: ...

    def inspect_classes(
        self, requests: Sequence[NodeClassRequest], workspace: Path, **_: object
    ) -> list[NodeClass]:
        return inspect_classes(requests, workspace)

    def close(self) -> None: ...


class BriefGraph(Graph):
    """A graph without what a short session takes longest for, and which other tests look at.

    The charts of its report are empty, and the simulated subject palpates for a moment, not for a minute. Who
    looks at charts has :func:`rig_session`, which is a user's run.
    """

    def __enter__(self) -> Self:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(graph, "check_in", _checked_briefly)
            return super().__enter__()

    def run(self, until_s: float | None = None) -> RunSummary:
        with no_charts():
            return super().run(until_s)

    def __exit__(self, *error: Any) -> None:
        with no_charts():  # a run that was cut short has its report made here
            super().__exit__(*error)


class ComposedGraph(BriefGraph):
    """A brief graph whose nodes are all in this process, where their classes are looked at, too.

    Its workspace is on the path of this process until its end.
    """

    def __init__(self, path: str | Path, **given: Any) -> None:
        super().__init__(path, compose=True, **given)
        self._path = list(sys.path)

    def __enter__(self) -> Self:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(graph, "ForkServer", _NoServer)
            return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        sys.path[:] = self._path


def _checked_briefly(*given: Any, **more: Any) -> CheckedGraph:
    """Check a launch file, and let a subject palpate for a moment."""
    checked = check_in(*given, **more)
    nodes = [
        msgspec.structs.replace(spec, params={**spec.params, "palpation_s": MOMENT_S})
        if spec.params.get("palpation_s") == MINUTE_S
        else spec
        for spec in checked.nodes
    ]
    return msgspec.structs.replace(checked, nodes=nodes)
