"""``palp bridge foxglove`` before a graph of processes, as a viewer that knows only the protocol meets it."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from palp_core.extras import install_line
from palp_core.graph.discovery.running_graph import RunningGraph
from tests.graph.foxglove.viewer import viewing
from tests.support.palp import PATIENCE_S, Palp, own_palp, wait_for_line
from tests.support.supervised import write_files

NODES = '''
from palp_core import DiagnosticStatus, Message, Node, Params, Progress, Pub, Qos, Srv, State, Sub
from palp_core import every, on, serve
from palp_core.units import Count, Float64Array, HertzPositive, Nanoseconds
import numpy as np
import select


class Block(Message):
    """A block of samples."""
    stamp_ns: Nanoseconds
    index: Count
    torque_n_m: Float64Array


class TareRequest(Message):
    """Take this for nothing."""
    offset_n_m: float = 0.0


class TareReply(Message):
    """What is taken for nothing now."""
    offset_n_m: float


class SensorParams(Params):
    rate_hz: HertzPositive = 50.0
    size: Count = 5
    fail: bool = False
    options: dict = {}


class Counted(State):
    index: int = 0
    offset_n_m: float = 0.0


class Sensor(Node):
    params: SensorParams
    state: Counted
    block = Pub(Block)
    progress = Pub(Progress)
    alarm = Pub(DiagnosticStatus, qos=Qos(durability="transient_local", depth=1))
    tare = Srv(TareRequest, TareReply)

    def on_activate(self):
        self.alarm.publish(DiagnosticStatus(stamp_ns=0, level="warn", text="it is warm", advice="wait"))

    @every("rate_hz")
    def read(self):
        if self.params.fail:
            raise ValueError("the sensor has come off")
        self.state.index += 1
        torque_n_m = np.arange(self.params.size) - self.state.offset_n_m
        self.block.publish(Block(stamp_ns=self.now_ns(), index=self.state.index, torque_n_m=torque_n_m))
        self.progress.publish(
            Progress(stamp_ns=0, phase="blocks", done_count=self.state.index, total_count=10**9)
        )

    @serve(tare)
    def zero(self, request):
        self.state.offset_n_m = request.offset_n_m
        return TareReply(offset_n_m=request.offset_n_m)


class Reader(Node):
    moves = True
    params: Params
    block = Sub(Block)

    @on(block)
    def take(self, block):
        pass


class Pace(Node):
    """Let simulated time run no faster than this."""

    params: Params
    block = Sub(Block)

    @on(block)
    def hold(self, block):
        select.select((), (), (), 0.005)
'''
LAUNCH = """
graph: bench
clock: wall
nodes:
  sensor:
    run: nodes.bench:Sensor
    params: {options: {url: "socket://", wait: {s: [0.5, null]}}}
    restart: {when: on_failure, max_restarts: 5, backoff_s: 0.05}
  reader: {run: "nodes.bench:Reader", inputs: {block: sensor/block}}
"""
LOCKSTEP = """
graph: lockstep
clock: sim
nodes:
  sensor: {run: "nodes.bench:Sensor"}
  pace: {run: "nodes.bench:Pace", inputs: {block: sensor/block}}
"""


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    files = {"nodes/bench.py": NODES, "bench.yaml": LAUNCH, "lockstep.yaml": LOCKSTEP}
    write_files(folder, {"nodes/__init__.py": "", **files})
    return folder


@pytest.fixture(scope="module")
def bench(workspace: Path) -> Iterator[Palp]:
    """A graph on the wall clock: a sensor that can be tared and made to fail; its reader moves something."""
    with own_palp() as palp:
        wait_for_line(palp.start("launch", workspace / "bench.yaml"), "blocks: 1/")
        yield palp


@contextlib.contextmanager
def serving(palp: Palp, *arguments: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run ``palp bridge foxglove``; yield the line that it prints, and its process."""
    process = palp.start("bridge", "foxglove", "--port", "0", "--graph", "bench", *arguments)
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise AssertionError(process.communicate()[1])
    yield line, process
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, output, errors) == (130, "", "")


@pytest.fixture(scope="module")
def operated(bench: Palp) -> Iterator[str]:
    """The address of a server whose viewers may change the graph."""
    with serving(bench, "--operate") as (line, _):
        yield address_in(line)


def address_in(line: str) -> str:
    return next(word for word in line.split() if word.startswith("ws://"))


def graph_of(palp: Palp) -> RunningGraph:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
        return RunningGraph.find("bench")


