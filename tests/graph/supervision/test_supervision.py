"""What the supervisor promises: it notices, says, restarts by rule, and ends what it has started."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.node.spec import GRAPH_EVENTS, GRAPH_HEALTH
from palp_core.graph.supervision import interrupt
from palp_core.whole_file import is_locked
from tests.support.palp import CHAIN, FOREVER_NS, PATIENCE_S, Palp, end, wait_for_line
from tests.support.supervised import LAUNCH, TALK, Running
from tests.support.toys import Hostile, Pipe

ENDLESS = ("count:=1000000", "rate_hz:=50.0")


def start_chain(palp: Palp, *arguments: str) -> subprocess.Popen[str]:
    process = palp.start("launch", CHAIN, *ENDLESS, *arguments)
    wait_for_line(process, "blocks: 1/")
    return process


@pytest.fixture
def talkers(palp: Palp, tmp_path: Path) -> Hostile:
    made = Hostile(palp, tmp_path)
    made.write("nodes/talk.py", TALK)
    made.file = made.write("launch/talk.yaml", LAUNCH)
    return made


def test_a_stopped_node_is_called_unresponsive_and_then_responsive_again(palp: Palp) -> None:
    process = start_chain(palp)
    graph = Running(palp)
    graph.process("sink").suspend()
    assert "has sent no heartbeat" in graph.wait_for("unresponsive", "sink").text
    graph.process("sink").resume()
    graph.wait_for("responsive", "sink")
    assert not any(event.node in ("source", "relay") for event in graph.events())
    errors = end(process, signal.SIGTERM)
    assert re.search(r"sink has sent no heartbeat for \d+ s", errors)
    assert palp.all_gone()


@pytest.mark.slow
def test_a_node_that_stays_stopped_is_restarted_by_its_rule(palp: Palp) -> None:
    process = start_chain(palp)
    graph = Running(palp)
    graph.process("relay").suspend()
    assert re.search(r"was unresponsive for \d+ s", graph.wait_for("restarting", "relay").text)
    graph.wait_for_epoch("relay", "/relay/amplified", 1)
    end(process, signal.SIGTERM)


@pytest.mark.parametrize("how", [("clock:=wall",), ("clock:=sim", "--compose")])
def test_the_launcher_answers(palp: Palp, how: tuple[str, ...]) -> None:
    process = start_chain(palp, *how)
    graph = Running(palp)
    told = graph.ask("graph", "graph")
    assert told == graph.record
    assert [node["name"] for node in told["nodes"]] == ["source", "relay", "sink"]
    own = {topic["name"]: topic for topic in told["topics"] if topic["node"] == "graph"}
    types = {name: topic["type"] for name, topic in own.items()}
    assert types == {GRAPH_EVENTS: "GraphEvent", GRAPH_HEALTH: "GraphHealth"}
    assert graph.events()[0].kind == "started"
    assert "no operation 'dance'" in graph.ask("graph", "dance")["error"]
    end(process)
    assert palp.all_gone()


@pytest.mark.parametrize(
    ("deed", "cause", "words"),
    [
        ("mutter", "its process was killed by SIGKILL", "its last words (é), without an end of line"),
        ("crash", "its process was killed by SIGSEGV", "in crash"),
    ],
)
def test_the_reason_and_the_last_words_of_a_crash_are_in_the_message(
    talkers: Hostile, deed: str, cause: str, words: str
) -> None:
    talkers.palp.environment["PYTHONIOENCODING"] = "ascii"  # of the terminal: nodes write UTF-8
    done = talkers.palp.here("launch", talkers.file, f"deed:={deed}")
    assert done.returncode == 1
    assert f"talker: {cause}" in done.stderr
    assert words in done.stderr
    assert talkers.palp.all_gone()


def test_not_one_of_twenty_thousand_lines_is_missing_and_output_from_below_python_is_kept(
    talkers: Hostile,
) -> None:
    palp = talkers.palp
    assert palp.here("launch", talkers.file, "deed:=flood").returncode == 1
    graph = Running(palp)
    expected = [f"line {number}" for number in range(20_000)]
    assert [line for line in graph.log("talker").splitlines() if line.startswith("line ")] == expected
    merged = [line.partition(" talker: ")[2] for line in graph.log("merged").splitlines()]
    assert [line for line in merged if line.startswith("line ")] == expected
    shown = palp.run("logs", "talker", "-n", "30000").stdout
    assert shown.splitlines()[:2] == ["from below", "an error from below"]
    assert " talker: an error from below\n" in graph.log("merged")
    assert "did you mean 'talker'?" in palp.refused("logs", "talkre")


def test_a_stopped_node_still_reaches_its_safe_state(palp: Palp, tmp_path: Path) -> None:
    hostile = Hostile(palp, tmp_path)
    process = hostile.start("clock:=wall", "count:=1000000")
    graph = Running(palp)
    graph.process("bad").suspend()
    end(process, signal.SIGTERM)
    assert hostile.notes.read_text().splitlines() == ["configure", "deactivate"]
    assert palp.all_gone()


def test_a_second_ctrl_c_does_not_wait_for_a_node_that_never_answers(palp: Palp, tmp_path: Path) -> None:
    palp.constants[f"{interrupt.__name__}:KILL_NS"] = FOREVER_NS  # what a user waits who does not insist
    hostile = Hostile(palp, tmp_path)
    ready = Pipe(tmp_path / "ready")
    process = hostile.start("clock:=wall", "deed:=loop", f"ready:={ready.path}")
    ready.wait()
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.6)
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
    assert process.returncode == 130
    assert palp.all_gone()


def test_a_node_runs_with_the_priority_of_its_launch_entry_or_says_why_not(talkers: Hostile) -> None:
    entry = "talker: {run: 'nodes.talk:Talk', realtime_priority: 7}"
    file = talkers.write("launch/placed.yaml", f"graph: placed\nclock: wall\nnodes:\n  {entry}\n")
    process = talkers.palp.start("launch", file)
    wait_for_line(process, "ticks: 1/")
    graph = Running(talkers.palp)
    pid = graph.process("talker").pid
    log = graph.log("talker")
    if os.sched_getscheduler(pid) == os.SCHED_FIFO:
        assert os.sched_getparam(pid).sched_priority == 7
    else:
        assert "RLIMIT_RTPRIO" in log
        assert "/etc/security/limits.conf" in log
    end(process, signal.SIGTERM)


WHERE_IT_LOADS = """
import os, sys
from pathlib import Path
from palp_core.graph.description.node_class import NodeClassRequest
from palp_core.graph.supervision.fork_server import ForkServer

