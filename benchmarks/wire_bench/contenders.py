"""Run one round of a contender in processes of its own, and read what it has found."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
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
    "ros2_python",
    "run_palp",
    "run_raw",
    "run_scripts",
]

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TEN = ROOT / "examples" / "chain" / "launch" / "ten.yaml"
PATIENCE_S = 60.0
ROS2 = ("ros-rclpy", "ros-rmw-fastrtps-cpp", "ros-sensor-msgs", "numpy")

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Outcome:
    """What one round of one contender has found.

    Attributes:
        latencies_s: Per stream phase of the plan, every reader's one-way latencies, pooled.
        trips_s: Per echo phase, the round trips.
        rates_hz: Per search phase, the highest lossless rate.
        lost: Messages of streams and echoes that did not arrive, over all readers.
    """

    latencies_s: dict[int, NDArray[np.float64]]
    trips_s: dict[int, NDArray[np.float64]]
    rates_hz: dict[int, float]
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
    """Return the command line's way of saying it."""
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
        lost += sum(phase.count - len(np.unique(rows[:, 0])) for rows in streams)
        if phase.kind == "stream":
            latencies[at] = np.concatenate([(rows[:, 2] - rows[:, 1]) / 1e9 for rows in streams])
        else:
            rows = _of_phase(times, at)
            trips[at] = (rows[:, 2] - rows[:, 1]) / 1e9
    return Outcome(latencies, trips, {int(at): float(rate_hz) for at, rate_hz in rates}, lost)


def _of_phase(rows: Rows, at: int) -> Rows:
    chosen: Rows = rows[(rows[:, 0] >> 32) == at << 8]
    return chosen


def run_palp(phases: list[Phase], readers: int = 1, profile: Path | None = None) -> Outcome:
    """Run a graph of real nodes, as a user does, and return its outcome.

    Args:
        phases: What to do.
        readers: One or five.
        profile: Folder for the nodes' profiles.

    Raises:
        RuntimeError: The graph failed.
    """
    with _folder(phases) as folder:
        launch = HERE / "launch" / ("edge.yaml" if readers == 1 else "fan.yaml")
        arguments = ["launch", launch, f"out:={folder}", *(["profile:=true"] if profile else [])]
        done = subprocess.run(
            palp_command(*arguments),
            env=environment(folder),
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"palp launch {launch.name} ended with {done.returncode}: {done.stderr}")
        for path in folder.glob("*.prof") if profile else ():
            path.rename(profile / path.name)  # type: ignore[operator]
        return _read(folder, phases, readers)


def run_raw(phases: list[Phase], readers: int = 1) -> Outcome:
    """Run raw pyzmq, and return its outcome.

    Raises:
        RuntimeError: One of its processes failed.
    """
    return run_scripts(HERE / "raw.py", phases, readers, python=sys.executable)


def ros2_python(venv: Path, say: Callable[[str], None]) -> str:
    """Return the Python of a virtual environment with rclpy, made if it is not there.

    Raises:
        RuntimeError: rclpy cannot be installed: it comes for Python 3.11 on PyPI.
    """
    python = venv / "bin" / "python"
    if not python.exists():
        say(f"installing {', '.join(ROS2)} into {venv}")
        version = sys.executable if sys.version_info[:2] == (3, 11) else "python3.11"
        for command in ([version, "-m", "venv", str(venv)], [str(python), "-m", "pip", "install", *ROS2]):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr}")
    return str(python)


def run_scripts(script: Path, phases: list[Phase], readers: int = 1, *, python: str) -> Outcome:
    """Run a contender whose two roles are a script.

    Raises:
        RuntimeError: One of its processes failed.
    """
    with _folder(phases) as folder, contextlib.ExitStack() as stack:
        roles = [("pitcher", 0), *(("catcher", number) for number in range(readers))]
        processes = []
        for role, number in roles:
            command = [python, str(script), role, str(folder), str(number), str(readers)]
            process = subprocess.Popen(command, env=environment(folder), stderr=subprocess.PIPE, text=True)
            processes.append(stack.enter_context(process))
            stack.callback(process.kill)
        for (role, _), process in zip(roles, processes, strict=True):
            _, said = process.communicate(timeout=PATIENCE_S)
            if process.returncode:
                raise RuntimeError(f"{script.name} {role} ended with {process.returncode}: {said}")
        return _read(folder, phases, readers)


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