def account(graph: RunningGraph) -> dict[str, Any]:
    """Return what the reader has counted of the sensor's blocks."""
    (edge,) = graph.ask_all("info", ["reader"]).edges("/sensor/block")
    return edge.account


def is_by(name: str, words: str) -> Any:
    return lambda shown: shown.value["name"] == name and words in shown.value["message"]


def test_topics_have_schemas_and_messages_by_the_graphs_clock(operated: str) -> None:
    with viewing(operated) as viewer:
        viewer.subscribe("/sensor/block")
        channel = viewer.channels["/sensor/block"]
        first = viewer.await_message("/sensor/block")
        later = viewer.await_message("/sensor/block", lambda s: s.value["index"] > first.value["index"] + 3)
        viewer.until(lambda: viewer.times_ns[-1:] >= [later.log_ns])  # the viewer's clock is the graph's
    assert (channel["encoding"], channel["schemaName"]) == ("json", "Block")
    schema = json.loads(channel["schema"])
    assert channel["schemaEncoding"] == "jsonschema"
    assert schema["type"] == "object"
    assert schema["properties"].keys() == first.value.keys()
    assert schema["properties"]["torque_n_m"] == {"type": "array", "items": {"type": "number"}}
    assert first.log_ns == first.value["stamp_ns"] < later.log_ns
    assert len(first.value["torque_n_m"]) == 5


def test_whoever_comes_late_gets_what_stands_and_nobody_gets_it_twice(operated: str) -> None:
    with viewing(operated) as viewer, viewing(operated) as other:
        for one in (viewer, other):
            one.subscribe("/sensor/alarm", "/graph/log")
            assert one.await_message("/sensor/alarm").value["text"] == "it is warm"
            alarm = one.await_message("/graph/log", is_by("/sensor", "it is warm; wait"))
            assert alarm.value["level"] == 3
            assert one.await_message("/graph/log", is_by("/graph", "started: bench")).value["level"] == 2
        viewer.call("/sensor/tare", {})  # what was sent to it before that has come
    assert sum(shown.topic == "/sensor/alarm" for shown in viewer.shown) == 1


def test_parameters_are_read_and_set_and_others_told(operated: str) -> None:
    with viewing(operated) as viewer, viewing(operated) as other:
        assert viewer.parameters() == {
            "/sensor.rate_hz": 50.0,
            "/sensor.size": 5,
            "/sensor.fail": False,
            "/sensor.options": '{"url": "socket://", "wait": {"s": [0.5, null]}}',
        }
        assert viewer.parameters("/sensor.size", "/nobody.size", "size") == {"/sensor.size": 5}
        other.send("subscribeParameterUpdates", parameterNames=["/sensor.rate_hz"])
        other.subscribe("/graph/log")
        assert viewer.set_parameters(sensor__rate_hz=40) == {"/sensor.rate_hz": 40.0}
        other.until(lambda: [s for s in other.said if s.get("parameters", [{}])[0].get("value") == 40.0])
        other.await_message("/graph/log", is_by("/sensor", "parameters: rate_hz = 40"))


def test_a_parameter_out_of_bounds_is_refused_in_words_and_stays(operated: str) -> None:
    with viewing(operated) as viewer:
        before = viewer.parameters("/sensor.rate_hz")
        assert viewer.set_parameters(sensor__rate_hz=-1.0) == before
        assert "rate_hz" in viewer.status("/sensor")["message"]
        assert viewer.set_parameters(sensor__rate_htz=1.0) == {}
        viewer.status("rate_htz")


def test_a_service_is_called_and_a_mistake_is_said(operated: str) -> None:
    with viewing(operated) as viewer:
        assert viewer.call("/sensor/tare", {"offset_n_m": 0.5}) == {"offset_n_m": 0.5}
        described = viewer.services["/sensor/tare"]
        assert described["request"]["schemaName"] == "TareRequest"
        assert json.loads(described["response"]["schema"])["properties"] == {"offset_n_m": {"type": "number"}}
        assert "offset_m: no such field" in viewer.call("/sensor/tare", {"offset_m": 1.0})["failed"]
        viewer.subscribe("/sensor/block")
        viewer.await_message("/sensor/block", lambda shown: shown.value["torque_n_m"][0] == -0.5)
        assert viewer.call("/sensor/tare", {}) == {"offset_n_m": 0.0}


