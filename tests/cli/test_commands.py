"""The verbs on a running graph: what they print, for people and for machines, and what they refuse."""

from __future__ import annotations

import itertools
import json
import os
import pty
import re
import select
import shlex
import signal
import subprocess
from pathlib import Path
from typing import Any, cast

import psutil
import pytest

from tests.support.palp import PATIENCE_S, Palp, end
from tests.support.talkative import Talk, talk

__all__ = ["talk"]

TOPIC = "/source/sample"
PRINTED = {
    "topic list": [f"{TOPIC}\n", "!/_"],
    "topic list -t": [f"{TOPIC} [Sample]\n"],
    "topic list -v": ["published by /source"],
    "topic list -a": ["/source/_order\n"],
    "topic list --include-hidden-topics": ["/source/_order\n"],
    f"topic info {TOPIC} -v": ["Publisher count: 1\n", "durability: transient_local"],
    "topic info /graph/events -v": ["  /graph: 1 published\n    reliability: reliable\n"],
    f"topic type {TOPIC[1:]}": ["=Sample\n"],
    "topic find Sample": [f"={TOPIC}\n/source/rare\n"],
    "topic find msgs/msg/Sample -c": ["=2\n"],
    f"topic echo {TOPIC} --once --no-arr": ["torque_n_m: <array of 3>\n---\n"],
    f"topic echo {TOPIC} --once -l 1": ["'... 2 more'"],
    f"topic echo {TOPIC} --once -l 1 -f": ["!more"],
    f"topic echo {TOPIC} --once --no-str": ["name: '<string length: 5>'"],
    f"topic bw {TOPIC} -w 5 --once": ["Message size mean:"],
    "topic delay /scale/seen --once": ["its latency is not counted"],
    "node list -c": ["=2\n"],
    "node info scale": ["/scale/weigh: WeighRequest -> WeighReply", "!_order"],
    "node info scale --include-hidden": ["_order"],
    "node info /graph": ["/graph/health: GraphHealth, "],
    "service list -t": ["=/scale/weigh [WeighRequest -> WeighReply]\n"],
    "service type /scale/weigh": ["=WeighRequest -> WeighReply\n"],
    "service find WeighReply": ["=/scale/weigh\n"],
    "service call /scale/weigh": ["WeighReply:\n  load_n: "],
    "param list /source": ["/source:\n  rate_hz\n  rare_hz\n  name\n  device\n"],
    "param get /source rare_hz": ["=Float value is: 0.001\n"],
    "param get /source rare_hz --hide-type": ["=0.001\n"],
    "lifecycle list /source": ["- deactivate\n\tStart: active\n\tGoal: inactive"],
    "interface show msgs.talk:Sample": ["float64[] torque_n_m  # N m\n"],
    "topic pub --once /scale/load '{load_n: 1, samples: []}'": ["publishing #1"],
    "top --once": ["NODE ", "STATE ", "READERS LOST", "TOPIC "],
}
"""What a command prints; with ``=`` all of it, with ``!`` what it does not."""
REFUSED = {
    "topic find Sampel": "did you mean 'Sample'",
    "topic echo /source/smaple --once": "did you mean '/source/sample'",
    "topic echo /scale/_oder --once": "did you mean '/scale/_order'",
    "topic list --graph tlak": "did you mean 'talk'",
    f"topic echo {TOPIC} --field torqe_n_m": "did you mean 'torque_n_m'",
    f"topic echo {TOPIC} Seen": "carries Sample, not Seen",
    "topic echo /source/rare --qos-durability transient_local": "the publisher offers volatile",
    f"topic hz /source/rare {TOPIC} --once --timeout 0.5": "/source/rare: fewer than two messages within 0.5",
    "node info /scael": "did you mean '/scale'",
    "service call /scale/wiegh": "did you mean '/scale/weigh'",
    "service call /scale/weigh '{factr: 2}'": "factr: no such field; did you mean 'factor'",
    "service call /scale/weigh '{factor: x}'": "factor: expected an integer, got 'x'",
    "service call /scale/weigh '{factor: -1}'": "factor",  # the type's bounds are the node's to check
    "service call /scale/weigh Sample {}": "takes WeighRequest, not Sample",
    "service call /scale/weigh A B": "too many words",
    "param get /source rat_hz": "did you mean 'rate_hz'",
    "param set /source rate_hz fast": "rate_hz",
    "param set /source rate_hz 1 name": "has no value",
    "param set /source rate_hz -1": "rate_hz must be a number of at least 0.001",
    "param set /source rate_hz 1 --jsno": "parameter '--jsno' has no value",
    "param set /source rat_hz 1": "did you mean 'rate_hz'?; nothing was set",
    "param set /source device real": "device",
    "interface show Sampel": "did you mean 'Sample'",
    f"topic pub -1 {TOPIC} '{{index: 1}}'": "is published by /source, and a topic has one publisher",
    "topic pub -1 /scale/laod {}": "did you mean '/scale/load'",
    "topic pub -1 /scale/load Sample {}": "takes Load, not Sample",
    "topic pub -1 /scale/load '{load: 1}'": "load: no such field; did you mean 'load_n'",
    "topic pub -1 /scale/load '{load_n: heavy}'": "load_n: expected a number, got 'heavy'",
    "topic pub -1 /scale/load '{samples: []}'": "not a Load: load_n is missing",
    "topic pub -1 /scale/load '{load_n: 1e30, samples: []}'": "load_n must be",
    "topic pub -1 /scale/load '{load_n: 1, samples: [1, x]}'": "samples[1]: expected a number",
    "topic pub -1 /scale/load 'load_n: 1\nload_n: 2'": "message:2:1: key 'load_n' is given twice",
}
"""Why a command is refused, with status 2."""


