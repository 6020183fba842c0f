"""What launch/emulated.yaml costs: seconds of a core, by process and in a second of a steady run."""

from __future__ import annotations

import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from palp_core.graph.discovery.running_graph import RunningGraph

from .host import host_words  # noqa: TID252 -- neighbours, of a script and of a package

__all__ = ["cpu"]

ROOT = Path(__file__).resolve().parents[2]
HOST = "127.0.0.77"  # beside a rig that somebody else emulates
PATIENCE_S = 60.0
SETTLE_S = 2.0
PATIENT = {
    r"\n +realtime_priority: \d+": "",
    r"(stale_ms|beat_ms): {default: [\d.]+": r"\1: {default: 2000.0",
    r"answer_s: {default: [\d.]+": "answer_s: {default: 2.0",
}
"""Without real-time priorities, which would starve whoever else works here, the rig may not be as strict."""


def cpu(rounds: int, seconds: float, against: Path | None = None) -> dict[str, Any]:
    """Return what each process takes, a share of a core, in the median with the spread over the rounds.

    Args:
        rounds: How often each tree is measured, by turns.
        seconds: How long, once sweeps are under way.
        against: Another checkout, which is measured before this one in each round.
    """
    seen: dict[str, dict[str, list[float]]] = {}
    host = host_words()
    trees = {"before": against, "now": ROOT} if against else {"now": ROOT}
    for _ in range(rounds):
        for label, tree in trees.items():
            for name, share in _measured(tree or ROOT, seconds).items():
                seen.setdefault(name, defaultdict(list))[label].append(share)
    table = {
        name: {
            label: [round(f(shares[label]), 3) for f in (statistics.median, min, max)]
            for label in trees
            if shares[label]
        }
        for name, shares in sorted(seen.items(), key=lambda item: -max(map(max, item[1].values())))
    }
    return {"host": host, "rounds": rounds, "seconds": seconds, "share of a core: median, least, most": table}


def _measured(tree: Path, seconds: float) -> dict[str, float]:
    """Run a tree's rig without real-time priorities until it sweeps, and then for some seconds more."""
    with tempfile.TemporaryDirectory(prefix="palp-") as name:
        folder = Path(name)
        _workspace(tree, folder)
        environment = {
            **os.environ,
            "XDG_RUNTIME_DIR": str(folder),
            "PYTHONPATH": str(tree / "src"),
        }
        words = [
            sys.executable, "-m", "palp_core", "launch", "launch/emulated.yaml", f"host:={HOST}",
            f"out:={folder / 'out'}",
        ]  # fmt: skip
        with (folder / "said").open("w", encoding="utf-8") as out:
            launcher = subprocess.Popen(words, cwd=folder, env=environment, stdout=out, stderr=out)
        try:
            _until_swept(launcher, folder)
            graph = _found(launcher.pid, folder)
            nodes = {node.pid: node.name for node in graph.record.nodes}
            said, before, begin_s = _published(graph), _used_s(launcher.pid, nodes), time.monotonic()
            threading.Event().wait(seconds)
            after, took_s = _used_s(launcher.pid, nodes), time.monotonic() - begin_s
            rates = {f"{name} per s": n - said[name] for name, n in _published(graph).items()}
        finally:
            launcher.send_signal(signal.SIGINT)
            launcher.wait(PATIENCE_S)
        rows: dict[str, float] = defaultdict(float)
        for pid, (process, kind_s) in after.items():
            was = before.get(pid, (process, dict.fromkeys(kind_s, 0.0)))[1]
            for kind, used_s in kind_s.items():
                share = (used_s - was[kind]) / took_s
                rows[f"all, {kind}"] += share
                rows["all"] += share
                rows[process] += share
        return {**rows, **{name: count / took_s for name, count in rates.items()}}


def _workspace(tree: Path, folder: Path) -> None:
    """Lay a tree out, with its launch files as :data:`PATIENT` has them."""
    for link in ("nodes", "msgs"):
        (folder / link).symlink_to(tree / link)
    (folder / "launch" / "parts").mkdir(parents=True)
    for path in (tree / "launch").rglob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        for old, new in PATIENT.items():
            text = re.sub(old, new, text)
        (folder / path.relative_to(tree)).write_text(text, encoding="utf-8")


def _until_swept(launcher: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait until a sweep is on record, and a little more.

    Raises:
        RuntimeError: The graph ends before, or nothing comes.
    """
    pause, end_s = threading.Event(), time.monotonic() + PATIENCE_S
    while not any((folder / "out").glob("sweeps/*")):
        if launcher.poll() is not None or time.monotonic() > end_s:
            raise RuntimeError(f"no sweep; the graph said:\n{(folder / 'said').read_text(encoding='utf-8')}")
        pause.wait(0.1)
    pause.wait(SETTLE_S)


def _used_s(launcher: int, nodes: dict[int, str]) -> dict[int, tuple[str, dict[str, float]]]:
    """Return the name of each process of a graph and its user and system time in s."""
    found = {}
    for process in (psutil.Process(launcher), *psutil.Process(launcher).children(recursive=True)):
        with suppress(psutil.Error):
            times = process.cpu_times()
            name = "launcher" if process.pid == launcher else nodes.get(process.pid, "others")
            found[process.pid] = name, {"user": times.user, "system": times.system}
    return found


def _found(launcher: int, folder: Path) -> RunningGraph:
    before = os.environ.get("XDG_RUNTIME_DIR")
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    try:
        return RunningGraph.find(str(launcher))
    finally:
        del os.environ["XDG_RUNTIME_DIR"]
        if before is not None:
            os.environ["XDG_RUNTIME_DIR"] = before


def _published(graph: RunningGraph) -> dict[str, int]:
    published: dict[str, int] = graph.ask("torque", "info")["published"]
    return published
