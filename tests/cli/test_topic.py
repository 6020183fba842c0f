"""``palp topic`` on a running graph."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
from pathlib import Path
from typing import Any, cast

import psutil
import pytest

from tests.support.palp import PATIENCE_S, Palp
from tests.support.talkative import Talk, talk

__all__ = ["talk"]

TOPIC = "/source/sample"


def test_topics_are_listed_in_ros_words(talk: Talk) -> None:
    assert TOPIC in talk.said("topic", "list").splitlines()
    assert f"{TOPIC} [Sample]" in talk.said("topic", "list", "-t").splitlines()
    assert int(talk.said("topic", "list", "-c")) == len(talk.said("topic", "list").splitlines())
    assert "published by /source" in talk.said("topic", "list", "-v")


@pytest.mark.parametrize("flag", ["-a", "--include-hidden-topics"])
def test_hidden_names_are_shown_when_asked_for(talk: Talk, flag: str) -> None:
    assert "/_" not in talk.said("topic", "list")
    assert "/source/_order" in talk.said("topic", "list", flag).splitlines()


def test_info_tells_both_ends_and_their_accounts(talk: Talk) -> None:
    found: Any = talk.told("topic", "info", TOPIC)
    assert found["publisher"]["node"] == "/source"
    assert found["publisher"]["qos"]["durability"] == "transient_local"
    assert [reader["node"] for reader in found["readers"]] == ["/scale"]
    assert found["readers"][0]["received"] > 0
    assert found["readers"][0]["lost"] == 0
    said = talk.said("topic", "info", TOPIC, "--verbose")
    assert "Publisher count: 1\n" in said
    assert "durability: transient_local" in said


def test_a_name_without_its_slash_is_understood_and_a_wrong_one_gets_a_hint(talk: Talk) -> None:
    assert talk.said("topic", "type", TOPIC[1:]) == "Sample\n"
    assert talk.said("topic", "find", "Sample").splitlines() == [TOPIC, "/source/rare"]
    assert talk.said("topic", "find", "msgs/msg/Sample", "-c") == "2\n"
    assert "did you mean 'Sample'" in talk.refused("topic", "find", "Sampel")
    assert "did you mean '/source/sample'" in talk.refused("topic", "echo", "/source/smaple", "--once")
    assert "did you mean '/scale/_order'" in talk.refused("topic", "echo", "/scale/_oder", "--once")
    assert "did you mean 'talk'" in talk.refused("topic", "list", "--graph", "tlak")


def echoed(talk: Talk, *words: object) -> list[Any]:
    return [json.loads(line) for line in talk.said("topic", "echo", TOPIC, "--json", *words).splitlines()]


def test_echo_prints_every_message_in_order(talk: Talk) -> None:
    indices = [message["index"] for message in echoed(talk, "-n", "20")]
    assert indices == list(range(indices[0], indices[0] + 20))


def test_echo_shows_one_field_down_to_an_element(talk: Talk) -> None:
    (message,) = echoed(talk, "--once")
    assert list(message) == ["stamp_ns", "index", "name", "torque_n_m"]
    assert echoed(talk, "--once", "--field", "name") == ["block"]
    values = talk.said("topic", "echo", TOPIC, "-n", "3", "--csv", "--field", "torque_n_m[0]").split()
    assert [(float(b) - float(a)) % 100 for a, b in itertools.pairwise(values)] == [1.0, 1.0]
    assert "did you mean 'torque_n_m'" in talk.refused("topic", "echo", TOPIC, "--field", "torqe_n_m")


def test_echo_has_ros_2s_forms(talk: Talk) -> None:
    assert talk.said("topic", "echo", TOPIC, "--once", "--no-arr").endswith("torque_n_m: <array of 3>\n---\n")
    assert "'... 2 more'" in talk.said("topic", "echo", TOPIC, "--once", "-l", "1")
    assert "more" not in talk.said("topic", "echo", TOPIC, "--once", "-l", "1", "-f")
    assert "name: '<string length: 5>'" in talk.said("topic", "echo", TOPIC, "--once", "--no-str")
    assert "carries Sample, not Seen" in talk.refused("topic", "echo", TOPIC, "Seen")


def test_echo_tells_sequence_and_stamp_when_asked(talk: Talk) -> None:
    told = echoed(talk, "-n", "2", "-i")
    first, second = (entry["info"] for entry in told)
    assert second["sequence"] == first["sequence"] + 1
    assert first["stamp_ns"] == told[0]["message"]["stamp_ns"]


def test_a_late_joiner_gets_the_history_first_without_a_hole(talk: Talk) -> None:
    told = echoed(talk, "-n", "25", "-i", "--qos-durability", "transient_local")
    sequences = [entry["info"]["sequence"] for entry in told]
    assert sequences == list(range(sequences[0], sequences[0] + 25))
    now: Any = talk.told("topic", "info", TOPIC)
    assert now["publisher"]["sequence"] >= sequences[-1]


def test_a_request_that_the_publisher_does_not_offer_is_refused(talk: Talk) -> None:
    said = talk.refused("topic", "echo", "/source/rare", "--qos-durability", "transient_local")
    assert "the publisher offers volatile" in said


def test_the_launchers_own_topics_are_topics_too(talk: Talk) -> None:
    assert "  /graph: 1 published\n    reliability: reliable\n" in talk.said(
        "topic", "info", "/graph/events", "-v"
    )
    assert "/graph/health: GraphHealth, " in talk.said("node", "info", "/graph")
    qos = ("--qos-durability", "transient_local")
    done = talk.said("topic", "echo", "/graph/events", "--once", "--json", *qos)
    assert json.loads(done)["kind"] == "started"


def test_hz_tells_the_publishers_rate_and_the_readers_account(talk: Talk) -> None:
    found: Any = talk.told("topic", "hz", TOPIC, "-w", "50")
    assert found["hz"] > 0.0  # how much is told exactly in simulated time
    assert found["messages"] >= 51
    assert found["lost"] == 0
    assert found["readers"][0]["node"] == "/scale"
    assert found["readers"][0]["received"] > 0


def test_hz_of_several_topics_names_the_one_that_is_too_rare(talk: Talk) -> None:
    done = talk.run("topic", "hz", "/source/rare", TOPIC, "--once", "--timeout", "0.5")
    assert done.returncode == 2
    assert "/source/rare: fewer than two messages within 0.5 s (" in done.stderr
    assert "published so far" in done.stderr


def test_hz_of_a_rare_topic_says_that_it_is_silent(talk: Talk) -> None:
    process = talk.palp.start("topic", "hz", "/source/rare")
    assert process.stderr is not None
    assert "/source/rare: no new message for" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == 130


def test_bandwidth_is_size_times_rate(talk: Talk) -> None:
    found: Any = talk.told("topic", "bw", TOPIC, "-w", "100")
    assert found["bytes_per_s"] > 0.0
    assert 32 < found["min_bytes"] <= found["mean_bytes"] <= found["max_bytes"]
    assert "Message size mean:" in talk.said("topic", "bw", TOPIC, "-w", "5", "--once")


def test_delay_is_what_the_readers_have_counted(talk: Talk) -> None:
    (scale,) = [node["pid"] for node in cast(Any, talk.told("node", "list")) if node["name"] == "/scale"]
    psutil.Process(scale).suspend()
    waiting = echoed(talk, "-n", "20")
    psutil.Process(scale).resume()
    (reader,) = echoed_to(talk, waiting[-1]["index"])
    assert reader["latency_s"]["max"] >= (waiting[-1]["stamp_ns"] - waiting[0]["stamp_ns"]) / 1e9
    found: Any = talk.told("topic", "delay", TOPIC, "-w", "20")
    (reader,) = found["readers"]
    assert reader["messages"] == 20 <= reader["received"]
    assert "of the last" in talk.said("topic", "delay", TOPIC, "-w", "20", "--once")
    assert "its latency is not counted" in talk.run("topic", "delay", "/scale/seen", "--once").stderr


def echoed_to(talk: Talk, index: int) -> list[Any]:
    """What the topic's readers have counted once they have had the message of that index; the first has 0."""
    while True:
        found: Any = talk.told("topic", "delay", TOPIC)
        if all(reader["received"] > index for reader in found["readers"]):
            return list(found["readers"])
        echoed(talk, "--once")