@pytest.mark.parametrize("line", PRINTED)
def test_a_command_prints(talk: Talk, line: str) -> None:
    done = talk.run(*shlex.split(line))
    assert done.returncode == 0, done.stderr
    for text in PRINTED[line]:
        if text.startswith("="):
            assert done.stdout == text[1:]
        else:
            assert (text.removeprefix("!") in done.stdout + done.stderr) is not text.startswith("!")


@pytest.mark.parametrize("line", REFUSED)
def test_a_command_is_refused_with_the_reason(talk: Talk, line: str) -> None:
    assert REFUSED[line] in talk.refused(*shlex.split(line))


def echoed(talk: Talk, *words: object) -> list[Any]:
    return [json.loads(line) for line in talk.printed("topic", "echo", TOPIC, "--json", *words).splitlines()]


def test_info_has_both_ends_and_their_accounts(talk: Talk) -> None:
    found: Any = talk.answered("topic", "info", TOPIC)
    assert (found["publisher"]["node"], found["publisher"]["qos"]["depth"] > 0) == ("/source", True)
    (reader,) = found["readers"]
    assert (reader["node"], reader["received"] > 0, reader["lost"]) == ("/scale", True, 0)
    node: Any = talk.answered("node", "info", "/scale")
    assert (node["lifecycle"], node["external"]) == ("active", ["load"])
    assert list(node["inputs"]) == [TOPIC, "/scale/load"]


def test_echo_prints_messages_in_order_with_sequence_and_stamp_one_field_or_an_element(talk: Talk) -> None:
    entries = echoed(talk, "-n", "20", "-i")
    indices = [entry["message"]["index"] for entry in entries]
    sequences = [entry["info"]["sequence"] for entry in entries]
    assert indices == list(range(indices[0], indices[0] + 20))
    assert sequences == list(range(sequences[0], sequences[0] + 20))
    assert entries[0]["info"]["stamp_ns"] == entries[0]["message"]["stamp_ns"]
    assert list(entries[0]["message"]) == ["stamp_ns", "index", "name", "torque_n_m"]
    assert echoed(talk, "--once", "--field", "name") == ["block"]
    values = talk.printed("topic", "echo", TOPIC, "-n", "3", "--csv", "--field", "torque_n_m[0]").split()
    assert [(float(b) - float(a)) % 100 for a, b in itertools.pairwise(values)] == [1.0, 1.0]


def test_a_late_joiner_gets_the_history_first_without_a_hole(talk: Talk) -> None:
    latched = ("--qos-durability", "transient_local")
    sequences = [entry["info"]["sequence"] for entry in echoed(talk, "-n", "25", "-i", *latched)]
    assert sequences == list(range(sequences[0], sequences[0] + 25))
    done = talk.printed("topic", "echo", "/graph/events", "--once", "--json", *latched)
    assert json.loads(done)["kind"] == "started"