server, folder = ForkServer(), Path(sys.argv[1])
for name, where in ("talk", "forked"), ("heavy", "nowhere"), ("heavy", "composed"), ("heavy", "forked"):
    (found,) = server.inspect_classes([NodeClassRequest(f"nodes.{name}:Talk")], folder, to_run=where)
    assert found.error is None
    maps = Path(f"/proc/{server.pid}/maps").read_text()
    in_server = [word for word in ("/scipy/", "/scipy/special/", "/scipy/signal/") if word in maps]
    print("scipy.special" in sys.modules, len(os.listdir(f"/proc/{server.pid}/task")), *in_server)
server.close()
"""


@pytest.mark.nightly
def test_what_is_heavy_is_imported_where_nodes_run_that_need_it_and_the_server_has_one_thread(
    talkers: Hostile, tmp_path: Path
) -> None:
    """By the launcher for nodes that it composes, by the fork server for those that it forks."""
    talkers.write("nodes/heavy.py", "import scipy\n" + TALK)  # its parts load when named
    done = subprocess.run(
        [sys.executable, "-c", WHERE_IT_LOADS, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [
        "False 1",
        "False 1",
        "True 1",
        "True 1 /scipy/ /scipy/special/ /scipy/signal/",
    ]


def test_a_run_lives_as_long_as_it_holds_its_folder() -> None:
    run = RunDirectory("a")
    assert is_locked(run.path)
    assert is_locked(run.path)  # asking leaves no trace
    run.release()
    assert not is_locked(run.path)
    run.remove()
    assert not is_locked(run.path)


def test_launcher_and_server_open_as_many_files_as_the_user_may() -> None:
    program = (
        "import resource as r; hard = r.getrlimit(r.RLIMIT_NOFILE)[1]\n"
        "r.setrlimit(r.RLIMIT_NOFILE, (64, hard))\n"
        "from palp_core.graph.supervision.fork_child import MOST_FILES, open_many_files\n"
        "open_many_files()\n"
        "assert r.getrlimit(r.RLIMIT_NOFILE)[0] == (min(hard, MOST_FILES) if hard >= 0 else MOST_FILES)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=PATIENCE_S)
