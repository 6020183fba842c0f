"""A trip of the emulated rig is in the launch view at once, and wherever else a person looks."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import DiagnosticStatus
from palp_core.graph.messages.frame import parse
from palp_core.graph.messages.message import decode
from tests.rig.test_emulated import EMULATED, LENIENT, SMALL, until
from tests.support.palp import PATIENCE_S, Palp

LONGEST_S = 0.5
"""From a trip to its line on the screen, as promised: the middle one of the tries."""

TRIES = 3
RED = re.compile(r"\x1b\[1;31m(\d\d:\d\d:\d\d /safety: tripped: operator: [^\x1b]*)")


class Screen:
    """A terminal on which a command shows what it has to show."""

    def __init__(self, command: list[str], environment: dict[str, str]) -> None:
        self.descriptor, slave = pty.openpty()
        self.said = ""
        self.process = subprocess.Popen(
            command, env={**environment, "TERM": "xterm"}, stdin=slave, stdout=slave, stderr=slave
        )
        os.close(slave)

    def until(self, so: Callable[[str], object], seconds: float = PATIENCE_S) -> int:
        """Read until what was said since the last mark is so; return when it was, and set the mark."""
        end_ns = monotonic_ns() + round(seconds * 1e9)
        while not so(self.said):
            assert monotonic_ns() < end_ns, self.said[-3000:]
            if select.select((self.descriptor,), (), (), 0.1)[0]:
                try:
                    self.said += os.read(self.descriptor, 1 << 16).decode(errors="replace")
                except OSError:
                    raise AssertionError(f"it has ended: {self.said[-3000:]}") from None
        self.said = ""
        return monotonic_ns()

    def rest(self) -> str:
        """Return what is said until the end."""
        said = self.said
        while True:
            try:
                said += os.read(self.descriptor, 1 << 16).decode(errors="replace")
            except OSError:
                self.process.wait()
                return said


@pytest.fixture
def screen(palp: Palp, tmp_path: Path) -> Iterator[Screen]:
    shown = Screen(palp.command("launch", EMULATED, f"out:={tmp_path}", *SMALL, *LENIENT), palp.environment)
    yield shown
    os.close(shown.descriptor)


def tripped_ns(graph: RunningGraph) -> int:
    """Return when the safety node tripped last, on this machine's clock."""
    clock = graph.ask("graph", "clock")
    reply = graph.ask("safety", "history", topic="/safety/diagnostics", first=1, last=2**62)
    status = decode(DiagnosticStatus, parse(reply["frames"][-1]).payload)
    return int(clock["monotonic_ns"] - clock["now_ns"] + status.stamp_ns)


@pytest.mark.nightly
def test_a_trip_is_on_the_screen_within_half_a_second_and_in_top_and_doctor(
    palp: Palp, screen: Screen, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    screen.until(lambda said: re.search(r"training +\S+ +[1-9]", re.sub(r"\x1b\[[0-9;]*m", "", said)))
    graph = RunningGraph.find()
    took_s = []
    for _ in range(TRIES):
        graph.ask("safety", "call", service="stop", request={"reason": "a test"})
        seen_ns = screen.until(RED.search)
        took_s.append((seen_ns - tripped_ns(graph)) / 1e9)
        assert until(lambda: graph.ask("safety", "call", service="acknowledge", request={})["reply"]["done"])
        screen.until(lambda said: "training" in said and not RED.search(said.rpartition("training")[2]))
    assert palp.run("stop").returncode == 0
    screen.until(RED.search)
    top = palp.run("top", "--once").stdout.splitlines()
    assert top[0].startswith("/safety: tripped: operator: palp stop")
    assert next(line for line in top if line.startswith("/safety ")).split()[1] == "ERROR"
    assert json.loads(palp.run("top", "--json").stdout)["diagnostics"][0]["level"] == "error"
    doctor = palp.run("doctor")
    assert doctor.returncode == 1
    assert re.match(r"ERROR +/safety: tripped: operator: palp stop", doctor.stdout)
    screen.process.send_signal(signal.SIGINT)
    *_, trip, way_on = [line for line in screen.rest().splitlines() if line.strip()]
    assert re.search(r"/safety: tripped: operator: palp stop \(until the end\)", trip)
    assert way_on.startswith("to resume: palp launch")
    incidents = json.loads((tmp_path / "result.json").read_text())["incidents"]
    assert len(incidents) == TRIES + 1
    assert (
        "/safety: tripped: operator: palp stop</strong>\nuntil the end"
        in (tmp_path / "report.html").read_text()
    )
    assert sorted(took_s)[TRIES // 2] <= LONGEST_S, took_s
