"""What palp is compared with, and where each comes from."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from wire_bench.contenders import HERE, Outcome, run_palp, run_scripts

__all__ = ["INSTALLED", "PALP", "PEERS", "Peer", "Runner", "runners"]

PALP = "palp"
INSTALLED = "installed.txt"

Runner = Callable[..., Outcome]


@dataclass(frozen=True)
class Peer:
    """A contender whose two ends are a script.

    Attributes:
        script: Name of the script in this folder.
        packages: What it needs from the package index; none if it has all it needs here.
        python: The version of Python that its wheels are for; empty if the present one is.
    """

    script: str
    packages: tuple[str, ...] = ()
    python: str = ""


PEERS = {
    "raw": Peer("raw.py"),
    "ros2": Peer("ros2.py", ("ros-rclpy", "ros-rmw-fastrtps-cpp", "ros-sensor-msgs", "numpy"), python="3.11"),
}


def runners(names: Iterable[str], cache: Path, report: Callable[[str], None]) -> dict[str, Runner]:
    """Return palp and the peers of these names, each installed into a folder of ``cache`` if it must be.

    Raises:
        RuntimeError: A peer cannot be installed.
    """
    found: dict[str, Runner] = {PALP: run_palp}
    for name in dict.fromkeys(names):
        found[name] = partial(run_scripts, HERE / PEERS[name].script, python=python_of(name, cache, report))
    return found


def python_of(name: str, cache: Path, report: Callable[[str], None]) -> str:
    """Return the Python that a peer runs with, its virtual environment made if it is not there."""
    peer, venv = PEERS[name], cache / name
    if not peer.packages:
        return sys.executable
    python = venv / "bin" / "python"
    if not (venv / INSTALLED).exists():
        report(f"installing {', '.join(peer.packages)} into {venv}")
        venv.parent.mkdir(parents=True, exist_ok=True)
        here = f"{sys.version_info.major}.{sys.version_info.minor}"
        base = sys.executable if peer.python in ("", here) else f"python{peer.python}"
        _run(base, "-m", "venv", str(venv))
        _run(str(python), "-m", "pip", "install", "--quiet", *peer.packages)
        (venv / INSTALLED).write_text(_run(str(python), "-m", "pip", "freeze"), encoding="utf-8")
    return str(python)


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        output = (done.stderr or done.stdout).strip().splitlines() or ["no output"]
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {output[-1]}")
    return done.stdout