def test_hz_and_bw_measure_what_the_publisher_sends_and_the_reader_counts(talk: Talk) -> None:
    found: Any = talk.answered("topic", "hz", TOPIC, "-w", "50")
    assert found["hz"] > 0.0  # how much is exact in simulated time
    assert (found["messages"] >= 51, found["lost"], found["readers"][0]["node"]) == (True, 0, "/scale")
    size: Any = talk.answered("topic", "bw", TOPIC, "-w", "100")
    assert size["bytes_per_s"] > 0.0
    assert 32 < size["min_bytes"] <= size["mean_bytes"] <= size["max_bytes"]


def test_hz_of_a_rare_topic_reports_that_it_is_silent(talk: Talk) -> None:
    process = talk.palp.start("topic", "hz", "/source/rare")
    assert process.stderr is not None
    assert "/source/rare: no new message for" in process.stderr.readline()
    end(process)


def test_delay_is_what_the_readers_have_counted(talk: Talk) -> None:
    scale = node_process(talk, "/scale")
    scale.suspend()
    waiting = echoed(talk, "-n", "20")
    scale.resume()
    while True:
        (reader,) = cast(Any, talk.answered("topic", "delay", TOPIC))["readers"]
        if reader["received"] > waiting[-1]["index"]:
            break
        echoed(talk, "--once")
    assert reader["latency_s"]["max"] >= (waiting[-1]["stamp_ns"] - waiting[0]["stamp_ns"]) / 1e9
    (reader,) = cast(Any, talk.answered("topic", "delay", TOPIC, "-w", "20"))["readers"]
    assert reader["messages"] == 20 <= reader["received"]
    assert "of the last 20 messages" in talk.printed("topic", "delay", TOPIC, "-w", "20", "--once")


def test_ctrl_c_ends_an_echo_without_a_word(talk: Talk) -> None:
    process = talk.palp.start("topic", "echo", TOPIC)
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (130, "")


