"""Every mistake in a launch file is reported at its line, with what to do."""

from __future__ import annotations

import textwrap
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palp_core.graph.node.spec import RESERVED_NAMES
from palp_core.graph.problems import GraphProblems

VALID = textwrap.dedent(
    """
    graph: rig
    clock: sim
    seed: 7
    args:
      policy: {default: markov, choices: [fixed, markov], help: stiffness policy}
      rate_hz: {default: 500.0}
    nodes:
      torque:
        run: nodes.torque:TorqueSensor
        params: {rate_hz: $(var rate_hz), device: sim}
      estimator:
        run: nodes.estimator:Estimator
        params: {gain: 1.5}
        inputs:
          torque: {from: torque/torque, deadline_ms: 50}
          tare: torque/tare
        restart: {when: on_failure, max_restarts: 2}
      policy:
        run: {select: $(var policy), fixed: nodes.policy_fixed:Fixed, markov: nodes.policy_markov:Markov}
        params: {select: $(var policy), fixed: {level: 2}, markov: {order: 3}}
        inputs: {belief: estimator/belief}
      record:
        run: nodes.record:Record
        inputs: {truth: torque/truth}
        on_exit: shutdown
    report: nodes.policy_markov:report
    view: nodes.policy_markov:page
    """
).lstrip("\n")