def test_ctrl_c_ends_an_echo_without_a_word(talk: Talk) -> None:
    process = talk.palp.start("topic", "echo", TOPIC)
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert errors == ""


def test_a_reader_that_hangs_up_ends_an_echo(talk: Talk) -> None:
    command = " ".join(map(str, talk.palp.command("topic", "echo", TOPIC)))
    done = subprocess.run(
        ["bash", "-c", f"{command} | head -n 1; exit ${{PIPESTATUS[0]}}"],
        env=talk.palp.environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 141
    assert done.stdout.startswith("stamp_ns: ")
    assert done.stderr == ""


def test_a_message_of_any_workspace_is_shown_without_its_classes(talk: Talk, tmp_path: Path) -> None:
    environment = talk.palp.environment | {"PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    command = talk.palp.command("topic", "echo", TOPIC, "--once", "--json", "--graph", "talk")
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["name"] == "block"


def test_when_the_graph_ends_an_echo_says_so_and_ends(palp: Palp, tmp_path: Path) -> None:
    graph = Talk(palp, tmp_path)
    process = palp.start("topic", "echo", TOPIC, "--csv", "--field", "index")
    assert process.stdout is not None
    process.stdout.readline()
    graph.process.terminate()
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert graph.process.wait(PATIENCE_S) == 143
    assert process.returncode == 0
    assert errors.splitlines()[-1] == "graph 'talk' has ended"
