"""What of a blinded session leaves the source: what is named as harmless, and nothing else."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.errors import GraphError
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.discovery.run_directory import NodeEntry, RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.discovery.troubles import Trouble
from palp_core.graph.messages.topic import Topic
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.view.source.blind import HIDDEN, WHOLE, BlindSource, Harmless
from palp_core.view.source.live import HAS_ENDED
from palp_core.view.source.operator import BLINDED, GraphOperator, Refused
from palp_core.view.source.overview import NodeState, Overview
from palp_core.view.source.protocol import Heard
from tests.support.bags import TOPICS, run_frames
from tests.support.palp import PATIENCE_S, Palp

SECRET = "4.3217"
HARMLESS = Harmless(fields={"Pose": (WHOLE,), "Trial": ("trial",)}, speakers=("Pose",), calls=("stop",))


def topic(name: str, kind: str) -> Topic:
    schema = {
        "title": kind,
        "description": SECRET,
        "properties": {"trial": {"type": "integer"}, "depth_mm": {"type": "number", "default": SECRET}},
    }
    return Topic(name=name, type=kind, node=name.split("/")[1], json_schema=schema)


class Tells:
    """A source in which everything tells the depth."""

    def __init__(self) -> None:
        self.heard = Heard(5, 1, {"trial": 3, "depth_mm": SECRET, "(not shown)": SECRET})
        self.topic = topic("/experiment/trial", "Trial")
        self.rate_hz = 2.0
        self.closed = False

    def overview(self) -> Overview:
        nodes = [NodeState(name="stage", why="it halts"), NodeState(name="estimator", why=f"at {SECRET}")]
        troubles = [
            Trouble("/stage", "warn", "it halts"),
            Trouble("/estimator", "warn", f"at {SECRET}", f"look at {SECRET}"),
            Trouble("/experiment/trial -> /estimator", "warn", "2 messages lost"),
            Trouble("the graph", "warn", f"failed: {SECRET}", SECRET),
            Trouble("the graph", "warn", HAS_ENDED),
        ]
        return Overview(kind="graph", title="rig", nodes=nodes, troubles=troubles)

    def topics(self) -> list[Topic]:
        return [topic("/stage/pose", "Pose"), self.topic, topic("/estimator/belief", "Belief")]

    def watch(self, name: str) -> Tells:
        return self

    def latest(self) -> Heard | None:
        return self.heard

    def drain(self) -> list[Heard]:
        return [self.heard]

    def remembered(self, topics: Sequence[str]) -> Iterator[tuple[str, Heard]]:
        yield from ((name, self.heard) for name in topics)

    def launch(self) -> dict[str, Any]:
        return {"params": {"phantom": {"depth_mm": SECRET}}}

    def close(self) -> None:
        self.closed = True


def test_nothing_that_is_not_named_leaves_the_source() -> None:
    tells = Tells()
    blind = BlindSource(tells, HARMLESS)
    watch = blind.watch("/experiment/trial")
    given = [
        blind.overview(), blind.topics()[1:], blind.launch(), watch.topic, watch.latest(), watch.drain(),
        watch.rate_hz, list(blind.remembered(["/experiment/trial", "/estimator/belief"])),
    ]  # fmt: skip
    assert SECRET.encode() not in msgspec.json.encode(given)
    assert watch.latest() == Heard(5, 1, {"trial": 3})
    assert [one.name for one in blind.topics()] == ["/stage/pose", "/experiment/trial"]
    assert [name for name, _ in blind.remembered(["/estimator/belief", "/stage/pose"])] == ["/stage/pose"]


@pytest.mark.parametrize("name", ["/estimator/belief", "/no/such"])
def test_what_is_hidden_is_told_from_what_is_not_there_by_nobody(name: str) -> None:
    with pytest.raises(GraphError) as refused:
        BlindSource(Tells(), HARMLESS).watch(name)
    assert str(refused.value) == f"{name}: {HIDDEN}"


def test_what_moves_may_say_what_is_wrong_with_it_and_losses_are_told() -> None:
    overview = BlindSource(Tells(), HARMLESS).overview()
    assert [one.text for one in overview.troubles] == [
        "it halts",
        f"something is wrong; {HIDDEN}",
        "2 messages lost",
        f"something is wrong; {HIDDEN}",
        HAS_ENDED,
    ]
    assert [node.why for node in overview.nodes] == ["it halts", HIDDEN]


def test_where_nothing_is_named_nothing_is_seen() -> None:
    blind = BlindSource(Tells(), Harmless())
    assert blind.topics() == []
    assert all(node.why == HIDDEN for node in blind.overview().nodes)


class Asked:
    """Stands for a running graph."""

    def __init__(self, folder: Path) -> None:
        place = f"ipc://{folder}"
        record = RunRecord(
            "rig", "rig.yaml", "sim", 1, 0, f"{place}/graph.srv", [NodeEntry("safety", "", 1, "", place)], []
        )
        self.graph = RunningGraph(record, lambda *_: {"reply": {"state": "latched"}, "parameters": {}})
        self.known = True

    def overview(self) -> Overview:
        return Overview(kind="graph", title="rig", clock="sim")


def test_of_a_blinded_session_nothing_can_be_asked_but_what_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RunningGraph, "alive", True)
    operator = GraphOperator(Asked(tmp_path), only=HARMLESS.calls)  # type: ignore[arg-type]
    assert operator.call("safety", "stop", {}, stops=True) == {"state": "latched"}
    for press in (
        lambda: operator.call("estimator", "explain", {}, stops=True),
        lambda: operator.set_parameters("phantom", {}),
        lambda: operator.swap("policy", "a:B"),
        lambda: operator.publish("phantom", "mount", "{}"),
        lambda: operator.transition("phantom", "deactivate"),
    ):
        with pytest.raises(Refused, match=BLINDED):
            press()


@pytest.mark.parametrize(
    "view", ["palp_core.palpation.live_page.page:rig", "", "palp_core.no_such:page", "os:abort"]
)
def test_a_bag_of_a_blinded_session_is_shown_blind_whatever_page_it_names(
    view: str, shared_palp: Palp, tmp_path: Path
) -> None:
    recorder = BagRecorder(BagWriter(tmp_path / "run"), TOPICS)
    for now_ns, raw in run_frames(5):
        recorder(now_ns, raw)
    launch = {"graph": "rig", "blind": True, "view": view}
    recorder.attach(LAUNCH_ATTACHMENT, msgspec.json.encode(launch))
    recorder.close()
    process = shared_palp.start("view", tmp_path / "run", "--no-browser")
    assert process.stdout is not None
    address = process.stdout.readline().strip()
    base, _, token = address.partition("?token=")
    said = [
        asked(f"{base}{token}/{page}")
        for page in ("", "topics", "topic/torque/block", "topic/policy/mode", "own")
    ]
    process.kill()
    process.wait(PATIENCE_S)
    assert HIDDEN in said[2]
    assert "STOP" not in said[4]
    for page in said:
        assert "torque_n_m" not in page
        assert "level" not in page


def asked(address: str) -> str:
    try:
        with urllib.request.urlopen(address, timeout=PATIENCE_S) as answer:
            text: str = answer.read().decode()
            return text
    except urllib.error.HTTPError as error:
        return error.read().decode()
