"""What a valid launch file becomes: arguments, selections, includes, wires, and its way back to YAML."""

from __future__ import annotations

import textwrap
from typing import Any

import msgspec
import pytest

from palp_core.graph.description.check import load
from palp_core.graph.description.checked import CheckedGraph, resolved_yaml, without_effect
from palp_core.graph.description.diagram import mermaid
from palp_core.graph.description.launch_file import arguments_text, find_workspace
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.description.resolver import resolve
from palp_core.graph.messages.qos import Qos
from palp_core.graph.problems import GraphProblems

LAUNCH = """
    graph: rig
    clock: sim
    seed: 7
    args:
      policy: {default: markov, choices: [fixed, markov], help: stiffness policy}
      rate_hz: {default: 500.0}
      live: {default: false}
    nodes:
      torque:
        run: ../nodes/torque.py:TorqueSensor
        params: {rate_hz: $(var rate_hz)}
      estimator:
        run: nodes.estimator:Estimator
        params: {gain: 1}
        inputs:
          torque: {from: torque/torque, deadline_ms: 50, depth: 3}
          tare: torque/tare
        restart: {max_restarts: 2, backoff_s: 1}
      policy:
        run: {select: $(var policy), fixed: nodes.policy_fixed:Fixed, markov: nodes.policy_markov:Markov}
        params: {select: $(var policy), fixed: {level: 2}, markov: {order: 3}}
        inputs:
          select: $(var policy)
          fixed: {belief: estimator/belief}
          markov: {belief: estimator/belief, torque: {from: torque/torque, reliability: best_effort}}
      record:
        run: {select: $(var live), true: nodes.record:Record, false: nodes.record:Record}
        inputs: {truth: torque/truth}
        on_exit: shutdown
    report: nodes.policy_markov:report
"""


def test_a_valid_file_becomes_a_whole_graph(workspace: Any) -> None:
    graph = workspace.load(LAUNCH)
    assert (graph.graph, graph.clock, graph.seed) == ("rig", "sim", 7)
    assert graph.args == {"policy": "markov", "rate_hz": 500.0, "live": False}
    assert graph.workspace == str(workspace.root)
    assert graph.report == "nodes.policy_markov:report"
    torque, estimator, policy, record = graph.nodes
    assert (torque.name, torque.run, torque.moves, torque.seed) == (
        "torque",
        "nodes.torque:TorqueSensor",
        True,
        7,
    )
    assert torque.params == {"device": "sim", "rate_hz": 500.0, "samples": 50}
    assert torque.requests == {"tare": ["/estimator/tare"]}
    assert estimator.inputs == {"torque": "/torque/torque", "tare": "/torque/tare"}
    assert (estimator.restart, estimator.max_restarts, estimator.backoff_s) == ("on_failure", 2, 1.0)
    assert (policy.run, policy.params) == ("nodes.policy_markov:Markov", {"order": 3})
    assert record.shutdown_on_exit
    assert graph.edges == {
        "/torque/torque": [["estimator", "torque"], ["policy", "torque"]],
        "/estimator/tare": [["torque", "tare"]],
        "/torque/tare/estimator/tare": [["estimator", "tare"]],
        "/estimator/belief": [["policy", "belief"]],
        "/torque/truth": [["record", "truth"]],
    }
    assert set(graph.edges) | {"/policy/command"} == set(graph.topics)
    belief = graph.topics["/estimator/belief"]
    assert (belief.node, belief.port, belief.type, len(belief.type_hash)) == (
        "estimator",
        "belief",
        "Belief",
        16,
    )
    assert belief.ros_text == "int64 stamp_ns  # ns\nfloat64 depth_m  # m\n"
    assert belief.json_schema["title"] == "Belief"
    wanted = Qos(reliability="best_effort", deadline_ms=50.0, depth=3)
    assert estimator.qos["torque"] == wanted
    assert graph.classes["torque"].doc == "Stream the probe's torque."


def test_an_argument_selects_what_runs_with_its_parameters_and_wires(workspace: Any) -> None:
    graph = workspace.load(LAUNCH, "policy:=markov", "policy:=fixed", "rate_hz:=250")
    policy = graph.nodes[2]
    assert (policy.run, policy.params) == ("nodes.policy_fixed:Fixed", {"level": 2})
    assert policy.inputs == {"belief": "/estimator/belief"}
    assert graph.args["rate_hz"] == 250.0
    assert isinstance(graph.args["rate_hz"], float)


def test_a_checked_graph_crosses_a_process_boundary(workspace: Any) -> None:
    graph = workspace.load(LAUNCH)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(graph), type=CheckedGraph) == graph


def test_the_printed_graph_loads_to_the_same_nodes_and_wires(workspace: Any) -> None:
    graph = workspace.load(LAUNCH, "policy:=fixed")
    again = load(workspace.write("launch/printed.yaml", resolved_yaml(graph)), [], inspect_classes)
    assert again == msgspec.structs.replace(graph, args={}, file=str(workspace.root / "launch/printed.yaml"))


