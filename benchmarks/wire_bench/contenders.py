"""Run one round of a contender in processes of its own, and read what it has found."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from wire_bench.plan import Phase, write_plan

__all__ = [
    "HERE",
    "Outcome",
    "environment",
    "first_message_s",
    "palp_command",
    "run_palp",
    "run_scripts",
]

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TEN = ROOT / "examples" / "chain" / "launch" / "ten.yaml"
PATIENCE_S = 180.0
GLANCE_S = 0.5

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Outcome:
    """What one round of one contender has found.

    Attributes:
        latencies_s: Per stream phase of the plan, every reader's one-way latencies, pooled.
        trips_s: Per phase of echoes or calls, the round trips.
        rates_hz: Per search phase, the highest lossless rate.
        cpu_s: Per phase that is not a search, CPU time (user and system) of all ends per message published.
        lost: Messages of all phases but searches that did not arrive, over all readers.
    """

    latencies_s: dict[int, NDArray[np.float64]]
    trips_s: dict[int, NDArray[np.float64]]
    rates_hz: dict[int, float]
    cpu_s: dict[int, float]
    lost: int


def environment(folder: Path) -> dict[str, str]:
    """Return the environment of the contenders: one BLAS thread, run directories of their own."""
    return {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "XDG_RUNTIME_DIR": str(folder),
        "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]),
    }


def palp_command(*arguments: object) -> list[str]:
    """Return a palp command line."""
    return [sys.executable, "-m", "palp_core", *map(str, arguments)]


@contextlib.contextmanager
def _folder(phases: list[Phase]) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="wires-", ignore_cleanup_errors=True) as name:
        write_plan(Path(name), phases)
        yield Path(name)


def _read(folder: Path, phases: list[Phase], readers: int) -> Outcome:
    latencies: dict[int, NDArray[np.float64]] = {}
    trips: dict[int, NDArray[np.float64]] = {}
    arrivals = [np.load(folder / f"arrivals{number}.npy") for number in range(readers)]
    times, rates, lost = np.load(folder / "trips.npy"), np.load(folder / "rates.npy"), 0
    for at, phase in enumerate(phases):
        if phase.kind == "search":
            continue
        streams = [_of_phase(rows, at) for rows in arrivals]
        if not all(len(rows) for rows in streams):
            raise RuntimeError(f"of phase {at} ({phase.kind} of {phase.size} bytes), a reader has no message")
        lost += sum(phase.count - len(np.unique(rows[:, 0])) for rows in streams)
        if phase.kind == "stream":
            latencies[at] = np.concatenate([(rows[:, 2] - rows[:, 1]) / 1e9 for rows in streams])
        else:
            rows = _of_phase(times, at)
            if not len(rows):
                raise RuntimeError(f"of phase {at} ({phase.kind} of {phase.size} bytes), no reply came back")
            trips[at] = (rows[:, 2] - rows[:, 1]) / 1e9
    used = {int(at): float(cpu_s) / phases[int(at)].count for at, cpu_s in np.load(folder / "cpu.npy")}
    return Outcome(latencies, trips, {int(at): float(rate_hz) for at, rate_hz in rates}, used, lost)


def _of_phase(rows: Rows, at: int) -> Rows:
    chosen: Rows = rows[(rows[:, 0] >> 32) == at << 8]
    return chosen


def run_palp(phases: list[Phase], readers: int = 1) -> Outcome:
    """Run a graph of real nodes, as a user does; it has one reader or five.

    Raises:
        RuntimeError: The graph failed.
    """
    with _folder(phases) as folder:
        launch = HERE / "launch" / ("edge.yaml" if readers == 1 else "fan.yaml")
        done = subprocess.run(
            palp_command("launch", launch, f"out:={folder}"),
            env=environment(folder),
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"palp launch {launch.name} ended with {done.returncode}: {done.stderr}")
        return _read(folder, phases, readers)


def run_scripts(script: Path, phases: list[Phase], readers: int = 1) -> Outcome:
    """Run a contender whose two roles are a script: ``pitcher|catcher FOLDER NUMBER READERS``.

    Raises:
        RuntimeError: One of its processes failed, or did not end.
    """
    with _folder(phases) as folder, contextlib.ExitStack() as stack:
        roles = [("pitcher", 0), *(("catcher", number) for number in range(readers))]
        running: dict[str, subprocess.Popen[bytes]] = {}
        for role, number in roles:
            command = [sys.executable, str(script), role, str(folder), str(number), str(readers)]
            output = stack.enter_context((folder / f"{role}{number}.output").open("wb"))
            process = subprocess.Popen(command, env=environment(folder), stdout=output, stderr=output)
            running[f"{role}{number}"] = stack.enter_context(process)
            stack.callback(process.kill)
        _await(script.stem, running, folder)
        return _read(folder, phases, readers)


def _await(name: str, running: dict[str, subprocess.Popen[bytes]], folder: Path) -> None:
    """Wait until all have ended; the first that fails ends the waiting, as the others would wait for it."""
    until_s = time.monotonic() + PATIENCE_S
    while running:
        for end, process in list(running.items()):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GLANCE_S)
                del running[end]
            if process.returncode or time.monotonic() > until_s:
                how = f"ended with {process.returncode}" if process.returncode else "did not end"
                output = (folder / f"{end}.output").read_text(encoding="utf-8", errors="replace")
                raise RuntimeError(f"{name} {end} {how}: {output[-2000:].strip()}")


def first_message_s() -> float:
    """Return the time from the command to the first message at the end of the chain of ten nodes.

    Raises:
        RuntimeError: The graph ended without one.
    """
    with tempfile.TemporaryDirectory(prefix="wires-", ignore_cleanup_errors=True) as name:
        out = Path(name) / "first.json"
        begin_ns = time.time_ns()  # the clock of the file's time of writing
        done = subprocess.run(
            palp_command("launch", TEN, "count:=1", f"out:={out}"),
            env=environment(Path(name)),
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        if done.returncode or not out.exists():
            raise RuntimeError(f"palp launch ten.yaml ended with {done.returncode}: {done.stderr}")
        return (out.stat().st_mtime_ns - begin_ns) / 1e9