# what is replaced, by what, the line (within the file) and words of the message
MISTAKES: dict[str, tuple[str, str, int, tuple[str, ...]]] = {
    "an unknown root key": ("seed: 7", "sead: 7", 3, ("'sead'", "did you mean 'seed'?")),
    "an unknown clock": ("clock: sim", "clock: simm", 2, ("sim or wall", "did you mean 'sim'?")),
    "a seed in quotes": ("seed: 7", "seed: '7'", 3, ("whole number", "without quotes")),
    "a negative seed": ("seed: 7", "seed: -7", 3, ("at least 0",)),
    "a default that is no choice": ("default: markov", "default: markow", 5, ("not one of its", "'markov'?")),
    "an argument that nothing uses": ("$(var rate_hz)", "500.0", 6, ("'rate_hz' is never used",)),
    "an unknown argument": ("$(var rate_hz)", "$(var rate)", 10, ("no argument 'rate'", "mean 'rate_hz'?")),
    "an unknown substitution": ("device: sim", "device: $(vra x)", 10, ("'$(vra x)'", "did you mean 'var'?")),
    "a substitution left open": ("device: sim", "device: '$(var x'", 10, ("not closed",)),
    "a missing environment": ("device: sim", "device: $(env NO_SUCH)", 10, ("NO_SUCH is not set", "default")),
    "an unknown key of a node": ("    params: {gain", "    prams: {gain", 13, ("'prams'", "mean 'params'?")),
    "a run key with a typo": ("run: nodes.torque", "rnu: nodes.torque", 9, ("'rnu'", "did you mean 'run'?")),
    "a module that is not there": ("nodes.torque:", "nodes.torqe:", 9, ("nodes.torqe", "'nodes.torque'?")),
    "a class that is not there": ("estimator:Est", "estimator:Ext", 12, ("Extimator", "mean 'Estimator'?")),
    "a class that is not a node": (
        "torque:TorqueSensor",
        "torque:TorqueParams",
        9,
        ("is not a node", "TorqueSensor)"),
    ),
    "a run without a class": ("nodes.record:Record", "nodes.record", 23, ("module:Class",)),
    "an unknown parameter": ("{gain: 1.5}", "{gain: 1.5, gian: 2}", 13, ("'gian'", "did you mean 'gain'?")),
    "a number given as text": ("gain: 1.5", 'gain: "1.5"', 13, ("Expected `float`", "without quotes")),
    "a number out of bounds": ("$(var rate_hz), d", "-$(var rate_hz), d", 10, ("from 0 to 1e+06 in Hz",)),
    "a word out of its list": ("device: sim", "device: simm", 10, ("'device'", "Literal['sim', 'uart']")),
    "a parameter left out": ("params: {gain: 1.5}", "params: {}", 12, ("'gain' has no default",)),
    "an unknown node": ("from: torque/torque", "from: torqe/torque", 15, ("'torqe'", "mean 'torque'?")),
    "an unknown output": ("estimator/belief", "estimator/beleif", 21, ("'beleif'", "did you mean 'belief'?")),
    "an unknown input": ("{belief: est", "{beleif: est", 21, ("no input 'beleif'", "mean 'belief'?")),
    "an input left unwired": (
        "inputs: {truth: torque/truth}",
        "params: {}",
        22,
        ("'truth' is not wired", "truth: "),
    ),
    "an output among the inputs": (
        "tare: torque/tare",
        "belief: policy/command",
        16,
        ("output, not an input",),
    ),
    "another type": (
        "belief: estimator/belief",
        "belief: torque/torque",
        21,
        ("/torque/torque carries Torque, not Belief", "wire a port of its type"),
    ),
    "a source without a port": ("tare: torque/tare", "tare: torque", 16, ("node/port",)),
    "a client wired to an output": ("tare: torque/tare", "tare: torque/torque", 16, ("service", "'tare'")),
    "more than is offered": ("deadline_ms: 50", "reliability: reliable", 15, ("best_effort", "ask for less")),
    "a wrong word of quality": ("deadline_ms: 50", "durability: volatil", 15, ("'volatil'", "'volatile'?")),
    "a missing branch": (", markov: nodes.policy_markov:Markov}", "}", 19, ("policy=markov", "add a key")),
    "a branch that is no choice": ("markov: {order", "markow: {order", 20, ("'markow'", "mean 'markov'?")),
    "a branch that does not fit": (
        "{level: 2}",
        "{order: 2}",
        20,
        ("(Fixed)", "'order'", "there are: level"),
    ),
    "a selection by no argument": (
        "run: {select: $(var policy)",
        "run: {select: markov",
        19,
        ("$(var name)",),
    ),
    "truth read by a policy": ("estimator/belief", "torque/truth", 21, ("simulates or records",)),
    "a report that is not there": ("markov:report", "markov:reprot", 26, ("'reprot'", "mean 'report'?")),
    "a page that is not there": (
        "markov:page",
        "markov:pge",
        27,
        ("view: ", "'pge'", "did you mean 'page'?"),
    ),
    "a page without function": ("policy_markov:page", "policy_markov", 27, ("view is", "module:function")),
    "a node given twice": ("  record:\n", "  policy:\n", 22, ("'policy' is given twice", "line 18")),
    "a parameter given twice": ("gain: 1.5", "gain: 1.5, gain: 2.0", 13, ("'gain' is given twice",)),
    "broken YAML": ("params: {gain: 1.5}", "params: {gain: 1.5", 14, ("not valid YAML", "line 13")),
    "nodes that are a list": ("    params: {gain: 1.5}", "    params: [gain]", 13, ("map each parameter",)),
    "an argument without a mapping": ("rate_hz: {default: 500.0}", "rate_hz: 500", 6, ("{default: ...}",)),
    "an argument's strange name": ("rate_hz: {d", "rate-hz: {d", 6, ("'rate-hz'", "letters")),
    "a default that is a list": ("{default: 500.0}", "{default: [1]}", 6, ("text, a number",)),
    "choices that are no list": ("[fixed, markov]", "fixed", 5, ("[a, b]",)),
    "a choice of another type": ("[fixed, markov]", "[fixed, 3]", 5, ("choice 3", "text")),
    "a strange graph name": ("graph: rig", "graph: 5 rigs", 1, ("'5 rigs'", "letter")),
    "a strange node name": ("  record:\n", "  re-cord:\n", 22, ("'re-cord'",)),
    "includes that are no list": ("seed: 7", "include: {file: a.yaml}", 3, ("must be a list",)),
    "an include that is no mapping": (
        "seed: 7",
        "include: [a.yaml]",
        3,
        ("with the keys file",),
    ),
    "an include without a file": ("seed: 7", "include: [{args: {}}]", 3, ("add file:",)),
    "an included file far away": ("seed: 7", "include: [{file: no/a.yaml}]", 3, ("check the path",)),
    "a node that is a word": (
        "  record:\n",
        "  other: word\n  record:\n",
        22,
        ("with the keys run",),
    ),
    "a node that runs nothing": ("  record:\n", "  other: {}\n  record:\n", 22, ("has no run; add run: ",)),
    "a run that is a mapping": ("run: nodes.record:Record", "run: {a: b}", 23, ("module:Class",)),
    "a select with a typo": ("run: {select:", "run: {selct:", 19, ("'selct'", "'select'?")),
    "inputs that are a list": ("{belief: estimator/belief}", "[belief]", 21, ("map each port",)),
    "an input without source": ("from: torque/torque, ", "", 15, ("add from: node/port",)),
    "a client with quality": (
        "tare: torque/tare",
        "tare: {from: torque/tare, depth: 1}",
        16,
        ("remove depth",),
    ),
    "an input from a service": ("from: torque/torque", "from: torque/tare", 15, ("its service", "output")),
    "a file that is not there": (
        "nodes.record:Record",
        "../nodes/recrd.py:Record",
        23,
        ("no file ../nodes/recrd.py", "record.py"),
    ),
}


def problems_of(workspace: Any, text: str, *overrides: str) -> list[tuple[int, str]]:
    with pytest.raises(GraphProblems) as caught:
        workspace.load(text, *overrides)
    assert all(p.file == str(workspace.root / "launch/graph.yaml") for p in caught.value.problems)
    assert str(caught.value).count("\n") == len(caught.value.problems) - 1
    return [(p.line, str(p)) for p in caught.value.problems]


ECHOING = {"an unknown argument", "an argument's strange name", "a node given twice", "a strange node name"}
ECHOING |= {"an output among the inputs"}
"""What is missing, or named twice, after these mistakes is told at its own line."""


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_reported_at_its_line_with_what_to_do_and_without_echo(
    workspace: Any, name: str
) -> None:
    before, after, line, words = MISTAKES[name]
    assert VALID.count(before) == 1 or before in ("seed: 7",), before
    found = problems_of(workspace, VALID.replace(before, after, 1))
    at_line = [text for number, text in found if number == line]
    assert any(all(word in text for word in words) for text in at_line), found
    assert len(at_line) == len(found) or name in ECHOING, found


