"""``palp node``, ``service``, ``param``, ``lifecycle``, ``interface`` and ``topic pub`` on a graph."""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.support.palp import PATIENCE_S, Palp
from tests.support.talkative import Talk, talk

__all__ = ["talk"]


def node_process(graph: Talk, name: str) -> psutil.Process:
    listed: Any = graph.told("node", "list")
    return psutil.Process(next(node["pid"] for node in listed if node["name"] == name))


def test_nodes_are_listed_and_told_of(talk: Talk) -> None:
    assert [line.split()[0] for line in talk.said("node", "list").splitlines()] == ["/source", "/scale"]
    assert talk.said("node", "list", "-c") == "2\n"
    told: Any = talk.told("node", "info", "/scale")
    assert told["lifecycle"] == "active"
    assert list(told["inputs"]) == ["/source/sample", "/scale/load"]
    assert told["external"] == ["load"]
    said = talk.said("node", "info", "scale")
    assert "/scale/weigh: WeighRequest -> WeighReply" in said
    assert "_order" not in said
    assert "_order" in talk.said("node", "info", "scale", "--include-hidden")
    assert "did you mean '/scale'" in talk.refused("node", "info", "/scael")


def test_services_are_listed_found_and_called(talk: Talk) -> None:
    assert talk.said("service", "list", "-t") == "/scale/weigh [WeighRequest -> WeighReply]\n"
    assert talk.said("service", "type", "/scale/weigh") == "WeighRequest -> WeighReply\n"
    assert talk.said("service", "find", "WeighReply") == "/scale/weigh\n"
    reply: Any = talk.told("service", "call", "/scale/weigh", "WeighRequest", "{factor: 2}")
    again: Any = talk.told("service", "call", "/scale/weigh")
    assert again["asked_count"] == reply["asked_count"] + 1
    assert talk.said("service", "call", "/scale/weigh").startswith("WeighReply:\n  load_n: ")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("/scale/wiegh",), "did you mean '/scale/weigh'"),
        (("/scale/weigh", "{factr: 2}"), "factr: no such field; did you mean 'factor'"),
        (("/scale/weigh", "{factor: x}"), "factor: expected an integer, got 'x'"),
        (("/scale/weigh", "{factor: -1}"), "factor"),  # the type's bounds are the node's to check
        (("/scale/weigh", "Sample", "{}"), "takes WeighRequest, not Sample"),
        (("/scale/weigh", "A", "B"), "too many words"),
    ],
)
def test_a_call_that_does_not_fit_is_refused(talk: Talk, words: tuple[str, ...], said: str) -> None:
    assert said in talk.refused("service", "call", *words)


def test_a_retried_call_is_made_once(talk: Talk) -> None:
    before: Any = talk.told("service", "call", "/scale/weigh")
    slow: Any = talk.told(
        "service", "call", "/scale/weigh", "{factor: 101}", "--timeout", "1", "--retries", "9"
    )
    assert slow["asked_count"] == before["asked_count"] + 1
    after: Any = talk.told("service", "call", "/scale/weigh")
    assert after["asked_count"] == before["asked_count"] + 2


def test_a_call_to_a_stopped_node_ends_in_time_and_says_why(palp: Palp, tmp_path: Path) -> None:
    graph = Talk(palp, tmp_path)
    process = node_process(graph, "/scale")
    process.suspend()
    said = graph.refused("service", "call", "/scale/weigh", "--timeout", "0.5")
    assert "/scale did not answer" in said
    assert f"kill -CONT {process.pid}" in said
    doctor = graph.run("doctor")
    assert doctor.returncode == 1
    assert "/scale did not answer 'info'" in doctor.stdout
    lists = graph.run("service", "list", "--timeout", "0.5")
    assert lists.returncode == 0
    assert "/scale did not answer" in lists.stderr
    process.resume()
    assert graph.said("service", "call", "/scale/weigh", "--json")


