"""``palp top``, ``palp doctor``, and the verbs in simulated time."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.support.palp import PATIENCE_S, Palp
from tests.support.talkative import Talk, talk

__all__ = ["talk"]


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
