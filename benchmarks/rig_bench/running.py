"""Run ``launch/rig.yaml`` on emulated devices of this process: it sees what they are told, and when."""

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

from palp_core.devices.emulator import EmulatedRig, RigSettings
from palp_core.devices.emulator.axis import AxisSettings
from palp_core.devices.emulator.world import World, WorldSettings
from palp_core.errors import GraphError
from palp_core.launch.remote import RunningGraph

__all__ = ["LIFT_M", "RunningRig"]

ROOT = Path(__file__).resolve().parents[2]
LIFT_M = 0.005
FROM_M, TO_M = -0.015, 0.020
PATIENCE_S = 60.0


class RunningRig:
    """An experiment under way: devices in this process, the graph in processes of its own.

    Args:
        folder: For the launch file, the record and what the launcher says.
        arguments: Of the launch file, ``name:=value``.
        edit: Changes to the launch file's text, old to new.
        home_s: How long each axis takes to home.
        lenient: The drivers wait longer for an answer: a busy host is no fault.
    """

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        edit: dict[str, str] | None = None,
        home_s: float = 0.05,
        lenient: bool = False,
    ) -> None:
        self._lenient = lenient
        axis = AxisSettings(home_s=home_s)
        raised = AxisSettings(soft_low_m=-0.001, home_s=home_s, home_m=LIFT_M)
        world = WorldSettings(from_m=FROM_M - 0.002, to_m=TO_M + 0.002, y_axis=axis, z_axis=raised)
        self.emulated = EmulatedRig(
            RigSettings(world=world, stage_baud=0, maestro_baud=0),
            ("aerotech", "maestro", "ati", "noraxon"),
        )
        self.folder, self._arguments, self._edit = folder, arguments, edit or {}
        self.signalled_ns = 0
        self.running: RunningGraph | None = None

    def __enter__(self) -> Self:
        self.run_folder = Path(tempfile.mkdtemp(prefix="palp-"))  # short: a socket's path has 107 bytes
        self.emulated.start()
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

    @property
    def world(self) -> World:
        """The truth, and the log of the stage's controller."""
        return self.emulated.world

    def _launch(self) -> None:
        text = (ROOT / "launch" / "rig.yaml").read_text(encoding="utf-8")
        known, options = '"*"', self.emulated.options
        can, emg = options["ati"]["options"], options["noraxon"]
        stage, ring, verified = options["aerotech"]["url"], options["maestro"]["url"], f"verified: [{known}]"
        bus = f"{{host: {can['host']}, port: {can['port']}, tcp_tune: true}}"
        longer = ", stale_s: 3.0, timeout_s: 3.0" if self._lenient else ""
        slower = ", poll_hz: 10.0, timeout_s: 1.0" if self._lenient else ""
        addresses = {
            "socket://192.168.1.10:8001": self.emulated.stop_url,
            '{url: "socket://192.168.1.10:8000"}': f'{{url: "{stage}", {verified}{longer}}}',
            "{url: /dev/ttyACM0}": f"{{url: {ring}, {verified}{slower}}}",
            "{channel: can0, interface: socketcan}": (
                f"{{channel: can0, interface: socketcand, options: {bus}, {verified}}}"
            ),
            "{host: 192.168.1.20, port: 9220}": f"{{host: {emg['host']}, port: {emg['port']}, {verified}}}",
        }
        for old, new in {**addresses, **self._edit}.items():
            if old not in text:
                raise GraphError(f"launch/rig.yaml has no '{old}' to replace")
            text = text.replace(old, new)
        for name in ("nodes", "msgs"):
            (self.folder / name).symlink_to(ROOT / name)
        (self.folder / "launch").mkdir()
        launch_file = self.folder / "launch" / "rig.yaml"
        launch_file.write_text(text, encoding="utf-8")
        given = [f"from_m:={FROM_M}", f"to_m:={TO_M}", f"lift_mm:={LIFT_M * 1e3}"]
        environment = {
            **os.environ,
            "XDG_RUNTIME_DIR": str(self.run_folder),
            "PYTHONPATH": str(ROOT / "src"),
        }
        self._said = (self.folder / "launch.log").open("w", encoding="utf-8")
        self.process = subprocess.Popen(
            [
                sys.executable, "-m", "palp_core", "launch", str(launch_file), *given,
                f"out:={self.folder / 'out'}", *self._arguments,
            ],
            env=environment,
            stdout=self._said,
            stderr=self._said,
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
            self._said.close()
        self.emulated.stop()
        shutil.rmtree(self.run_folder, ignore_errors=True)

    def _continue_all(self) -> None:
        for pid in self.pids.values() if self.running is not None else ():
            with_pid(pid, signal.SIGCONT)

    # Looking

    def until(self, holds: Callable[[], Any], what: str) -> None:
        """Wait for something; the graph must live meanwhile.

        Raises:
            TimeoutError: It does not come, or the graph has ended.
        """
        pause, end_s = threading.Event(), time.monotonic() + PATIENCE_S
        while not holds():
            if time.monotonic() > end_s or self.process.poll() is not None:
                raise TimeoutError(f"no {what}; the graph said:\n{self.said}")
            pause.wait(0.002)

    @property
    def said(self) -> str:
        """What the launcher and the nodes have said."""
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
                self.running = RunningGraph.find()
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
        reply = self.graph.ask(node, "call", timeout_s=20.0, service=service, request=request)["reply"]
        return dict(reply)

    def safety(self) -> dict[str, Any]:
        """Return what the safety node says."""
        return self.call("safety", "status")

    def log(self, since_ns: int = 0) -> list[tuple[int, int, str]]:
        """Return what the stage's controller was told since a time: when, by which client, what."""
        entries: list[tuple[int, int, str]] = self.emulated.on_world(
            lambda world, _: [entry for entry in world.log if entry[0] >= since_ns]
        )
        return entries

    def sweeping(self) -> bool:
        """Tell whether the probe is down and moves at the speed of a sweep, well before its end."""

        def look(world: World, now_ns: int) -> bool:
            y, z = world.axes["y"], world.axes["z"]
            down = z.position_m(now_ns) < 1e-4
            return down and y.velocity_m_per_s(now_ns) > 0.019 and y.position_m(now_ns) < FROM_M + 0.010

        return bool(self.emulated.on_world(look))

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
            self.emulated.on_world(lambda world, _: world.mount(reply["code"], 0.0))
        return reply

    def sweep(self) -> None:
        """Wait until a sweep is under way."""
        self.until(self.sweeping, "sweep")

    def signal(self, node: str, number: signal.Signals) -> None:
        """Send a signal to a node's process and note when."""
        pid = self.pids[node]
        self.signalled_ns = time.monotonic_ns()
        os.kill(pid, number)

    def at_rest(self) -> bool:
        """Tell whether both axes are at rest."""
        return bool(
            self.emulated.on_world(lambda world, now: not any(a.moving(now) for a in world.axes.values()))
        )

    def stop_ms(self) -> float:
        """Return how long after the signal the last motion ended."""
        ends: list[int] = self.emulated.on_world(
            lambda world, _: [axis.rest_ns for axis in world.axes.values()]
        )
        return (max(ends) - self.signalled_ns) * 1e-6


def with_pid(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process that may have ended."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return