def test_parameters_are_listed_got_and_described(talk: Talk) -> None:
    assert talk.said("param", "list", "/source").splitlines()[1:] == [
        "  rate_hz",
        "  rare_hz",
        "  name",
        "  device",
    ]
    assert talk.told("param", "list", "--filter", "^r") == {"/source": ["rate_hz", "rare_hz"], "/scale": []}
    assert talk.said("param", "get", "/source", "rare_hz") == "Float value is: 0.001\n"
    assert talk.said("param", "get", "/source", "rare_hz", "--hide-type") == "0.001\n"
    told: Any = talk.told("param", "describe", "/source", "rare_hz", "device")
    assert told["rare_hz"]["unit"] == "Hz"
    assert told["device"]["read_only"] is True
    assert "did you mean 'rate_hz'" in talk.refused("param", "get", "/source", "rat_hz")


def test_set_tells_what_changed_and_a_text_stays_a_text(talk: Talk) -> None:
    assert talk.said("param", "set", "/source", "name", "on") == "name: block -> on\n"
    assert talk.said("param", "set", "/source", "name", "on") == "name: is on already\n"
    assert talk.told("param", "set", "source", "name", "5") == {
        "changed": {"name": {"from": "on", "to": "5"}}
    }
    assert talk.said("param", "set", "/source", "rare_hz", "2e-3", "name", "block").splitlines() == [
        "rare_hz: 0.001 -> 0.002",
        "name: 5 -> block",
    ]
    assert talk.said("param", "get", "/source", "name", "--hide-type") == "block\n"
    assert talk.said("param", "set", "/source", "rare_hz", "1e-3")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rate_hz", "fast"), "rate_hz"),
        (("rate_hz", "1", "name"), "has no value"),
        (("rate_hz", "-1"), ">= 0.001"),
        (("rate_hz", "1", "--jsno"), "parameter '--jsno' has no value"),
        (("rat_hz", "1"), "did you mean 'rate_hz'?; nothing was set"),
        (("device", "real"), "device"),
    ],
)
def test_a_change_that_does_not_fit_is_refused(talk: Talk, words: tuple[str, ...], said: str) -> None:
    assert said in talk.refused("param", "set", "/source", *words)


def test_of_changes_that_do_not_all_fit_none_is_made(talk: Talk) -> None:
    before = talk.told("param", "dump", "/source")
    assert "rate_hz" in talk.refused("param", "set", "/source", "name", "x", "rate_hz", "0")
    assert talk.told("param", "dump", "/source") == before


def test_what_is_dumped_can_be_loaded(talk: Talk, tmp_path: Path) -> None:
    file = tmp_path / "source.yaml"
    dumped = talk.said("param", "dump", "/source")
    file.write_text(dumped)
    assert dumped.startswith("/source:\n  ros__parameters:\n    rate_hz: 100.0\n")
    assert talk.said("param", "load", "/source", file) == "nothing to change\n"
    file.write_text(dumped.replace("name: block", "name: brick"))
    assert talk.said("param", "load", "/source", file) == "name: block -> brick\n"
    assert "'/source' is not /scale" in talk.refused("param", "load", "/scale", file)
    file.write_text(dumped.replace("rare_hz", "rar_hz"))
    assert f"{file}:4:5: /source has no parameter 'rar_hz'" in talk.refused("param", "load", "/source", file)
    assert talk.said("param", "set", "/source", "name", "block")


def test_a_node_is_led_through_its_lifecycle(palp: Palp, tmp_path: Path) -> None:
    graph = Talk(palp, tmp_path)
    assert graph.told("lifecycle", "nodes") == ["/source", "/scale"]
    assert graph.told("lifecycle", "get") == {"/source": "active", "/scale": "active"}
    assert graph.said("lifecycle", "list", "/source").startswith(
        "- deactivate\n\tStart: active\n\tGoal: inactive"
    )
    assert graph.said("lifecycle", "set", "/source", "deactivate") == "/source: active -> inactive\n"
    assert graph.said("lifecycle", "get", "/source") == "inactive\n"
    assert "cannot deactivate a node that is inactive" in graph.refused(
        "lifecycle", "set", "/source", "deactivate"
    )
    assert graph.refused("lifecycle", "set", "/source", "dance")
    doctor = graph.run("doctor")
    assert "/source: it is inactive: it handles nothing" in doctor.stdout
    assert graph.said("lifecycle", "set", "/source", "activate") == "/source: inactive -> active\n"
    assert graph.said("topic", "echo", "/source/sample", "--once")


