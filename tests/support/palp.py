"""Run ``palp`` as a user does, and find every process that it leaves behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import psutil
import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.transport import reorder_buffer
from tests.support.warm_start import MARK, SCRIPT, ForkedPopen, fork_servers_too

fork_servers_too()

ROOT = Path(__file__).parents[2]
CHAIN = ROOT / "examples/chain/launch/chain.yaml"
SIM = ROOT / "launch/sim.yaml"
PATIENCE_S = 240.0
"""How long a test waits for what is to come: an upper bound, for a machine that others use too."""

FOREVER_NS = 10**18
"""What palp is to wait where a test holds that it need not."""

MOST_SHOWN = 4000
"""Characters of each log that a failure shows."""

QUICK = {
    *("action", "node", "topic", "param", "lifecycle", "service", "swap", "logs", "interface"),
    *("doctor", "top"),
    *(("graph", verb) for verb in ("list", "end")),
    *(("bag", verb) for verb in ("info", "recover", "diff", "replay", "snapshot")),
}
"""Verbs that run in the test's own process: to start another takes longer than they do."""


IMPATIENT = """
import importlib, json, sys
for place, value in json.loads(sys.argv.pop(1)).items():
    module, _, name = place.partition(":")
    setattr(importlib.import_module(module), name, value)
from palp_core.__main__ import main
main()
"""