def test_a_reader_that_hangs_up_ends_an_echo(talk: Talk) -> None:
    command = " ".join(map(str, talk.palp.command("topic", "echo", TOPIC)))
    pipe = ["bash", "-c", f"{command} | head -n 1; exit ${{PIPESTATUS[0]}}"]
    done = subprocess.run(
        pipe, env=talk.palp.environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert (done.returncode, done.stderr) == (141, "")
    assert done.stdout.startswith("stamp_ns: ")


def test_a_message_of_any_workspace_is_shown_without_its_classes(talk: Talk, tmp_path: Path) -> None:
    environment = talk.palp.environment | {"PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    command = talk.palp.command("topic", "echo", TOPIC, "--once", "--json", "--graph", "talk")
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["name"] == "block"


def test_when_the_graph_ends_an_echo_ends(palp: Palp, tmp_path: Path) -> None:
    graph = Talk(palp, tmp_path)
    process = palp.start("topic", "echo", TOPIC, "--csv", "--field", "index")
    assert process.stdout is not None
    process.stdout.readline()
    graph.process.terminate()
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert graph.process.wait(PATIENCE_S) == 143
    assert (process.returncode, errors.splitlines()[-1]) == (0, "graph 'talk' has ended")


def node_process(graph: Talk, name: str) -> psutil.Process:
    listed: Any = graph.answered("node", "list")
    return psutil.Process(next(node["pid"] for node in listed if node["name"] == name))


def test_a_retried_call_is_made_once(talk: Talk) -> None:
    before: Any = talk.answered("service", "call", "/scale/weigh")
    slow: Any = talk.answered(
        "service", "call", "/scale/weigh", "{factor: 101}", "--timeout", "1", "--retries", "9"
    )
    assert slow["asked_count"] == before["asked_count"] + 1
    after: Any = talk.answered("service", "call", "/scale/weigh")
    assert after["asked_count"] == before["asked_count"] + 2


def test_a_call_to_a_stopped_node_ends_in_time_with_the_reason(palp: Palp, tmp_path: Path) -> None:
    graph = Talk(palp, tmp_path)
    process = node_process(graph, "/scale")
    process.suspend()
    why = graph.refused("service", "call", "/scale/weigh", "--timeout", "0.5")
    assert "/scale did not answer" in why
    assert f"kill -CONT {process.pid}" in why
    assert "/scale did not answer" in graph.refused("topic", "pub", "/scale/load", "-1", "--timeout", "0.5")
    doctor = graph.run("doctor")
    assert (doctor.returncode, "/scale did not answer 'info'" in doctor.stdout) == (1, True)
    lists = graph.run("service", "list", "--timeout", "0.5")
    assert (lists.returncode, "/scale did not answer" in lists.stderr) == (0, True)
    process.resume()
    assert graph.printed("service", "call", "/scale/weigh", "--json")


def test_parameters_are_listed_described_and_set_all_or_none(talk: Talk) -> None:
    assert talk.answered("param", "list", "--filter", "^r") == {
        "/source": ["rate_hz", "rare_hz"],
        "/scale": [],
    }
    described: Any = talk.answered("param", "describe", "/source", "rare_hz", "device")
    assert (described["rare_hz"]["unit"], described["device"]["read_only"]) == ("Hz", True)
    for value, line in (("on", "name: block -> on\n"), ("on", "name: is on already\n")):
        assert talk.printed("param", "set", "/source", "name", value) == line
    changed = {"changed": {"name": {"from": "on", "to": "5"}}}  # a text stays one
    assert talk.answered("param", "set", "source", "name", "5") == changed
    before = talk.answered("param", "dump", "/source")
    assert "rate_hz" in talk.refused("param", "set", "/source", "name", "x", "rate_hz", "0")
    assert talk.answered("param", "dump", "/source") == before
    both = talk.printed("param", "set", "/source", "rare_hz", "2e-3", "name", "block").splitlines()
    assert both == ["rare_hz: 0.001 -> 0.002", "name: 5 -> block"]
    assert talk.printed("param", "set", "/source", "rare_hz", "1e-3")


def test_what_is_dumped_can_be_loaded(talk: Talk, tmp_path: Path) -> None:
    file = tmp_path / "source.yaml"
    dumped = talk.printed("param", "dump", "/source")
    file.write_text(dumped)
    assert dumped.startswith("/source:\n  ros__parameters:\n    rate_hz: 100.0\n")
    assert talk.printed("param", "load", "/source", file) == "nothing to change\n"
    file.write_text(dumped.replace("name: block", "name: brick"))
    assert talk.printed("param", "load", "/source", file) == "name: block -> brick\n"
    assert "'/source' is not /scale" in talk.refused("param", "load", "/scale", file)
    file.write_text(dumped.replace("rare_hz", "rar_hz"))
    assert f"{file}:4:5: /source has no parameter 'rar_hz'" in talk.refused("param", "load", "/source", file)
    assert talk.printed("param", "set", "/source", "name", "block")


def test_a_node_is_led_through_its_lifecycle(talk: Talk) -> None:
    assert talk.answered("lifecycle", "nodes") == ["/source", "/scale"]
    assert talk.answered("lifecycle", "get") == {"/source": "active", "/scale": "active"}
    assert talk.printed("lifecycle", "set", "/source", "deactivate") == "/source: active -> inactive\n"
    assert talk.printed("lifecycle", "get", "/source") == "inactive\n"
    again = talk.refused("lifecycle", "set", "/source", "deactivate")
    assert "cannot deactivate a node that is inactive" in again
    assert talk.refused("lifecycle", "set", "/source", "dance")
    assert "/source: it is inactive: it handles nothing" in talk.run("doctor").stdout
    assert talk.printed("lifecycle", "set", "/source", "activate") == "/source: inactive -> active\n"
    assert talk.printed("topic", "echo", TOPIC, "--once")


def test_types_are_those_of_the_graph_also_as_json_schema(talk: Talk) -> None:
    names = {entry["name"] for entry in json.loads(talk.printed("interface", "list", "--json"))}
    assert {"Sample", "Load", "Seen", "WeighRequest", "WeighReply", "GraphHealth"} <= names
    schema = json.loads(talk.printed("interface", "show", "WeighReply", "--json-schema"))
    assert list(schema["properties"]) == ["load_n", "asked_count"]


def test_messages_from_outside_reach_their_node_as_words_and_from_standard_input(talk: Talk) -> None:
    listener = talk.palp.start("topic", "echo", "/scale/seen", "--once", "--json", "--timeout", "60")
    words = ("topic", "pub", "-r", "20", "/scale/load", "Load", "{load_n: 2, samples: [0.5, 1e-1], note: on}")
    sender = talk.palp.start(*words)
    seen, _ = listener.communicate(timeout=PATIENCE_S)
    assert json.loads(seen) == {"load_n": 2.6, "note": "on"}
    end(sender)
    text = "load_n: 1\nsamples: [1]\n---\nload_n: 2\nsamples: [1]\n---\n"
    command = talk.palp.command("topic", "pub", "/scale/load", "--stdin", "-r", "100", "--json")
    done = subprocess.run(
        command, input=text, env=talk.palp.environment, capture_output=True, text=True, check=True
    )
    first, second = (json.loads(line) for line in done.stdout.splitlines())
    assert second["sequence"] == first["sequence"] + 1
    named = subprocess.run(
        command, input="--- # one\n", env=talk.palp.environment, capture_output=True, text=True, check=False
    )
    assert "'--- # one' between messages: a line of --- alone separates them" in named.stderr
    reply: Any = None
    while reply is None or reply["load_n"] != 3.0:  # the last message is in the node's inbox, a call is not
        reply = talk.answered("service", "call", "/scale/weigh")


PAGE = Path(__file__).parents[2] / "docs" / "reference" / "exit_codes.md"
ROW = re.compile(r"^\| (`[^|]+`) \| (.+) \|$", re.MULTILINE)
WORDS = {
    "topic info": ("/source/sample",),
    "topic type": ("/source/sample",),
    "topic hz": ("/source/sample", "-w", "5"),
    "topic bw": ("/source/sample", "-w", "5"),
    "topic delay": ("/source/sample",),
    "topic pub": ("-1", "/scale/load", "{load_n: 1, samples: []}"),
    "node info": ("/scale",),
    "service type": ("/scale/weigh",),
    "param get": ("/source", "name"),
    "param set": ("/source", "name", "block"),
    "interface show": ("Sample",),
    "bag play": (str(PAGE.parents[2] / "tests/golden/emg.mcap"), "--playback-duration", "0.2"),
}


def promises() -> dict[str, tuple[bool, list[str]]]:
    """Per verb whether a list comes, and the keys of what it holds."""
    found = {}
    table = PAGE.read_text(encoding="utf-8").partition("## Output for programs")[2]
    for verbs, keys in ROW.findall(table):
        for verb in re.findall("`([^`]+)`", verbs):
            found[verb] = (keys.startswith("a list of"), re.findall("`([^`]+)`", keys)[0].split())
    return found


def test_the_page_has_its_promises() -> None:
    assert set(WORDS) <= set(promises())


ASKED_ELSEWHERE = (
    "param load",
    "lifecycle set",
    *(f"action {verb}" for verb in ("info", "type", "send_goal", "cancel")),
)
"""The actions' in ``tests/graph/node/test_running_actions.py``, where there is one."""


@pytest.mark.parametrize("verb", [verb for verb in promises() if verb not in ASKED_ELSEWHERE])
def test_a_promised_key_is_there(talk: Talk, verb: str) -> None:
    is_list, keys = promises()[verb]
    done = talk.run(*verb.split(), *WORDS.get(verb, ()), "--json")
    assert done.returncode == 0, done.stderr
    found: Any = json.loads(done.stdout)
    assert isinstance(found, list) == is_list
    for entry in found if is_list else [found]:
        assert set(keys) <= set(entry)


def test_a_healthy_graph_has_no_error_and_a_report_says_what_was_looked_at(talk: Talk) -> None:
    done = talk.run("doctor", "--json", "--graph", "talk")
    found = json.loads(done.stdout)
    assert [f for f in found["findings"] if f["level"] == "error"] == []
    assert (done.returncode, found["error"]) == (0, 0)
    assert found["graphs"] == ["talk"]
    assert set(found["findings"][0]) == {"where", "level", "text", "advice"}
    printed = talk.run("doctor", "-r").stdout
    for part in ("usable", "open files", "2 of 2 nodes answer"):
        assert part in printed
    assert talk.run("doctor").stdout.splitlines()[-1].endswith("1 graph running")


def test_the_run_directory_of_a_killed_launcher_is_no_error(palp: Palp, tmp_path: Path) -> None:
    graph = Talk(palp, tmp_path)
    graph.process.kill()
    graph.process.wait()
    assert palp.all_gone()
    (folder,) = (palp.runtime_dir / "palp").iterdir()
    printed = graph.run("doctor", "-r").stdout
    assert f"1 run directory of runs that are over; the latest 20 are kept: {folder.name}" in printed
    assert graph.run("doctor").returncode == 0


def test_top_shows_nodes_and_edges_once(talk: Talk) -> None:
    shown: Any = talk.answered("top")
    assert [node["name"] for node in shown["nodes"]] == ["/source", "/scale"]
    assert all(node["responsive"] and node["memory_bytes"] > 0 for node in shown["nodes"])
    (edge,) = [edge for edge in shown["edges"] if edge["topic"] == "/source/sample"]
    assert edge["rate_hz"] > 0.0
    assert edge["lost"] == 0


def on_a_terminal(palp: Palp, *words: str) -> tuple[int, subprocess.Popen[bytes]]:
    master, slave = pty.openpty()
    process = subprocess.Popen(
        palp.command(*words),
        env=palp.environment | {"TERM": "xterm"},
        stdin=slave,
        stdout=slave,
        stderr=slave,
    )
    os.close(slave)
    return master, process


def read_until(master: int, pattern: str) -> str:
    printed = ""
    while not re.search(pattern, printed, re.DOTALL):
        assert select.select([master], [], [], PATIENCE_S)[0], printed
        printed += os.read(master, 65536).decode(errors="replace")
    return printed


def test_a_live_view_is_drawn_again_and_again_until_ctrl_c(talk: Talk) -> None:
    master, process = on_a_terminal(talk.palp, "top")
    read_until(master, r"NODE.*/source.*/scale.*TOPIC.*NODE.*/source")
    process.send_signal(signal.SIGINT)
    while process.poll() is None:  # a terminal without a reader would hold up its writer
        if select.select([master], [], [], 0.1)[0]:
            try:
                os.read(master, 65536)
            except OSError:
                break
    assert process.wait(PATIENCE_S) == 130
    os.close(master)


@pytest.mark.parametrize("compose", [pytest.param((), marks=pytest.mark.nightly), ("--compose",)])
def test_a_graph_in_simulated_time_is_asked_the_same_way(
    palp: Palp, tmp_path: Path, compose: tuple[str, ...]
) -> None:
    graph = Talk(palp, tmp_path, "clock:=sim", "wait_s:=0.005", *compose)
    rate: Any = graph.answered("topic", "hz", "/source/sample", "-w", "20")
    assert rate["clock"] == "sim"
    assert rate["hz"] == pytest.approx(100.0)
    assert rate["wall_hz"] is None or rate["wall_hz"] > 0  # twenty may come in one read: no time has passed
    width: Any = graph.answered("topic", "bw", "/source/sample", "-w", "20")
    assert width["bytes_per_clock_s"] == pytest.approx(100.0 * width["mean_bytes"])
    assert graph.answered("lifecycle", "get") == {"/source": "active", "/scale": "active"}
    assert graph.printed("param", "set", "/scale", "wait_s", "0.004") == "wait_s: 0.005 -> 0.004\n"
    messages = graph.printed(
        "topic", "echo", "/source/sample", "-n", "5", "--json", "--qos-reliability", "reliable"
    )
    indices = [json.loads(line)["index"] for line in messages.splitlines()]
    assert indices == list(range(indices[0], indices[0] + 5))
    shown: Any = graph.answered("top", "-d", "0.2")
    assert [node["state"] for node in shown["nodes"]] == ["active"] * 2
    assert graph.run("doctor").returncode == 0
    assert psutil.pid_exists(shown["nodes"][0]["pid"])
    graph.process.terminate()
    assert graph.process.wait(PATIENCE_S) == 143