def test_types_are_shown_from_the_graph_in_three_forms(talk: Talk) -> None:
    names = {entry["name"] for entry in json.loads(talk.said("interface", "list", "--json"))}
    assert {"Sample", "Load", "Seen", "WeighRequest", "WeighReply", "GraphHealth"} <= names
    assert (
        talk.said("interface", "show", "Sample").splitlines()[-1] == "    torque_n_m: NDArray[float64]  # N m"
    )
    assert "float64[] torque_n_m  # N m\n" in talk.said(
        "interface", "show", "msgs.talk:Sample", "--as", "ros"
    )
    schema = json.loads(talk.said("interface", "show", "WeighReply", "--as", "json-schema"))
    assert list(schema["properties"]) == ["load_n", "asked_count"]
    assert "did you mean 'Sample'" in talk.refused("interface", "show", "Sampel")


def until_it_weighs(talk: Talk, load_n: float) -> None:
    """Ask until the last message has had its turn: it is in the node's inbox, a call is not."""
    told: Any = None
    while told is None or told["load_n"] != load_n:
        told = talk.told("service", "call", "/scale/weigh")


def test_a_message_from_outside_reaches_its_node(talk: Talk) -> None:
    listener = talk.palp.start("topic", "echo", "/scale/seen", "--once", "--json", "--timeout", "60")
    words = ("topic", "pub", "-r", "20", "/scale/load", "Load", "{load_n: 2, samples: [0.5, 1e-1], note: on}")
    sender = talk.palp.start(*words)
    said, _ = listener.communicate(timeout=PATIENCE_S)
    assert json.loads(said) == {"load_n": 2.6, "note": "on"}
    sender.send_signal(signal.SIGINT)
    assert sender.wait(PATIENCE_S) == 130


def test_fields_that_are_not_given_are_the_types_defaults(talk: Talk) -> None:
    assert talk.said("topic", "pub", "--once", "/scale/load", "{load_n: 1, samples: []}").startswith(
        "publishing #1"
    )
    until_it_weighs(talk, 1.0)


def test_a_stream_of_messages_is_taken_from_standard_input(talk: Talk) -> None:
    text = "load_n: 1\nsamples: [1]\n---\nload_n: 2\nsamples: [1]\n---\n"
    command = talk.palp.command("topic", "pub", "/scale/load", "--stdin", "-r", "100", "--json")
    done = subprocess.run(
        command,
        input=text,
        env=talk.palp.environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    first, second = (json.loads(line) for line in done.stdout.splitlines())
    assert second["sequence"] == first["sequence"] + 1
    until_it_weighs(talk, 3.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("/source/sample", "{index: 1}"), "is published by /source, and a topic has one publisher"),
        (("/scale/laod", "{}"), "did you mean '/scale/load'"),
        (("/scale/load", "Sample", "{}"), "takes Load, not Sample"),
        (("/scale/load", "{load: 1}"), "load: no such field; did you mean 'load_n'"),
        (("/scale/load", "{load_n: heavy}"), "load_n: expected a number, got 'heavy'"),
        (("/scale/load", "{samples: []}"), "load_n"),
        (("/scale/load", "{load_n: 1e30, samples: []}"), "load_n"),
        (("/scale/load", "{load_n: 1, samples: [1, x]}"), r"samples[1]: expected a number"),
        (("/scale/load", "load_n: 1\nload_n: 2"), "message:2:1: key 'load_n' is given twice"),
    ],
)
def test_what_cannot_be_published_is_refused_by_name(talk: Talk, words: tuple[str, ...], said: str) -> None:
    assert said in talk.refused("topic", "pub", "-1", *words)