def test_a_fault_and_a_swap_stand_in_the_log_and_the_topic_goes_on(bench: Palp, operated: str) -> None:
    with viewing(operated) as viewer:
        viewer.subscribe("/graph/log", "/sensor/block")
        viewer.set_parameters(sensor__fail=True)
        failed = viewer.await_message("/graph/log", is_by("/sensor", "the sensor has come off"))
        assert failed.value["level"] >= 3
        viewer.await_message("/graph/log", is_by("/sensor", "restarted: "))
        viewer.await_message("/sensor/block", lambda shown: shown.log_ns > failed.log_ns)
        assert bench.run("swap", "sensor", "nodes.bench:Sensor", "--graph", "bench").returncode == 0
        swapped = viewer.await_message("/graph/log", is_by("/sensor", "swapped: "))
        viewer.await_message("/sensor/block", lambda shown: shown.log_ns > swapped.log_ns)
        assert viewer.call("/sensor/tare", {}) == {"offset_n_m": 0.0}


def test_where_something_real_moves_viewers_only_read(bench: Palp) -> None:
    with serving(bench) as (line, _), viewing(address_in(line)) as viewer:
        assert line.endswith("(viewers read only)\n")
        with pytest.raises(InvalidStatus, match="403"), viewing(address_in(line).partition("?")[0]):
            pass
        assert viewer.parameters("/sensor.size") == {"/sensor.size": 5}
        assert viewer.set_parameters(sensor__size=7) == {"/sensor.size": 5}
        assert "--operate" in viewer.status("refused to set a parameter")["message"]
        assert "refused to call a service" in viewer.call("/sensor/tare", {})["failed"]
        with viewing(address_in(line)) as other:
            other.await_offer("/sensor/block")
            other.connection.socket.shutdown(socket.SHUT_RDWR)  # it is gone without a word
        viewer.call("/sensor/tare", {})


def test_a_viewer_that_reads_nothing_and_a_server_that_is_killed_are_not_felt(bench: Palp) -> None:
    graph = graph_of(bench)
    with serving(bench, "--operate") as (line, process):
        address = address_in(line)
        with viewing(address, max_queue=1) as slow, viewing(address) as viewer:
            viewer.set_parameters(sensor__size=50_000)  # 200 KB each: 100 are more than any buffer has
            slow.subscribe("/sensor/block")
            viewer.subscribe("/sensor/progress")  # one with each block
            begun = viewer.await_message("/sensor/progress").value["done_count"]
            viewer.await_message("/sensor/progress", lambda s: s.value["done_count"] > begun + 100)
            viewer.set_parameters(sensor__size=5)
            process.kill()
            process.wait()
            with contextlib.suppress(ConnectionClosed):
                viewer.until(lambda: False)
    before = account(graph)
    while (after := account(graph))["received"] < before["received"] + 10:
        assert bench.run("topic", "echo", "/sensor/block", "--once", "--graph", "bench").returncode == 0
    assert (after["lost"], after["dropped"]) == (0, 0)
    assert graph.ask("sensor", "info")["lifecycle"] == "active"


def test_a_graph_in_lockstep_is_shown_by_its_own_clock_and_may_be_changed(
    palp: Palp, workspace: Path
) -> None:
    graph = palp.start("launch", workspace / "lockstep.yaml")
    wait_for_line(graph, "blocks: ")
    server = palp.start("bridge", "foxglove", "--port", "0")
    assert server.stdout is not None
    line = server.stdout.readline()
    assert line.endswith("(viewers may set parameters and call services)\n")
    with viewing(address_in(line)) as viewer:
        viewer.subscribe("/sensor/block")
        shown = viewer.await_message("/sensor/block")
        assert shown.log_ns == shown.value["stamp_ns"]
        assert shown.log_ns % 20_000_000 == 0
        assert viewer.set_parameters(sensor__size=3) == {"/sensor.size": 3}
        graph.send_signal(signal.SIGINT)
        with pytest.raises(ConnectionClosed):
            viewer.until(lambda: False)
    output, errors = server.communicate(timeout=PATIENCE_S)
    assert (server.returncode, output, errors) == (0, "", "graph 'lockstep' has ended\n")


def test_words_that_contradict_each_other_are_said(bench: Palp) -> None:
    everywhere = bench.here("bridge", "foxglove", "--host", "0.0.0.0")
    assert (everywhere.returncode, "by which viewers call this host" in everywhere.stderr) == (2, True)
    both = bench.here("bridge", "foxglove", "--read-only", "--operate")
    assert (both.returncode, both.stderr) == (2, "give either --read-only or --operate\n")


def test_without_the_library_one_line_says_what_to_install(
    bench: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "palp_core.graph.foxglove.server", raising=False)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    refused = bench.refused("bridge", "foxglove")
    assert refused.endswith(f"{install_line('foxglove')}\n")