def test_arguments_are_shown_in_the_words_of_ros_2(workspace: Any) -> None:
    text = arguments_text(resolve(workspace.write("launch/graph.yaml", LAUNCH)))
    assert text.startswith(
        textwrap.dedent(
            """\
            Arguments (pass arguments as '<name>:=<value>'):

                'policy':
                    stiffness policy. Valid choices are: ['fixed', 'markov']
                    (default: 'markov')

                'rate_hz':
                    no description given
                    (default: 500.0)
            """
        )
    )


def test_only_branches_of_one_argument_that_go_together_are_wired(workspace: Any) -> None:
    text = """
        graph: g
        clock: sim
        args: {kind: {default: a, choices: [a, b]}}
        nodes:
          source: {run: {select: $(var kind), a: nodes.torque:TorqueSensor, b: nodes.policy_markov:Markov},
                   inputs: {select: $(var kind), a: {}, b: {belief: source/command}}}
          sink: {run: {select: $(var kind), a: nodes.record:Record, b: nodes.policy_fixed:Fixed},
                 inputs: {select: $(var kind), a: {truth: source/truth}, b: {belief: source/command}}}
    """
    assert workspace.load(text, "kind:=b").nodes[1].inputs == {"belief": "/source/command"}
    with pytest.raises(GraphProblems, match="no output 'truth'"):
        workspace.load(
            text.replace("b: {belief: source/command}}}\n    ", "b: {belief: source/truth}}}\n    ")
        )


def test_the_workspace_is_the_nearest_folder_with_nodes(workspace: Any) -> None:
    deep = workspace.write("launch/deep/er/graph.yaml", "graph: g")
    assert find_workspace(deep) == workspace.root


def test_mermaid_text_has_every_wire_and_dashes_the_truth(workspace: Any) -> None:
    text = mermaid(workspace.load(LAUNCH))
    assert '    torque("<b>torque</b><br/>TorqueSensor")' in text
    assert '    estimator -->|"belief"| policy' in text
    assert '    torque -.->|"truth"| record' in text
    assert '    estimator -->|"tare"| torque' in text


def test_a_file_without_arguments_says_so(workspace: Any) -> None:
    text = arguments_text(resolve(workspace.write("launch/graph.yaml", "graph: g\nclock: sim\nnodes: {}\n")))
    assert text == "Arguments (pass arguments as '<name>:=<value>'):\n\n    No arguments.\n"


def test_text_arguments_are_taken_as_typed(workspace: Any) -> None:
    text = LAUNCH.replace("rate_hz: {default: 500.0}", "subject: {default: none}").replace(
        "params: {rate_hz: $(var rate_hz)}", "params: {device: $(var subject)}"
    )
    for typed in ("007", "true", "a: b"):
        description = resolve(workspace.write("launch/graph.yaml", text), [f"subject:={typed}"])
        assert description.values["subject"] == typed


IN_VAIN = """
    graph: a
    clock: {clock}
    nodes:
      torque: {{run: nodes.torque:TorqueSensor, restart: on_failure}}
      record:
        run: nodes.record:Record
        inputs: {{truth: torque/truth}}
"""


def test_what_has_no_effect_in_simulated_time_is_said_once(workspace: Any) -> None:
    assert without_effect(workspace.load(IN_VAIN.format(clock="wall"))) == ""
    assert without_effect(workspace.load(IN_VAIN.format(clock="sim"))) == (
        "'restart' (torque) has no effect in simulated time: a node's crash ends the run"
    )


def test_a_path_counts_from_the_launch_file_the_workspace_and_of_an_argument_from_where_one_is(
    workspace: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = (workspace.root / "nodes/record.py").read_text(encoding="utf-8")
    text = """
        graph: paths
        clock: sim
        args:
          lab: {default: "lab.py:Record"}
        nodes:
          torque: {run: "nodes.torque:TorqueSensor"}
          record: {run: $(var lab), inputs: {truth: torque/truth}}
        """
    workspace.write("lab.py", source)
    assert workspace.load(text).nodes[1].run == "lab:Record"
    away = tmp_path / "away"
    away.mkdir()
    (away / "far.py").write_text(source, encoding="utf-8")
    with pytest.raises(GraphProblems) as found:
        workspace.load(text, "lab:=far.py:Record")
    launch = workspace.root / "launch"
    looked = (
        f"no file far.py next to this file ({launch}), nor in the workspace ({workspace.root}), nor where you"
    )
    assert looked in str(found.value)
    monkeypatch.chdir(away)
    assert workspace.load(text, "lab:=far.py:Record").nodes[1].run == "away.far:Record"
    fixed = text.replace("$(var lab)", "far.py:Record")
    with pytest.raises(GraphProblems, match=r"no file far\.py next to this file"):
        workspace.load(fixed)