class Palp:
    """The command line in an environment of its own, whose processes carry a mark."""

    def __init__(self, runtime_dir: Path) -> None:
        self._started: list[subprocess.Popen[str]] = []
        self.mark = uuid.uuid4().hex
        self.constants: dict[str, object] = {}
        """Other values for what palp waits by, ``module:NAME``: in the process of the command itself."""
        self.runtime_dir = runtime_dir
        self._inherited = dict(os.environ)
        self.environment = {
            **self._inherited,
            "XDG_RUNTIME_DIR": str(runtime_dir),
            MARK: self.mark,
            "PYTHONUNBUFFERED": "1",
            "PYTHONPATH": str(ROOT / "src"),
            "COLUMNS": "200",
        }

    def command(self, *arguments: object) -> list[str]:
        way = ("-c", IMPATIENT, json.dumps(self.constants)) if self.constants else (SCRIPT,)
        return [sys.executable, *way, *map(str, arguments)]

    def run(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        if QUICK & {arguments[0], arguments[:2]}:
            return self.here(*arguments)
        process = self._popen(*arguments)
        try:
            output, errors = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
        return subprocess.CompletedProcess(process.args, process.returncode, output, errors)

    def here(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run a verb in this process."""
        with pytest.MonkeyPatch.context() as patch:
            for name, value in self.environment.items() - self._inherited.items():
                patch.setenv(name, value)
            patch.setattr(reorder_buffer, "FILL_NS", reorder_buffer.FILL_NS)  # a toy sets another
            with own_workspace():
                done = CliRunner().invoke(app, [str(word) for word in arguments], prog_name="palp")
        if done.exception is not None and not isinstance(done.exception, PalpError | SystemExit):
            raise done.exception
        refused = isinstance(done.exception, PalpError)
        errors = done.stderr + (f"{done.exception}\n" if refused else "")
        return subprocess.CompletedProcess([], 2 if refused else done.exit_code, done.stdout, errors)

    def printed(self, *arguments: object) -> str:
        """Run a verb, which succeeds; return what it prints."""
        launches = arguments[0] == "launch" and "--compose" not in arguments
        done = self.here(*arguments) if launches else self.run(*arguments)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def refused(self, *arguments: object) -> str:
        """Run a verb in this process, which ends with status 2; return its error."""
        done = self.here(*arguments)
        assert done.returncode == 2, (done.stdout, done.stderr)
        assert "Traceback" not in done.stderr
        return done.stderr

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        process = self._popen(*arguments)
        self._started.append(process)
        return process

    def _popen(self, *arguments: object) -> subprocess.Popen[str]:
        popen = subprocess.Popen if self.constants else ForkedPopen
        return popen(
            self.command(*arguments),
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def output(self) -> str:
        """What its graphs have logged, and what the processes it has started printed since they were read."""
        parts = []
        for file in sorted(self.runtime_dir.glob("palp/*/log/*")):
            with contextlib.suppress(OSError):  # its run has just been cleared away
                parts.append(f"{file.name}:\n{file.read_text(errors='replace')[-MOST_SHOWN:]}")
        for started in self._started:
            how = "runs" if started.poll() is None else f"ended with {started.returncode}"
            parts.append(f"{' '.join(cast('list[str]', started.args))}: {how}")
            for pipe in (started.stdout, started.stderr):
                if pipe is not None and not pipe.closed:
                    os.set_blocking(pipe.fileno(), False)
                    with contextlib.suppress(BlockingIOError):
                        parts.append(os.read(pipe.fileno(), 1 << 20).decode(errors="replace")[-MOST_SHOWN:])
                    os.set_blocking(pipe.fileno(), True)  # other tests of the file may go on reading
        return "\n".join(parts)

    def close(self) -> None:
        """Leave nothing behind, whatever the test did."""
        for process in self.processes():
            with contextlib.suppress(psutil.Error):
                process.kill()
        for started in self._started:
            started.wait()
            for pipe in (started.stdout, started.stderr):
                if pipe is not None:
                    pipe.close()

    def processes(self) -> list[psutil.Process]:
        """Every living process that carries the mark."""
        found, mark = [], f"{MARK}={self.mark}\0".encode()
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError, psutil.Error):  # a zombie has no environment any more
                if mark in (process / "environ").read_bytes():
                    found.append(psutil.Process(int(process.name)))
        return found

    def running(self, word: str) -> list[psutil.Process]:
        """Those in whose command there is that word."""
        found = []
        for process in self.processes():
            with contextlib.suppress(psutil.Error):  # it may be gone by now
                if any(word in part for part in process.cmdline()):
                    found.append(process)
        return found

    def all_gone(self, within_s: float = PATIENCE_S) -> bool:
        """Wait for the end of every marked process; return whether it came in time."""
        end_ns = monotonic_ns() + round(within_s * 1e9)
        alive: list[psutil.Process] = []
        while alive := [process for process in alive if _lives(process)] or self.processes():
            if monotonic_ns() > end_ns:
                return False
            psutil.wait_procs(alive, timeout=0.02)
        return True


@contextlib.contextmanager
def own_workspace() -> Iterator[None]:
    """Let a workspace's modules be imported here, and forget them: another has some of the same names."""
    kept, path = dict(sys.modules), list(sys.path)
    for name in kept:
        if name.partition(".")[0] in ("msgs", "nodes"):
            del sys.modules[name]
    try:
        yield
    finally:
        for name, module in list(sys.modules.items()):
            file = getattr(module, "__file__", None) or ""
            if name not in kept and not file.startswith((str(ROOT / "src"), sys.prefix, sys.base_prefix)):
                del sys.modules[name]
        sys.modules.update(kept)
        sys.path[:] = path


def _lives(process: psutil.Process) -> bool:
    """Tell whether a process works still: a zombie that init has yet to reap counts as gone."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


def wait_for_line(process: subprocess.Popen[str], start: str) -> None:
    """Read what a process says until a line begins like that."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(start):
            return
    raise AssertionError(f"ended before '{start}': {process.stderr.read() if process.stderr else ''}")


def wait_for_error(process: subprocess.Popen[str], words: str) -> str:
    """Read what a process prints on standard error until a line has these words; return it."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if words in line:
            return line
    raise AssertionError(f"ended without '{words}' but: {''.join(lines)}")


def end(process: subprocess.Popen[str], number: signal.Signals = signal.SIGINT) -> str:
    """Let a signal end a command, with its status; return what it printed on standard error."""
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + number, errors
    return errors


def finished(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for a process; return its status and what it printed."""
    output, errors = process.communicate(timeout=PATIENCE_S)
    return process.returncode, output + errors


@contextlib.contextmanager
def own_palp() -> Iterator[Palp]:
    """The command line with a runtime folder of its own."""
    with short_folder() as runtime, contextlib.closing(Palp(runtime)) as command:
        yield command


@contextlib.contextmanager
def short_folder() -> Iterator[Path]:
    """A folder whose path is short enough for those of sockets in it, which pytest's own is not."""
    with tempfile.TemporaryDirectory(prefix="palp-", dir="/tmp", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


@pytest.fixture
def palp() -> Iterator[Palp]:
    with own_palp() as command:
        yield command


@pytest.fixture(scope="module")
def shared_palp() -> Iterator[Palp]:
    """For what the tests of a file have in common."""
    with own_palp() as command:
        yield command
