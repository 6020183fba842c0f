"""How long the main job takes: `palp launch launch/sim.yaml --compose`, from the command to its end.

Each run is a command of its own, as a user gives it, with bytecode written (by a first short run, which is
not counted). Seconds of wall time, and of CPU of all its processes, median (least to most) over the rounds;
with ``--against``, another checkout's by turns in the same rounds, the ratio within each round, and whether
both leave the same `trials.csv`, sweeps and `primitives.json`.

Run: .venv/bin/python benchmarks/main_job.py [--rounds N] [--against OTHER/.venv/bin/palp] [--processes]
         [--start] [--json]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SHORT = ("trials:=1", "training:=1")
KEPT = ("trials.csv", "primitives.json", "sweeps/*.npz")
"""What is a function of launch file and seed."""


@dataclass(frozen=True)
class Turn:
    """A run of the command: its seconds, those of CPU of all its processes, and the digest of its results."""

    wall_s: float
    cpu_s: float
    digest: str


def digest(folder: Path) -> str:
    """Return the SHA-256 of what a run has kept, names and bytes."""
    found = hashlib.sha256()
    for file in sorted(file for pattern in KEPT for file in folder.glob(pattern)):
        found.update(f"{file.relative_to(folder)}\0{file.stat().st_size}\0".encode() + file.read_bytes())
    return found.hexdigest()


def take(palp: Path, folder: Path, words: list[str]) -> Turn:
    """Run the command once, where its checkout is.

    Raises:
        SystemExit: It fails.
    """
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
    out = folder / "out"
    command = [str(palp), "launch", "launch/sim.yaml", f"out:={out}", "overwrite:=true", *words]
    with (folder / "output.txt").open("wb") as output:
        begun_s = time.monotonic()
        process = subprocess.Popen(
            command,
            cwd=palp.parents[2],
            env=environment,
            stdout=output,
            stderr=output,
            stdin=subprocess.DEVNULL,
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.monotonic() - begun_s
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"{palp}: {(folder / 'output.txt').read_text(encoding='utf-8')}")
    return Turn(wall_s, usage.ru_utime + usage.ru_stime, digest(out))


def spread(values: list[float]) -> dict[str, float]:
    """Return the median, the least and the most."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def in_words(of: dict[str, float], digits: int = 1) -> str:
    """Write a median with its spread."""
    return f"{of['median']:.{digits}f} ({of['min']:.{digits}f} to {of['max']:.{digits}f})"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--against", type=Path, help="palp of another checkout, in its .venv/bin")
    parser.add_argument("--processes", action="store_true", help="each node a process of its own")
    parser.add_argument("--start", action="store_true", help="one palpation and one trial: start and report")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    options = parser.parse_args()
    rounds = options.rounds
    words = [
        *(() if options.processes else ("--compose",)),
        *(SHORT if options.start else ()),
    ]
    palps = {"here": Path(sys.executable).parent / "palp"}
    if options.against is not None:
        palps["against"] = options.against.absolute()
    turns: dict[str, list[Turn]] = {name: [] for name in palps}
    with tempfile.TemporaryDirectory(prefix="palp-main-job-") as base:
        folders = {name: Path(base) / name for name in palps}
        for name, palp in palps.items():
            folders[name].mkdir()
            take(palp, folders[name], [*words, *SHORT])
        for _ in range(rounds):
            for name, palp in palps.items():
                turns[name].append(take(palp, folders[name], words))
    found: dict[str, Any] = {
        name: {
            "wall_s": spread([turn.wall_s for turn in taken]),
            "cpu_s": spread([turn.cpu_s for turn in taken]),
        }
        for name, taken in turns.items()
    }
    digests = {turn.digest for taken in turns.values() for turn in taken}
    found["rounds"], found["same_bytes"] = rounds, len(digests) == 1
    if options.against is not None:
        pairs = list(zip(turns["against"], turns["here"], strict=True))
        found["times_as_fast"] = spread([theirs.wall_s / ours.wall_s for theirs, ours in pairs])
        found["cpu_ratio"] = spread([theirs.cpu_s / ours.cpu_s for theirs, ours in pairs])
    if options.json:
        print(json.dumps(found))
        return
    for name in palps:
        figures = found[name]
        print(f"{name}: {in_words(figures['wall_s'])} s, CPU {in_words(figures['cpu_s'])} s, {rounds} runs")
    if options.against is not None:
        print(
            f"{in_words(found['times_as_fast'], 2)} times as fast as {options.against}; "
            f"CPU {in_words(found['cpu_ratio'], 2)} times less"
        )
    print("the same bytes in every run" if found["same_bytes"] else "NOT THE SAME BYTES in all runs")


if __name__ == "__main__":
    main()
