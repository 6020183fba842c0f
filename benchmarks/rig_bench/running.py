"""Run ``launch/rig.yaml`` on emulated devices: what they received, and when."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import psutil

from palp_core.errors import GraphError
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.palpation.devices.emulator import RigSettings
from palp_core.palpation.devices.emulator.axis import AxisSettings
from palp_core.palpation.devices.emulator.contact import ContactSettings

from .emulator import PRIORITY, EmulatorProcess  # noqa: TID252 -- neighbours, of a script and of a package

__all__ = ["FORK_SERVER", "GUARD_OF", "LAUNCHER", "LIFT_M", "RunningRig"]

ROOT = Path(__file__).resolve().parents[2]
LIFT_M = 0.005
FROM_M, TO_M = -0.015, 0.020
PATIENCE_S = 60.0
LAUNCHER, FORK_SERVER = "launcher", "fork server"
GUARD_OF = "guard of "
LAUNCH_FILES = ("rig.yaml", "parts/devices.yaml", "parts/experiment.yaml")
SHEET = """\
lab: bench
operator: B1
subject: none
ethics: none
phantoms:
  A: &phantom {id: emulated, batch: none, cured: 2026-01-01, cure_temperature_c: 23.0}
  B: *phantom
  C: *phantom
sensor: {serial: emulated, bias_n_m: 0.0}
"""
DEVICES = ("aerotech", "maestro", "ati", "noraxon")


class StageInTruth:
    """The emulated stage itself: what its controller received, and how it is.

    Args:
        emulator: Whose stage it is.
    """

    def __init__(self, emulator: EmulatorProcess) -> None:
        self._emulator = emulator

    def log(self, since_ns: int = 0) -> list[tuple[int, int, str]]:
        """Return what the controller received since a time: when, by which client, what."""
        return [(when, client, line) for when, client, line in self._emulator.ask(f"log {since_ns}")]

    def aborts(self, since_ns: int = 0) -> list[int]:
        """Return when an ABORT arrived."""
        return [stamp_ns for stamp_ns, _, line in self.log(since_ns) if line.startswith("ABORT")]

    def axes(self) -> dict[str, Any]:
        """Return how the axes are."""
        axes: dict[str, Any] = self._emulator.ask("axes")
        return axes

    def at_rest(self) -> bool:
        """Return whether both axes are at rest."""
        axes = self.axes()
        return not any(axes[name]["moving"] for name in ("y", "z"))

    def enabled(self) -> bool:
        """Return whether an axis is enabled."""
        axes = self.axes()
        return any(axes[name]["enabled"] for name in ("y", "z"))


class RunningRig:
    """An experiment under way: the devices in a process of their own, the graph's nodes in theirs.

    Args:
        folder: For the launch file, the record and what the launcher says.
        arguments: Of the launch file, ``name:=value``.
        edit: Changes to the text of the launch file and of what it includes, old to new.
        home_s: How long each axis takes to home.
        single_line: The stage on one RS-232 of 115200 bit/s, moved in segments of 2 mm; none for safety.
        sweep_m_per_s: Speed of a sweep.
        return_m_per_s: Speed of the way back.
        patience_s: Longest wait of :meth:`until`.
        poll_s: From one look of :meth:`until` to the next.
    """

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        edit: dict[str, str] | None = None,
        home_s: float = 0.05,
        single_line: bool = False,
        sweep_m_per_s: float = 0.020,
        return_m_per_s: float = 0.050,
        patience_s: float = PATIENCE_S,
        poll_s: float = 0.002,
    ) -> None:
        axis = AxisSettings(home_s=home_s)
        raised = AxisSettings(soft_low_m=-0.001, home_s=home_s, home_m=LIFT_M)
        contact = ContactSettings(from_m=FROM_M - 0.002, to_m=TO_M + 0.002)
        self._single, self._patience_s, self._poll_s = single_line, patience_s, poll_s
        self._sweep_m_per_s, self._return_m_per_s = sweep_m_per_s, return_m_per_s
        self._settings = RigSettings(
            contact=contact, y_axis=axis, z_axis=raised, stage_serial=single_line, maestro_baud=0
        )
        self.folder, self._arguments, self._edit = folder, arguments, edit or {}
        self.signalled_ns = 0
        self.running: RunningGraph | None = None

    def __enter__(self) -> Self:
        self.run_folder = Path(tempfile.mkdtemp(prefix="palp-"))  # short: a socket's path has 107 bytes
        self.emulator = EmulatorProcess(*DEVICES, settings=self._settings, priority=PRIORITY)
        self.stage = StageInTruth(self.emulator)
        try:
            self._launch()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _launch(self) -> None:
        texts = {name: (ROOT / "launch" / name).read_text(encoding="utf-8") for name in LAUNCH_FILES}
        options = self.emulator.options
        can, emg = options["ati"]["options"], options["noraxon"]
        stage, ring, verified = options["aerotech"]["url"], options["maestro"]["url"], 'verified: ["*"]'
        stop_link = "none" if self._single else self.emulator.ask("stop-link")
        segments = ", segment_m: 0.002, poll_hz: 100.0" if self._single else ""
        back = f"return_speed_m_per_s: {self._return_m_per_s}"
        bus = f"{{host: {can['host']}, port: {can['port']}, tcp_tune: true}}"
        addresses = {
            "socket://192.168.1.10:8001": f'"{stop_link}"',
            '{url: "socket://192.168.1.10:8000",': f'{{url: "{stage}", {verified}{segments}, {back},',
            "{url: /dev/ttyACM0,": f"{{url: {ring}, {verified},",
            "{channel: can0, interface: socketcan}": (
                f"{{channel: can0, interface: socketcand, options: {bus}, {verified}}}"
            ),
            "{host: 192.168.1.20, port: 9220}": f"{{host: {emg['host']}, port: {emg['port']}, {verified}}}",
        }
        for old, new in {**addresses, **self._edit}.items():
            if not any(old in text for text in texts.values()):
                raise GraphError(f"launch/rig.yaml and what it includes have no '{old}' to replace")
            texts = {name: text.replace(old, new) for name, text in texts.items()}
        for name in ("nodes", "msgs"):
            (self.folder / name).symlink_to(ROOT / name)
        (self.folder / "launch" / "parts").mkdir(parents=True)
        for name, text in texts.items():
            (self.folder / "launch" / name).write_text(text, encoding="utf-8")
        launch_file, sheet = self.folder / "launch" / "rig.yaml", self.folder / "sheet.yaml"
        sheet.write_text(SHEET, encoding="utf-8")
        path = {
            "from_m": FROM_M,
            "to_m": TO_M,
            "lift_mm": LIFT_M * 1e3,
            "sweep_speed_m_s": self._sweep_m_per_s,
        }
        given = [f"shared.{name}:={value}" for name, value in path.items()]
        environment = {
            **os.environ,
            "XDG_RUNTIME_DIR": str(self.run_folder),
            "PYTHONPATH": str(ROOT / "src"),
        }
        self._log = (self.folder / "launch.log").open("w", encoding="utf-8")
        self.process = subprocess.Popen(
            [
                sys.executable, "-m", "palp_core", "launch", str(launch_file), *given,
                f"out:={self.folder / 'out'}", f"session:={sheet}", *self._arguments,
            ],
            env=environment,
            stdout=self._log,
            stderr=self._log,
            cwd=self.folder,
        )  # fmt: skip

    def _end(self) -> None:
        if hasattr(self, "process"):
            if self.process.poll() is None:
                self._continue_all()
                self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(20.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self._log.close()
        self.emulator.close()
        shutil.rmtree(self.run_folder, ignore_errors=True)

    def _continue_all(self) -> None:
        with_pid(self.process.pid, signal.SIGCONT)
        for pid in self.pids.values() if self.running is not None else ():
            with_pid(pid, signal.SIGCONT)

    # Looking

    def until(self, holds: Callable[[], Any], what: str, *, ended_ok: bool = False) -> None:
        """Wait for something; unless ``ended_ok`` the graph must live meanwhile.

        Raises:
            TimeoutError: It does not come, or the graph has ended.
        """
        pause, end_s = threading.Event(), time.monotonic() + self._patience_s
        while not holds():
            if time.monotonic() > end_s or (self.process.poll() is not None and not ended_ok):
                raise TimeoutError(f"no {what}; the graph printed:\n{self.output}")
            pause.wait(self._poll_s)

    @property
    def output(self) -> str:
        """What the launcher and the nodes have printed."""
        logs = sorted(self.run_folder.glob("palp/*/log/merged.log"))
        return "".join(
            path.read_text(encoding="utf-8") for path in [self.folder / "launch.log", *logs] if path.exists()
        )

    @property
    def graph(self) -> RunningGraph:
        """The running graph."""
        if self.running is None:
            before = os.environ.get("XDG_RUNTIME_DIR")
            os.environ["XDG_RUNTIME_DIR"] = str(self.run_folder)
            try:
                self.running = RunningGraph.find(str(self.process.pid))
            finally:
                if before is None:
                    del os.environ["XDG_RUNTIME_DIR"]
                else:
                    os.environ["XDG_RUNTIME_DIR"] = before
        return self.running

    @property
    def pids(self) -> dict[str, int]:
        """Process of every node."""
        return {node.name: node.pid for node in self.graph.record.nodes}

    def call(self, node: str, service: str, **request: Any) -> dict[str, Any]:
        """Call a service of a node; return its reply."""
        reply = self.graph.ask(node, "call", timeout_s=60.0, service=service, request=request)["reply"]
        return dict(reply)

    def safety(self) -> dict[str, Any]:
        """Return what the safety node says."""
        return self.call("safety", "status")

    def sweeping(self) -> bool:
        """Return whether the probe is down and moves at the speed of a sweep, well inside of it."""
        axes = self.stage.axes()
        y, down = axes["y"], axes["z"]["position_m"] < 1e-4
        fast = y["velocity_m_per_s"] > 0.95 * self._sweep_m_per_s
        return bool(down and fast and FROM_M < y["position_m"] < FROM_M + 0.010)

    # Doing

    def put_on(self) -> None:
        """Put on the phantom that is asked for."""
        self.until(self._started, "graph")
        self.until(lambda: self._mounted()["done"], "question for a phantom")

    def _started(self) -> bool:
        try:
            return bool(self.graph.record.nodes) and all(self.pids.values())
        except GraphError:
            self.running = None
            return False

    def _mounted(self) -> dict[str, Any]:
        try:
            reply = self.call("phantom", "mounted")
        except GraphError:
            return {"done": False}
        if reply["done"]:
            self.emulator.send(f"mount {reply['code']}")
        return reply

    def sweep(self) -> None:
        """Wait until a sweep is under way."""
        self.until(self.sweeping, "sweep")

    def signal(self, number: signal.Signals, *who: str) -> None:
        """Send a signal to processes, all at once, and note when."""
        pids = [self.process_of(name) for name in who]
        self.signalled_ns = time.monotonic_ns()
        for pid in pids:
            os.kill(pid, number)

    def process_of(self, name: str) -> int:
        """Return the process of a node, of the guard of a node's link, the launcher, or the fork server."""
        if name == LAUNCHER:
            return self.process.pid
        if name == FORK_SERVER:
            return psutil.Process(self.pids["stage"]).ppid()
        if name.startswith(GUARD_OF):
            (guard,) = psutil.Process(self.pids[name.removeprefix(GUARD_OF)]).children()
            return guard.pid
        return self.pids[name]

    def stop_ms(self) -> float:
        """Return how long after the signal the last motion ended."""
        axes = self.stage.axes()
        return float((max(axes[name]["rest_ns"] for name in ("y", "z")) - self.signalled_ns) * 1e-6)


def with_pid(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process that may have ended."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return
