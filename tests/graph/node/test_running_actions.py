"""Actions of a running graph: in processes, killed, swapped, recorded, replayed; and their page."""

import json
import re
import shutil
import signal
from pathlib import Path

import pytest

from palp_core.graph.bag.reader import Bag
from palp_core.graph.description.checked import resolved_yaml
from palp_core.graph.description.diagram import mermaid
from palp_core.graph.description.node_class import NodeClassRequest, inspect_classes
from palp_core.graph.problems import GraphProblems
from palp_core.graph.swap.compatibility import incompatibilities
from tests.cli.test_commands import promises
from tests.support.palp import ROOT, Palp, finished, wait_for_error
from tests.support.rig_session import check_here
from tests.support.supervised import Running

EXAMPLE = ROOT / "examples/actions"
CARRY = EXAMPLE / "launch/carry.yaml"
PAGE = ROOT / "docs/how_to/action.md"


@pytest.fixture
def carry(tmp_path: Path) -> Path:
    """The example, to be changed."""
    shutil.copytree(EXAMPLE, tmp_path / "ws")
    return tmp_path / "ws/launch/carry.yaml"


def change(file: Path, before: str, after: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert before in text
    file.write_text(text.replace(before, after), encoding="utf-8")


def test_the_page_shows_the_example_as_it_is() -> None:
    blocks = re.findall(
        r"^```(?:python|yaml)\n# (\S+)\n(.*?)^```$",
        PAGE.read_text(encoding="utf-8"),
        re.MULTILINE | re.DOTALL,
    )
    assert len(blocks) == 4
    for name, text in blocks:
        assert (EXAMPLE / name).read_text(encoding="utf-8") == text


def test_processes_and_composition_say_the_same_and_every_node_replays(palp: Palp, tmp_path: Path) -> None:
    palp.printed("launch", CARRY, "--digest", tmp_path / "processes.json", "--record", tmp_path / "bag")
    palp.printed("launch", CARRY, "--compose", "--digest", tmp_path / "composed.json")
    assert (tmp_path / "processes.json").read_bytes() == (tmp_path / "composed.json").read_bytes()
    with Bag(tmp_path / "bag") as bag:
        assert {"/arm/move/_action/feedback", "/arm/move/_action/status"} < set(bag.topics())
    replay = palp.printed(
        "bag", "replay", tmp_path / "bag", "--nodes", "arm,carrier", "--launch", CARRY, "--json"
    )
    for node in json.loads(replay):
        assert node["divergence"] is None
        assert node["compared"] > 5


ENDS_OF_ONE = """
from palp_core import Act, ActionClient, Message, Node, execute, on

class Far(Message):
    to_m: float

class Near(Message):
    at_m: float

class Arm(Node):
    move = Act(Far, Near, Near)
    @execute(move)
    def go(self, goal): ...

class Carrier(Node):
    move = ActionClient(Far, Near, Near)
    @on(move)
    def arrive(self, ended): ...

class Confused(Node):
    move = ActionClient(Far, Far, Near)
    @on(move)
    def arrive(self, ended): ...
"""


@pytest.fixture(scope="module")
def ends(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of theirs, of which this process imports the module once."""
    folder = tmp_path_factory.mktemp("ends")
    (folder / "one_action.py").write_text(ENDS_OF_ONE, encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("wire", "mistake"),
    [
        ("inputs: {move: arm/mvoe}", "has no action 'mvoe'; did you mean 'move'?"),
        ("", "action client 'move' is not wired; add move: arm/move under inputs"),
        ("inputs: {move: {from: arm/move, depth: 3}}", "an action has no quality of service; remove depth"),
        ("inputs: {move: {external: true}}", "'move' cannot be external; name the action that answers it"),
        ("inputs: {move: carrier/move}", "its action client; action client 'move' needs an action"),
        ("run: one_action.py:Confused\n    inputs: {move: arm/move}", "/arm/move carries Near, not Far"),
    ],
)
def test_one_key_wires_an_action_and_a_wrong_one_is_named(ends: Path, wire: str, mistake: str) -> None:
    file = ends / "ends.yaml"
    run = "" if "run" in wire else "run: one_action.py:Carrier\n    "
    begin = "graph: ends\nclock: sim\nnodes:\n  arm: {run: one_action.py:Arm}\n  carrier:\n    "
    file.write_text(f"{begin}{run}{wire}\n", encoding="utf-8")
    with pytest.raises(GraphProblems) as found:
        check_here(file)
    assert mistake in str(found.value)


def test_an_action_is_one_wire_in_the_file_that_palp_writes_and_in_its_picture(ends: Path) -> None:
    file = ends / "right.yaml"
    nodes = "arm: {run: one_action.py:Arm}\n  carrier: {run: one_action.py:Carrier, inputs: {move: arm/move}}"
    file.write_text(f"graph: ends\nclock: sim\nnodes:\n  {nodes}\n", encoding="utf-8")
    checked = check_here(file)
    assert resolved_yaml(checked).count("move: arm/move\n") == 1
    assert mermaid(checked).count("-->") == mermaid(checked).count('carrier -->|"move"| arm') == 1


@pytest.mark.parametrize(
    ("node", "successor", "words"),
    [
        ("arm", "Arm", []),
        ("carrier", "Carrier", []),
        ("arm", "Carrier", ["is its action client; action client 'move' needs an action; there are none"]),
        ("carrier", "Confused", ["action client 'move': /arm/move carries Near, not Far; wire a port of "]),
    ],
)
def test_a_successor_that_tears_an_action_is_refused_in_one_sentence(
    ends: Path, node: str, successor: str, words: list[str]
) -> None:
    file = ends / "torn.yaml"
    nodes = "arm: {run: one_action.py:Arm}\n  carrier: {run: one_action.py:Carrier, inputs: {move: arm/move}}"
    file.write_text(f"graph: ends\nclock: sim\nnodes:\n  {nodes}\n", encoding="utf-8")
    checked = check_here(file)
    (spec,) = [one for one in checked.nodes if one.name == node]
    (described,) = inspect_classes([NodeClassRequest(f"one_action:{successor}")], ends)
    found = [text for text in incompatibilities(checked, spec, described) if "not wired" not in text]
    assert len(found) == len(words)
    assert all(word in text for word, text in zip(words, found, strict=True)), found


def test_goals_from_the_shell_and_of_a_server_that_falls_silent_or_is_killed(palp: Palp, carry: Path) -> None:
    """The arm is on its way for minutes; what becomes of its goals is seen from outside."""
    change(carry, "[0.1, 0.0, 0.2]", "[1.0]")
    change(carry, "run: nodes.arm:Arm", "run: nodes.arm:Arm\n    params: {step_m: 0.0001}")
    begins = "None:\n        self.send_on()\n"
    change(carry.parents[1] / "nodes/carrier.py", begins, f'{begins}        self.log.warning("begun")\n')
    process = palp.start("launch", carry, "clock:=wall")
    wait_for_error(process, "begun")
    running = Running(palp)
    running.wait_for_epoch("arm", "/arm/move/_action/feedback", 0)
    queued = palp.start("action", "send_goal", "/arm/move", "{to_m: 0.1}", "--json")
    assert "goal accepted with ID: palp-" in wait_for_error(queued, "goal accepted")
    queued.send_signal(signal.SIGINT)
    status, output = finished(queued)
    assert status == 1
    ended = json.loads(output.splitlines()[0])
    assert ended["status"] == "canceled"
    promised = promises()
    assert ended.keys() >= set(promised["action send_goal"][1])
    for verb in ("info", "type"):
        answer = json.loads(palp.run("action", verb, "/arm/move", "--json").stdout)
        assert answer.keys() >= set(promised[f"action {verb}"][1])
    shown = palp.run("action", "info", "/arm/move").stdout
    assert "carrier.move-0-1: executing" in shown
    assert "Action clients: 1\n    /carrier" in shown
    assert palp.run("action", "list", "-t").stdout == "/arm/move [MoveGoal, MoveFeedback, MoveResult]\n"
    refused = palp.run("action", "send_goal", "/arm/move", "{to_m: 7}")
    assert (refused.returncode, refused.stdout.count("beyond the reach")) == (1, 1)
    assert "did you mean '/arm/move'?" in palp.run("action", "info", "/arm/mvoe").stderr
    answer = json.loads(palp.run("action", "cancel", "/arm/move", "--json").stdout)
    assert answer.keys() >= set(promised["action cancel"][1])
    assert answer["goal_ids"] == ["carrier.move-0-1"]
    assert "is canceled: it was asked to" in wait_for_error(process, "is canceled")
    hidden = palp.run("topic", "list", "--include-hidden-topics").stdout.split()
    assert {"/arm/move/_action/feedback", "/arm/move/_action/status"} < set(hidden)
    assert not any("_action" in name for name in palp.run("topic", "list").stdout.split())

    running.process("arm").suspend()
    assert "is unknown: its server is silent for 5000 ms" in wait_for_error(process, "is unknown")
    running.process("arm").resume()

    statuses: set[str] = set()
    while not statuses >= {"executing", "accepted"}:  # the one before, and the carrier's next, which waits
        running.wait_for_epoch("arm", "/arm/move/_action/feedback", 0)
        goals = json.loads(palp.run("action", "info", "/arm/move", "--json").stdout)["goals"]
        statuses = {goal["status"] for goal in goals}
    running.wait_for_epoch("arm", "/arm/move/_action/feedback", 0)
    running.process("arm").kill()
    assert "is aborted: its server was restarted and has forgotten it" in wait_for_error(
        process, "is aborted"
    )
    running.wait_for_epoch("arm", "/arm/move/_action/feedback", 1)
    (goal,) = json.loads(palp.run("action", "info", "/arm/move", "--json").stdout)["goals"]
    assert goal["status"] == "executing"
    process.send_signal(signal.SIGINT)
    finished(process)
