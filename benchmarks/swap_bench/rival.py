"""The rival of the hot swap: ``dora node replace`` of dora-rs, under the same stream of 1 kHz.

A source numbers its messages, a relay passes them on and says who it is, a sink writes what it got and when.
The relay is replaced back and forth between two programs; the sink's file is then checked. A gap is from the
arrival of the last number of one relay to the first of the next (the stream's own 1 ms is part of it); the
command's time is that of the whole command ``dora node replace``, its start included. dora's processes are
the bench's own, on ports of their own, and end with it, however it ends.

dora is set up to lose least at a replacement: edges go by its direct path, its default; queues hold ten
seconds; a relay told to stop ends its process at once, since one that just leaves its loop hangs until it is
killed and slows the start of the next: ``--hanging`` measures that. The direct path drops messages on a busy
machine without any replacement; with ``--by-daemon`` (``queue_policy: backpressure``) edges do not.

Get dora: python3 -m venv /tmp/dora && /tmp/dora/bin/pip install dora-rs dora-rs-cli pyarrow
Run: .venv/bin/python benchmarks/swap_bench/rival.py --dora /tmp/dora/bin/dora [--swaps 20]
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress as Bar

HERE = Path(__file__).parent / "dora"
INSTALL = "python3 -m venv /tmp/dora && /tmp/dora/bin/pip install dora-rs dora-rs-cli pyarrow"
MARK = "SWAP_BENCH_FOLDER"  # in the environment of every process of a run, by which its guard finds them
FLOW = "swap_bench"
SETTLE_ROWS, BETWEEN_S, PATIENCE_S = 1000, 1.0, 30.0


def measure(swaps: int, dora: Path, by_daemon: bool = False, hanging: bool = False) -> dict[str, Any]:
    """Replace the relay so often while numbers go through it; return what the sink got.

    Args:
        swaps: How many replacements, at least one.
        dora: dora's executable, in a virtual environment that has dora-rs and pyarrow too.
        by_daemon: Edges go by dora's daemon, and not by its direct path, its default.
        hanging: A relay told to stop leaves its loop, and does not end its process itself.

    Returns:
        ``lost`` is of all ``sent``; ``lost_at_swaps`` are those between the numbers of two relays. With a
        replacement that dies at its start, in a run of its own: ``fault_refused`` is whether the command
        said that it failed, ``fault_survived`` whether numbers still arrive afterwards.

    Raises:
        RuntimeError: dora is not there, does not start or does not replace the node, with what it said.
    """
    version = _version(dora := dora.absolute())  # links are kept: the python beside it belongs to it
    with _running(dora, by_daemon, hanging) as graph:
        command_s = graph.swap(swaps)
        sent = graph.end_stream()
        found = judged(graph.rows(), sent, swaps)
    with _running(dora, by_daemon, hanging) as graph:
        refused, survived = graph.fault()
    return {
        "version": version,
        "swaps": swaps,
        **found,
        "command_p50_ms": float(np.median(command_s)) * 1e3,
        "fault_refused": refused,
        "fault_survived": survived,
        "note": f"edges {'by the daemon' if by_daemon else 'direct'}; relays told to stop "
        f"{'leave their loop' if hanging else 'end at once'}; by dora's help of `node replace`, inputs "
        "arriving during the brief swap window are dropped, not queued",
    }


def judged(rows: NDArray[np.int64], sent: int, swaps: int) -> dict[str, Any]:
    """Return what was lost, repeated and out of order, and the gaps.

    Args:
        rows: Number, maker (the first is 0) and time of arrival in ns, in the order of arrival, shape (n, 3).
        sent: How many numbers the source sent, from 0 on.
        swaps: How many makers followed the first.
    """
    index, maker, arrived_ns = rows.T
    unique, first = np.unique(index, return_index=True)
    missing = np.diff(unique) - 1
    by_maker = [arrived_ns[maker == number] for number in range(swaps + 1)]
    gaps_ms = [(new[0] - old[-1]) / 1e6 for old, new in itertools.pairwise(by_maker)]
    return {
        "sent": sent,
        "lost": sent - len(unique),
        "lost_at_swaps": int(missing[np.diff(maker[first]) != 0].sum()),
        "repeated": len(index) - len(unique),
        "reordered": int(np.count_nonzero(np.diff(index) < 0)),
        **{f"gap_p{at}_ms": float(np.percentile(gaps_ms, at)) for at in (50, 99)},
        "gap_max_ms": float(max(gaps_ms)),
    }


class Dora:
    """A coordinator, a daemon and the dataflow, with ports and a folder of their own.

    A step raises RuntimeError, with the ends of dora's logs, if it fails or has no effect in time.
    """

    def __init__(self, executable: Path, folder: Path, by_daemon: bool, hanging: bool) -> None:
        self._executable, self._folder = executable, folder
        self._processes: list[subprocess.Popen[bytes]] = []
        with socket.socket() as one, socket.socket() as other:
            for end in (one, other):
                end.bind(("127.0.0.1", 0))
            self._port, self._node_port = (str(end.getsockname()[1]) for end in (one, other))
        environment = {
            **os.environ,
            MARK: str(folder),
            "DORA_COORDINATOR_PORT": self._port,
            "PATH": f"{executable.parent}{os.pathsep}{os.environ.get('PATH', '')}",  # the nodes' python
            "HANGING": "1" if hanging else "",
        }
        self._options: Any = {"cwd": folder, "env": environment, "stdin": subprocess.DEVNULL}
        if by_daemon:
            flow, size = folder / "stream.yaml", "queue_size: 10000"
            flow.write_text(flow.read_text().replace(size, f"{size}, queue_policy: backpressure"))

    def start(self) -> None:
        """Start all, and wait until numbers arrive."""
        self._spawn("coordinator", "--store", "memory")
        self._spawn("daemon", "--local-listen-port", self._node_port, "--zenoh-no-multicast")
        self._until(lambda: not self._ask("status")[0], "the daemon did not come up")
        failed, said = self._ask("start", str(self._folder / "stream.yaml"), "--name", FLOW, "--detach")
        if failed:
            raise RuntimeError(f"dora start failed: {said}{self._logs()}")
        self._until(lambda: self._tail()[0] >= SETTLE_ROWS, "nothing came through the dataflow")

    def end(self) -> None:
        """End coordinator and daemon, politely if they let it; the guard ends nodes that are left."""
        self._ask("down", "--force")
        for process in self._processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(2.0)
            process.kill()
            process.wait()

    def swap(self, count: int) -> list[float]:
        """Replace the relay so often; return the commands' times in s."""
        command_s = []
        with Bar(console=Console(stderr=True), transient=True) as bar:
            for maker in bar.track(range(1, count + 1), description="dora node replace"):
                threading.Event().wait(BETWEEN_S)  # nothing comes: a rest between two swaps
                took_s, failed, said = self._replace(f"relay_{'ab'[maker % 2]}.py", maker)
                if failed:
                    raise RuntimeError(f"replacement {maker} of {count} failed: {said}{self._logs()}")
                command_s.append(took_s)
                heard = functools.partial(self._heard, maker)
                self._until(heard, f"replacement {maker} sent nothing; {said}")
        return command_s

    def fault(self) -> tuple[bool, bool]:
        """Replace the relay by one that dies; return whether that was refused, and whether numbers go on."""
        _, failed, _ = self._replace("relay_dies.py", 1)
        threading.Event().wait(3 * BETWEEN_S)  # nothing comes: what is under way arrives
        seen = self._tail()[0]
        threading.Event().wait(BETWEEN_S)
        return bool(failed), self._tail()[0] > seen

    def _replace(self, program: str, maker: int) -> tuple[float, int, str]:
        """Return the command's time in s, its exit code, and what it said."""
        nodes = yaml.safe_load((self._folder / "stream.yaml").read_text())["nodes"]
        relay = next(node for node in nodes if node["id"] == "relay")
        fresh = self._folder / "relay.yaml"
        fresh.write_text(yaml.safe_dump(relay | {"path": program, "env": {"MAKER": str(maker)}}))
        begun_ns = time.monotonic_ns()
        failed, said = self._ask("node", "replace", "-d", FLOW, "relay", "--from-yaml", str(fresh))
        return (time.monotonic_ns() - begun_ns) / 1e9, failed, said

    def rows(self) -> NDArray[np.int64]:
        """Return the sink's file: number, maker and time of arrival in ns, shape (n, 3)."""
        return np.fromfile(self._folder / "rows", dtype="<i8").reshape(-1, 3)

    def end_stream(self) -> int:
        """End the source, wait for what is under way, and return how many numbers were sent."""
        threading.Event().wait(BETWEEN_S)
        (self._folder / "end").touch()
        self._until((self._folder / "sent").exists, "the source did not end")
        sent, seen = int((self._folder / "sent").read_text()), -1
        while seen < (seen := self._tail()[0]) and self._tail()[1] < sent - 1:  # lost ones never come
            threading.Event().wait(BETWEEN_S)
        return sent

    def _spawn(self, part: str, *options: str) -> None:
        with (self._folder / f"{part}.log").open("wb") as log:
            own = {**self._options, "start_new_session": True}  # Ctrl-C is the bench's, which ends them
            command = [str(self._executable), part, *options]
            self._processes.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, **own))

    def _ask(self, *words: str) -> tuple[int, str]:
        try:
            command, how = [str(self._executable), *words], {**self._options, "capture_output": True}
            done = subprocess.run(command, text=True, timeout=PATIENCE_S, check=False, **how)
        except subprocess.TimeoutExpired:
            return -1, f"dora {' '.join(words)} did not end within {PATIENCE_S:g} s"
        return done.returncode, (done.stdout + done.stderr).strip()

    def _until(self, true: Callable[[], bool], otherwise: str) -> None:
        by_s = time.monotonic() + PATIENCE_S
        while not true():
            if time.monotonic() > by_s:
                raise RuntimeError(f"{otherwise} (waited {PATIENCE_S:g} s){self._logs()}")
            threading.Event().wait(0.02)

    def _tail(self) -> tuple[int, int, int]:
        """Return how many rows there are, and number and maker of the last one."""
        path = self._folder / "rows"
        if not (count := path.stat().st_size // 24 if path.exists() else 0):
            return 0, -1, -1
        row = np.fromfile(path, dtype="<i8", count=2, offset=(count - 1) * 24)
        return count, int(row[0]), int(row[1])

    def _heard(self, maker: int) -> bool:
        return self._tail()[2] >= maker

    def _logs(self) -> str:
        """Return the ends of dora's logs."""
        paths = [*self._folder.glob("*.log"), *self._folder.glob("out/*/log_*.jsonl")]
        return "".join(f"\n--- {path.name}\n{path.read_text(errors='replace')[-1500:]}" for path in paths)


def _version(dora: Path) -> str:
    """Return dora's version; refuse one that cannot run nodes in Python."""
    python = dora.with_name("python")
    if missing := [str(path) for path in (dora, python) if not path.exists()]:
        raise RuntimeError(f"{' and '.join(missing)} not there; install dora: {INSTALL}")
    command = [str(python), "-c", "import dora, pyarrow"]
    probe = subprocess.run(command, capture_output=True, text=True, check=False)
    if probe.returncode:
        raise RuntimeError(f"{python} lacks dora-rs or pyarrow: {probe.stderr.strip()}; install: {INSTALL}")
    return subprocess.run([str(dora), "--version"], capture_output=True, text=True, check=True).stdout.strip()


@contextlib.contextmanager
def _running(dora: Path, by_daemon: bool, hanging: bool) -> Iterator[Dora]:
    """Run the dataflow for a while, in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="swap-rival-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        shutil.copytree(HERE, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
        with _guard(folder):
            graph = Dora(dora, folder, by_daemon, hanging)
            try:
                graph.start()
                yield graph
            finally:
                graph.end()


@contextlib.contextmanager
def _guard(folder: Path) -> Iterator[None]:
    """Hold a process that kills all of the run's as soon as this block, or this very process, has ended."""
    command = [sys.executable, str(HERE.with_name("guard.py")), MARK, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True):
        yield


def main() -> None:
    """Measure and say what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--dora", type=Path, default=Path("/tmp/dora/bin/dora"), help=f"by: {INSTALL}")
    parser.add_argument("--swaps", type=int, default=20)
    parser.add_argument("--json", action="store_true", help="for machines")
    parser.add_argument("--by-daemon", action="store_true", help="edges not by dora's direct path")
    parser.add_argument("--hanging", action="store_true", help="relays told to stop just leave their loop")
    given = parser.parse_args()
    if given.swaps < 1:
        parser.error("--swaps: at least one")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        found = measure(given.swaps, given.dora, given.by_daemon, given.hanging)
    except RuntimeError as error:
        raise SystemExit(str(error)) from None
    if given.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:16} {value:.2f}" if isinstance(value, float) else f"{name:16} {value}")


if __name__ == "__main__":
    main()
