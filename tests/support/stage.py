"""A running graph whose middle node is swapped, as its tests see it."""

import contextlib
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.messages.builtin import GraphEvent
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import PATIENCE_S, Palp, own_palp, wait_for_line
from tests.support.supervised import Running
from tests.support.swapping import workspace


class Stage(Running):
    """The running graph, and what its independent reader has to say."""

    def __init__(self, palp: Palp, launch: Path, *arguments: object) -> None:
        self.launch = launch
        self.launcher: subprocess.Popen[str] = palp.start("launch", launch, *arguments)
        wait_for_line(self.launcher, "numbers: 1/2")
        super().__init__(palp)
        record = (self.folder / "graph.json").read_bytes()
        self.graph = RunningGraph(msgspec.json.decode(record, type=RunRecord))
        self._past_count = 0

    def renew(self) -> bool:
        """Let all be as at the start for another test; return whether nothing is wrong with it."""
        if self.launcher.poll() is not None or self.judgement()[1]:
            return False
        info = self.graph.ask("relay", "info", timeout_s=PATIENCE_S)
        if (info["run"], info["file"], info["params"]) != ("swap_toys:Relay", "", {"gain": 1}):
            if "report" not in self.swap("Relay", gain=1):
                return False
            while self.judgement()[2][-1] != "Relay":
                self.wait_for_source()
        self.judgement(forget=True)
        self._past_count = len(super().events())
        return True

    def events(self) -> list[GraphEvent]:
        """What has happened since the test began."""
        return super().events()[self._past_count :]

    def patience_s(self) -> float:
        """How long a swap may take here and now, at the most: many times what one has taken."""
        return round(2.0 + 10.0 * float(self.swap("Relay")["report"]["duration_s"]), 3)

    def swap(self, run: str, *, timeout_s: float = PATIENCE_S, **params: Any) -> dict[str, Any]:
        """Swap the middle node; return the report, or what failed."""
        run = run if ":" in run else f"swap_toys:{run}"
        return self.graph.swap("relay", run, timeout_s=timeout_s, params=params)

    def judgement(self, *, forget: bool = False) -> tuple[int, str, list[str]]:
        """The reader's last number, what was wrong, and whose numbers they were: all since it forgot."""
        request = {"index": 0, "by": "forget" if forget else ""}
        reply = self.graph.ask("sink", "call", service="judge", request=request, timeout_s=PATIENCE_S)
        index, bad, makers = reply["reply"]["text"].split("|")
        return int(index), bad, makers.split(",")

    def passes(self, count: int) -> int:
        """Wait until so many more numbers have come through; return the last."""
        first = self.judgement()[0]
        while (last := self.judgement()[0]) < first + count:
            with pytest.raises(subprocess.TimeoutExpired):  # the graph has not ended
                self.launcher.wait(0.02)
        return last

    def wait_for_source(self) -> None:
        """Let a little time pass: until a message of the source arrives."""
        reader = SubscriberSocket({"/source/out": f"ipc://{self.folder}/source.pub"})
        try:
            while not any(parse(raw).kind == Kind.DATA for raw in reader.receive()):
                assert reader.wait(PATIENCE_S)
        finally:
            reader.close()


SLOW = ("rate_hz:=200.0", "calls_hz:=50.0")
"""What a graph that many tests share says: little, so that it costs little while they wait."""


class SharedStage:
    """One stage for tests that leave it whole, and another one behind a test that has not."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._palp = contextlib.ExitStack()
        self._made: list[Stage] = []

    @property
    def stage(self) -> Stage:
        """The latest one."""
        return self._made[-1]

    def renew(self) -> None:
        """Let the stage be as at its start."""
        if not self._made or not self.stage.renew():
            self.close()
            launch = workspace(self._folder / str(len(self._made))) / "wall.yaml"
            self._made.append(Stage(self._palp.enter_context(own_palp()), launch, *SLOW))

    def close(self) -> None:
        """End the graph."""
        self._palp.close()
