"""What is wrong with a module is an answer with its line, never an exception."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest, inspect_classes
from palp_core.graph.description.wire_check import misfit, misfits
from palp_core.graph.messages.qos import Qos


def ask(workspace: Any, run: str, **params: Any) -> NodeClass:
    (answer,) = inspect_classes([NodeClassRequest(run, params)], workspace.root)
    return answer


def test_a_class_is_described_as_plain_data(workspace: Any) -> None:
    answer = ask(workspace, "nodes.torque:TorqueSensor")
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(answer), type=NodeClass) == answer
    assert answer.error is None
    assert {name: port.kind for name, port in answer.ports.items()} == {
        "torque": "pub",
        "truth": "pub",
        "tare": "srv",
    }
    assert [kind.name for kind in answer.ports["tare"].types] == ["TareRequest", "TareReply"]
    rate = answer.params["rate_hz"]
    assert (rate.type, rate.unit, rate.default, rate.minimum, rate.maximum) == (
        "float",
        "Hz",
        1000.0,
        0.0,
        1e6,
    )
    assert answer.params["device"].type == "Literal['sim', 'uart']"
    assert (answer.moves, answer.simulates, answer.records) == (True, False, False)
    assert ask(workspace, "nodes.record:Record").records


def test_a_file_runs_as_a_module(workspace: Any) -> None:
    assert ask(workspace, f"{workspace.root}/nodes/torque.py:TorqueSensor").error is None


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import no_such_thing\n", ("nodes/broken.py:1: ModuleNotFoundError", "no_such_thing")),
        ("x = 1\nclass Broken(:\n", ("nodes/broken.py:2: SyntaxError",)),
        ("import sys\n\nsys.exit(3)\n", ("nodes/broken.py:3:", "exit status 3", "remove")),
        ("def f():\n    raise ValueError('why')\nf()\n", ("nodes/broken.py:2: ValueError: why",)),
        (
            "from msgs.touch import *\nfrom palp_core import *\n\nclass Broken(Node):\n    a = Sub(Belief)\n",
            ("nodes/broken.py:4: GraphError", "'a' has no handler"),
        ),
        (
            "from msgs.touch import *\nfrom palp_core import *\nclass Broken(Node):\n"
            "    a = Pub(Belief, qos=Qos(reliability='relible'))\n",
            ("nodes/broken.py:4: ValueError: qos reliability = 'relible'", "give one of best_effort"),
        ),
        ("class Broked: ...\n", ("no class 'Broken' in nodes.broken",)),
        ("class Broken: ...\n", ("not a node", "palp_core.Node")),
    ],
)
def test_a_broken_module_is_an_answer_with_its_line(
    workspace: Any, source: str, words: tuple[str, ...]
) -> None:
    workspace.write("nodes/broken.py", source)
    error = ask(workspace, "nodes.broken:Broken").error
    assert error is not None
    assert all(word in error for word in words), error


def test_a_module_that_prints_leaves_standard_output_alone(
    workspace: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    workspace.write("nodes/loud.py", "print('hello')\nfrom nodes.record import Record\n")
    assert ask(workspace, "nodes.loud:Record").error is None
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "hello\n")


def test_every_parameter_that_does_not_fit_is_named(workspace: Any) -> None:
    errors = ask(workspace, "nodes.torque:TorqueSensor", rate_hz=-1, samples=2.5, devise="sim").param_errors
    assert set(errors) == {"rate_hz", "samples", "devise"}
    assert "from 0 to 1e+06 in Hz" in errors["rate_hz"]
    assert "did you mean 'device'?" in errors["devise"]
    assert ask(workspace, "nodes.estimator:Estimator").param_errors.keys() == {"gain"}


def test_a_module_of_another_workspace_is_not_taken_for_ours(workspace: Any) -> None:
    ask(workspace, "nodes.record:Record")
    other = workspace.root / "other"
    workspace.write("other/nodes/record.py", "")
    (answer,) = inspect_classes([NodeClassRequest("nodes.record:Record")], other)
    assert answer.error is not None
    assert "not from the workspace" in answer.error


def test_a_function_is_found_or_its_like_is_named(workspace: Any) -> None:
    requests = [
        NodeClassRequest(f"nodes.policy_markov:{name}", kind="function") for name in ("report", "reprot")
    ]
    found, missed = inspect_classes(requests, workspace.root)
    assert found.error is None
    assert missed.error is not None
    assert "did you mean 'report'?" in missed.error


def info(**changed: Any) -> TopicInfo:
    known: dict[str, Any] = {
        "node": "torque", "port": "block", "type": "Sample", "type_hash": "0" * 16,
        "ros_text": "int64 stamp_ns\nfloat64 force_n\n", "json_schema": {}, "qos": Qos(),
    }  # fmt: skip
    return TopicInfo(**known | changed)


MISFITS: dict[str, tuple[dict[str, Any], str]] = {
    "another field": (
        {"type_hash": "1", "ros_text": "int64 stamp_ns\nfloat32 force_n\n"},
        "with 'float64 force_n' where 'float32 force_n' is wanted",
    ),
    "a field less": (
        {"type_hash": "1", "ros_text": "int64 stamp_ns\n"},
        "with 'float64 force_n', too",
    ),
    "a field more": (
        {"type_hash": "1", "ros_text": "int64 stamp_ns\nfloat64 force_n\nbool ok\n"},
        "without 'bool ok'",
    ),
    "another field inside": (
        {"type_hash": "1"},
        "which differs in a nested type",
    ),
}


@pytest.mark.parametrize("name", MISFITS)
def test_a_wire_that_does_not_fit_is_refused_for_what_is_wrong(name: str) -> None:
    wanted, difference = MISFITS[name]
    text = f"/torque/block carries another Sample, {difference}"
    assert misfit(info(**wanted), info(), reads_truth=False) == ("type", text)


def test_every_reason_is_told() -> None:
    wanted = info(port="truth", qos=Qos(durability="transient_local"))
    assert [found.part for found in misfits(wanted, info(port="truth"), reads_truth=False)] == [
        "qos",
        "truth",
    ]


def test_a_wire_that_fits_is_not_refused() -> None:
    assert misfit(info(), info(), reads_truth=False) is None
    assert misfit(info(port="truth"), info(port="truth"), reads_truth=True) is None