def test_a_message_reads_file_line_column_and_what_to_do(workspace: Any) -> None:
    ((_, text),) = problems_of(workspace, VALID.replace("estimator/belief", "estimtor/belief"))
    place = f"{workspace.root}/launch/graph.yaml:21:22"
    what = "node 'policy': input 'belief' comes from a node 'estimtor' that is not there"
    assert text == f"{place}: {what}; did you mean 'estimator'?"


@pytest.mark.parametrize("name", sorted(RESERVED_NAMES))
def test_a_node_cannot_have_a_name_that_is_the_launchers_own(workspace: Any, name: str) -> None:
    ((_, text),) = problems_of(workspace, VALID.replace("  record:\n", f"  {name}:\n"))
    place = f"{workspace.root}/launch/graph.yaml:22:3"
    what = f"'{name}' cannot be a node's name; it is the launcher's own: {RESERVED_NAMES[name]}"
    assert text == f"{place}: {what}; choose another"


def test_two_mistakes_are_reported_together(workspace: Any) -> None:
    text = (
        VALID.replace("gain: 1.5", "gain: fast").replace("on_exit", "on_exti").replace("seed: 7", "seeds: 7")
    )
    assert sorted({line for line, _ in problems_of(workspace, text)}) == [3, 13, 25]


def test_two_mistakes_of_one_wire_are_reported_together(workspace: Any) -> None:
    wire = "{from: torque/truth, durability: transient_local}"
    found = problems_of(workspace, VALID.replace("estimator/belief", wire))
    told = " ".join(text for line, text in found if line == 21)
    assert "the publisher offers volatile" in told
    assert "simulates or records" in told


def test_a_hidden_branch_is_checked_too(workspace: Any) -> None:
    found = problems_of(workspace, VALID.replace("policy_fixed:Fixed", "policy_fixed:Fixd"), "policy:=markov")
    assert [line for line, _ in found] == [19]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("rate_hz:=fast", ("'rate_hz' is given as 'fast' (text)", "a number")),
        ("rate_hz:='5'", ("'rate_hz' is given as '5' (text)", "a number")),
        ("rate_hz:=true", ("a number",)),
        ("policy:=markow", ("'fixed', 'markov'", "did you mean 'markov'?")),
        ("polcy:=fixed", ("no argument 'polcy'", "did you mean 'policy'?")),
        ("policy=fixed", ("name:=value",)),
    ],
)
def test_a_wrong_override_names_the_argument_and_its_type(
    workspace: Any, override: str, words: tuple[str, ...]
) -> None:
    text = " ".join(text for _, text in problems_of(workspace, VALID, override))
    assert all(word in text for word in words), text


def test_a_graph_without_nodes_or_clock_is_refused(workspace: Any) -> None:
    assert "no nodes" in problems_of(workspace, "graph: g\nclock: sim\nnodes: {}\n")[0][1]
    assert "state its clock" in problems_of(workspace, VALID.replace("clock: sim\n", ""))[0][1]
    assert "is empty" in problems_of(workspace, "# nothing\n")[0][1]


def test_a_missing_argument_says_how_to_pass_it(workspace: Any) -> None:
    text = VALID.replace("rate_hz: {default: 500.0}", "rate_hz: {help: how fast}")
    ((_, message),) = problems_of(workspace, text)
    assert "pass rate_hz:=value" in message
    assert workspace.load(text, "rate_hz:=250").args["rate_hz"] == 250


KEYS = [
    "graph",
    "clock",
    "args",
    "nodes",
    "report",
    "view",
    "default",
    "choices",
    "run",
    "params",
    "inputs",
    "restart",
]
KEYS += ["when", "max_restarts", "on_exit", "from", "deadline_ms", "gain", "truth", "select", "device"]


@settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
@given(key=st.sampled_from(KEYS), data=st.data())
def test_a_typo_in_any_key_is_reported_at_its_line(workspace: Any, key: str, data: st.DataObject) -> None:
    position = data.draw(st.integers(0, len(key) - 1))
    letter = data.draw(st.sampled_from("abcdefghijklmnopqrstuvwxyz"))
    insert = data.draw(st.booleans())
    typo = key[:position] + letter + key[position + (0 if insert else 1) :]
    if typo == key:
        return
    start = VALID.index(f"{key}: ") if f"{key}: " in VALID else VALID.index(f"{key}:\n")
    text = VALID[:start] + typo + VALID[start + len(key) :]
    line = VALID.count("\n", 0, start) + 1
    found = problems_of(workspace, text)
    assert any(number == line and f"'{typo}'" in message for number, message in found), found


def test_a_module_that_several_nodes_need_is_wrong_once(workspace: Any) -> None:
    workspace.write("msgs/touch.py", "import nowhere_at_all\n")
    ((line, text),) = problems_of(workspace, VALID)
    assert line == 9
    assert "msgs/touch.py:1: ModuleNotFoundError: No module named 'nowhere_at_all'" in text
