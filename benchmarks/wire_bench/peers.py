"""Who is measured beside palp, in what form, and where each comes from."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from wire_bench.contenders import HERE, Outcome, run_palp, run_scripts

__all__ = ["DEFAULT", "PALP", "PEERS", "Contenders", "Peer", "contenders", "versions"]

PALP = "palp"
INSTALLED = "installed.txt"

Runner = Callable[..., Outcome]


@dataclass(frozen=True)
class Peer:
    """A contender whose two ends are a script.

    Attributes:
        about: What it is and in which form, in a line.
        script: Name of the script in this folder.
        packages: What it needs from the package index; none if it has all it needs here.
        arguments: Further arguments of the script.
        python: The version of Python that its wheels are for; empty if the present one is.
    """

    about: str
    script: str
    packages: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()
    python: str = ""


PEERS = {
    "raw": Peer(
        "pyzmq and msgpack, one frame without a topic, no receive timeout", "raw.py", arguments=("one",)
    ),
    "raw_timeout": Peer(
        "as raw, with a receive timeout on each socket that reads", "raw.py", arguments=("timeout",)
    ),
    "raw_three": Peer(
        "pyzmq, three frames (topic, header, array), no receive timeout", "raw.py", arguments=("three",)
    ),
    "zenoh": Peer(
        "zenoh, peers over a Unix socket, large arrays in shared memory",
        "zenoh_ends.py",
        ("eclipse-zenoh", "numpy"),
    ),
    "ros2": Peer(
        "ROS 2 (rclpy over Fast DDS, reliable, shared memory)",
        "ros2.py",
        ("ros-rclpy", "ros-rmw-fastrtps-cpp", "ros-sensor-msgs", "numpy"),
        python="3.11",
    ),
    "ezmsg": Peer("ezmsg, its low-level interface, shared memory", "ezmsg_ends.py", ("ezmsg", "numpy")),
    "iceoryx2": Peer(
        "iceoryx2, shared memory, its readers woken by events", "iceoryx2_ends.py", ("iceoryx2", "numpy")
    ),
}
DEFAULT = ("raw", "raw_timeout")


@dataclass(frozen=True)
class Contenders:
    """Who is measured.

    Attributes:
        runners: By name, palp first.
        left_out: Why each of the others is not.
    """

    runners: dict[str, Runner]
    left_out: dict[str, str]


def contenders(names: Iterable[str], cache: Path, say: Callable[[str], None]) -> Contenders:
    """Return palp and the peers of these names; one that cannot be installed is left out, with the reason.

    Args:
        names: Of ``PEERS``.
        cache: Folder of the peers' virtual environments, one each.
        say: Told what is installed, and who is left out.
    """
    found = Contenders({PALP: run_palp}, {})
    for name in dict.fromkeys(names):
        peer = PEERS[name]
        try:
            python = python_of(name, cache, say)
        except (OSError, RuntimeError) as error:
            found.left_out[name] = str(error)
            say(f"{name} is left out: {error}")
            continue
        script = HERE / peer.script
        found.runners[name] = partial(run_scripts, script, python=python, arguments=peer.arguments)
    return found


def python_of(name: str, cache: Path, say: Callable[[str], None]) -> str:
    """Return the Python that a peer runs with, its virtual environment made if it is not there.

    Raises:
        RuntimeError: It cannot be installed.
        OSError: The virtual environment cannot be made there.
    """
    peer, venv = PEERS[name], cache / name
    if not peer.packages:
        return sys.executable
    python = venv / "bin" / "python"
    if not (venv / INSTALLED).exists():
        say(f"installing {', '.join(peer.packages)} into {venv}")
        venv.parent.mkdir(parents=True, exist_ok=True)
        here = f"{sys.version_info.major}.{sys.version_info.minor}"
        base = sys.executable if peer.python in ("", here) else f"python{peer.python}"
        _done(base, "-m", "venv", str(venv))
        _done(str(python), "-m", "pip", "install", "--quiet", *peer.packages)
        (venv / INSTALLED).write_text(_done(str(python), "-m", "pip", "freeze"), encoding="utf-8")
    return str(python)


def _done(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines() or ["not a word"]
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {said[-1]}")
    return done.stdout


def versions(names: Iterable[str], cache: Path) -> dict[str, str]:
    """Return the version of each of these that was installed here."""
    found = {}
    for name in names:
        installed = cache / name / INSTALLED
        if name not in PEERS or not PEERS[name].packages or not installed.exists():
            continue
        first = PEERS[name].packages[0].lower()
        for line in installed.read_text(encoding="utf-8").splitlines():
            package, _, version = line.partition("==")
            if package.lower() == first:
                found[name] = version
    return found
