"""What an install costs: seconds, what is downloaded, what it takes on disk, and how long commands wait.

``python benchmarks/install.py`` builds the wheel and makes a clean environment for every Python that is asked
for and every extra, with the network; ``--rounds`` says how often a command is timed; the median counts.
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("", "view")
COMMANDS = {
    "import palp_core": ("python", "-c", "import palp_core"),
    "a node's imports": ("python", "-c", "from palp_core import Node, Pub, Sub, every, on"),
    "palp --help": ("palp", "--help"),
    "palp topic list": ("palp", "topic", "list"),
}
FIRST = ("palp", "launch", "rig:sim.yaml", "trials:=1", "training:=1", "--compose")
"""The first palpations."""

MEGABYTE = 1e6


def build(folder: Path) -> Path:
    """Build the wheel; return it."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--wheel-dir",
        str(folder),
        str(ROOT),
    ]
    subprocess.run(command, check=True)
    return next(folder.glob("*.whl"))


def tree_mb(folder: Path) -> float:
    """Return what a folder takes, in MB."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()) / MEGABYTE


def downloaded_mb(output: str) -> float:
    """Return what pip says that it has downloaded, in MB; a wheel from a folder counts as it is there."""
    units = {"bytes": 1e-6, "kB": 1e-3, "MB": 1.0, "GB": 1e3}
    sizes = re.findall(r"Downloading [^\n(]+\(([\d.]+) (bytes|kB|MB|GB)\)", output)
    files = [Path(name) for name in re.findall(r"^Processing (/\S+\.whl)", output, flags=re.MULTILINE)]
    here_mb = sum(file.stat().st_size / MEGABYTE for file in files)
    return sum(float(size) * units[unit] for size, unit in sizes) + here_mb


def install(python: str, wheel: Path, extra: str, folder: Path) -> tuple[float, float, float]:
    """Install into a clean environment, with an empty cache.

    Returns:
        Seconds, MB downloaded, palp's own wheel with it, MB on disk beyond an empty environment.
    """
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    before_mb = tree_mb(folder)
    wanted = f"palp-core[{extra}] @ {wheel.as_uri()}" if extra else str(wheel)
    report = folder / "report.txt"
    begin_s = perf_counter()
    with report.open("w") as output:
        subprocess.run(
            [str(folder / "bin/pip"), "install", "--no-cache-dir", "--disable-pip-version-check", wanted],
            check=True, stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
    seconds = perf_counter() - begin_s
    return seconds, downloaded_mb(report.read_text()), tree_mb(folder) - before_mb


def timed(folder: Path, command: tuple[str, ...], rounds: int, at: Path) -> list[float]:
    """Return the seconds of a command, each round; a first one is not counted: it writes compiled files."""
    words = [str(folder / "bin" / command[0]), *command[1:]]
    found = []
    for _ in range(rounds + 1):
        begin_s = perf_counter()
        subprocess.run(words, check=False, capture_output=True, cwd=at)
        found.append(perf_counter() - begin_s)
    return found[1:]


def first_run(folder: Path, at: Path) -> float:
    """Return the seconds of the first run after an install."""
    begin_s = perf_counter()
    subprocess.run([str(folder / "bin/palp"), *FIRST[1:]], check=True, capture_output=True, cwd=at)
    return perf_counter() - begin_s


def main() -> None:
    """Install, time, print a table per Python."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pythons", default=sys.executable, help="interpreters, with commas between")
    parser.add_argument("--extras", nargs="*", default=EXTRAS, help="each an install; '': no extra")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--wheel", type=Path, help="an own wheel; default: it is built")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = given.wheel or build(folder)
        for python in given.pythons.split(","):
            version = subprocess.run(
                [python, "-V"], capture_output=True, text=True, check=True
            ).stdout.strip()
            print(f"\n{version}, {os.cpu_count()} cores, wheel of {wheel.stat().st_size / MEGABYTE:.1f} MB")
            print(
                "| install | s | MB downloaded | MB on disk | first run, s | " + " | ".join(COMMANDS) + " |"
            )
            print("|" + "---|" * (5 + len(COMMANDS)))
            for extra in given.extras:
                at = folder / "at"
                at.mkdir()
                cost = install(python, wheel, extra, folder / "venv")
                first_s = first_run(folder / "venv", at)
                waits = [timed(folder / "venv", command, given.rounds, at) for command in COMMANDS.values()]
                shown = [f"{cost[0]:.0f}", f"{cost[1]:.0f}", f"{cost[2]:.0f}", f"{first_s:.1f}"]
                shown += [
                    f"{statistics.median(one):.2f} s ({min(one):.2f} to {max(one):.2f})" for one in waits
                ]
                print(f"| `palp-core{f'[{extra}]' if extra else ''}` | {' | '.join(shown)} |", flush=True)
                shutil.rmtree(at)
                shutil.rmtree(folder / "venv")


if __name__ == "__main__":
    main()
