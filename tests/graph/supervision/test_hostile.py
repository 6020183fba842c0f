"""Nodes that do what no node should, users in a hurry, odd surroundings: a run ends, safely, and says why."""

from __future__ import annotations

import concurrent.futures
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from palp_core import user_folders
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.process.control_messages import Hello, Round, Shutdown, node_end
from palp_core.graph.supervision import fork_server, interrupt
from palp_core.graph.supervision.channel_server import ChannelServer
from palp_core.user_folders import runtime_folder
from tests.support.palp import CHAIN, FOREVER_NS, PATIENCE_S, Palp, end
from tests.support.toys import LAUNCH, Hostile, Pipe


@pytest.fixture
def hostile(palp: Palp, tmp_path: Path) -> Hostile:
    return Hostile(palp, tmp_path)


def test_what_a_node_has_started_apart_goes_with_it(hostile: Hostile) -> None:
    assert hostile.run("deed:=daemon").returncode == 0
    assert hostile.palp.all_gone()
    assert "in order" in hostile.notes.read_text()


def test_a_child_goes_with_its_node_and_does_not_hold_the_supervisor_by_the_nodes_line(
    hostile: Hostile,
) -> None:
    done = hostile.run("deed:=fork_and_die")
    assert done.returncode == 1
    assert "bad: its process was killed by SIGKILL" in done.stderr
    assert hostile.palp.all_gone()


IN_PROCESS = "^bad: its process ended with status 0"
ALL_IN_ONE = "^a node ended the process of all nodes with status 0"


@pytest.mark.parametrize(
    ("composed", "deed", "words"),
    [
        *(("", deed, IN_PROCESS) for deed in ("leave", "replace")),
        *(("--compose", deed, ALL_IN_ONE) for deed in ("leave", "leave_in_c", "replace")),
    ],
)
def test_a_node_that_ends_its_process_ends_no_run_as_if_all_were_well(
    hostile: Hostile, deed: str, composed: str, words: str
) -> None:
    done = hostile.run(f"deed:={deed}", *composed.split())
    assert done.returncode == 1
    assert re.search(words, done.stderr, re.MULTILINE)
    assert hostile.palp.all_gone()


@pytest.mark.parametrize("composed", ["", "--compose"])
def test_no_node_writes_to_the_terminal_of_the_launch(hostile: Hostile, composed: str) -> None:
    done = hostile.run("deed:=paint", *composed.split())
    assert done.returncode == 1
    assert "bad: take (handler of 'blob') failed: ValueError: enough" in done.stderr
    assert "\x1b" not in done.stdout + done.stderr
    logs = "".join(file.read_text() for file in hostile.palp.runtime_dir.glob("palp/*/log/*.log"))
    assert all(f"\x1b[2J{word}\n" in logs for word in ("handler", "thread", "below", "child"))


def test_a_node_that_does_not_reach_its_safe_state_ends_no_run_as_if_all_were_well(
    hostile: Hostile,
) -> None:
    done = hostile.run("deed:=unsafe", "clock:=wall")
    assert done.returncode == 1
    assert "bad: did not report that it reached its safe state: its process ended" in done.stderr
    assert "the device does not answer" in done.stderr


@pytest.mark.parametrize(
    ("deed", "how", "words"),
    [
        ("cancel", "--compose", "bad: take (handler of 'blob') failed: CancelledError"),
        ("interrupt", "", "KeyboardInterrupt"),
    ],
)
def test_what_is_no_exception_out_of_a_handler_still_reaches_the_safe_state(
    hostile: Hostile, deed: str, how: str, words: str
) -> None:
    done = hostile.run(f"deed:={deed}", *how.split())
    assert done.returncode == 1
    assert words in done.stderr
    assert hostile.notes.read_text().splitlines() == ["configure", "deed", "deactivate"]


def test_an_import_that_never_ends_can_be_interrupted(hostile: Hostile) -> None:
    ready = Pipe(hostile.folder / "ready")
    hostile.write(
        "nodes/endless.py", f"print('!', file=open({str(ready.path)!r}, 'w'), flush=True)\nwhile 1: 0"
    )
    file = hostile.write("launch/e.yaml", "graph: e\nclock: sim\nnodes: {a: {run: 'nodes.endless:A'}}\n")
    process = hostile.palp.start("launch", file)
    ready.wait()
    end(process)
    assert hostile.palp.all_gone()


def test_a_second_ctrl_c_breaks_into_a_composed_handler_that_never_ends(hostile: Hostile) -> None:
    ready = Pipe(hostile.folder / "ready")
    process = hostile.start("deed:=loop", "--compose", f"ready:={ready.path}")
    ready.wait()
    while "deactivate" not in hostile.notes.read_text():
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(2.0)
    assert process.wait(PATIENCE_S) == 130
    assert hostile.notes.read_text().splitlines() == ["configure", "deed", "deactivate"]


def test_a_node_that_neither_reads_nor_finishes_its_sentence_does_not_stop_the_supervisor(
    tmp_path: Path,
) -> None:
    lines = ChannelServer(tmp_path / "s", ["a"], ())
    node = node_end(str(tmp_path / "s"))
    node.send(Hello("a", 1))
    while not lines.connected(0):
        lines.wait(1.0)
    large = Round(0, [bytes(5_000_000)])
    lines.send(0, large)
    lines.send(0, Shutdown(7))
    node.socket.sendall((1000).to_bytes(4, "little") + b"half")
    assert lines.wait(0.1) == ([], set())
    with concurrent.futures.ThreadPoolExecutor(1) as other:
        received = other.submit(lambda: [node.receive(), node.receive()])
        while not received.done():
            lines.wait(0.01)
    assert received.result() == [large, Shutdown(7)]
    node.close()
    lines.wait(1.0)
    assert not lines.connected(0)
    lines.close()


def test_ten_megabytes_a_message_arrive(hostile: Hostile) -> None:
    arrived = hostile.folder / "arrived"
    assert hostile.run("clock:=wall", "size:=10000000", "count:=3", f"arrived:={arrived}").returncode == 0
    assert arrived.read_text() == "0 10000000\n1 10000000\n2 10000000\n"


def test_two_nodes_killed_at_once_are_both_accounted_for(hostile: Hostile) -> None:
    hostile.palp.constants[f"{interrupt.__name__}:KILL_NS"] = FOREVER_NS  # a death missed is waited for
    process = hostile.start("count:=1000000")
    listed = json.loads(hostile.palp.run("node", "list", "--json").stdout)
    process.send_signal(signal.SIGSTOP)  # the first death does not end the second node before its turn
    for node in listed[:2]:
        psutil.Process(node["pid"]).kill()
    process.send_signal(signal.SIGCONT)
    assert process.wait(PATIENCE_S) == 1
    assert hostile.palp.all_gone()


def test_a_slow_reader_reaches_its_safe_state_when_the_terminal_is_closed(hostile: Hostile) -> None:
    process = hostile.start("clock:=wall", "deed:=slow", "rate_hz:=200.0", "count:=1000000")
    hostile.palp.run("topic", "echo", "/bad/passed", "--times", "20")
    end(process, signal.SIGHUP)
    assert hostile.notes.read_text().splitlines()[-1] == "deactivate"


def test_a_restart_that_fails_is_tried_again_and_the_new_process_is_listed(hostile: Hostile) -> None:
    process = hostile.start("clock:=wall", "deed:=flaky", "max_restarts:=3", "count:=1000000")
    assert hostile.palp.run("topic", "echo", "/bad/passed", "--times", "30").returncode == 0
    assert hostile.notes.read_text().splitlines().count("configure") == 4
    listed = json.loads(hostile.palp.run("node", "list", "--json").stdout)
    assert all(psutil.pid_exists(node["pid"]) for node in listed)
    end(process, signal.SIGTERM)


def test_sets_have_the_same_order_composed_as_in_processes(hostile: Hostile) -> None:
    found = []
    for extra in ((), ("--compose",)):
        digest = hostile.folder / "digest"
        assert hostile.run("--digest", str(digest), *extra).returncode == 0
        found.append(json.loads(digest.read_text())["/sink/order"])
    assert found[0] == found[1]


def test_an_exit_code_that_a_shell_cannot_tell_from_success_is_a_failure(hostile: Hostile) -> None:
    file = hostile.write(
        "launch/odd.yaml", "graph: odd\nclock: sim\nnodes: {a: {run: 'nodes.toys:Odd', on_exit: shutdown}}\n"
    )
    assert hostile.palp.here("launch", file).returncode == 1


def test_a_digest_that_cannot_be_written_is_told_before_the_run(hostile: Hostile) -> None:
    done = hostile.palp.refused("launch", hostile.file, "--digest", "/nowhere/digest.json")
    assert done.startswith("--digest /nowhere/digest.json: cannot be written")


def test_a_silent_topic_is_given_up_although_heartbeats_come(hostile: Hostile) -> None:
    before = "params: {count: $(var count), arrived: $(var arrived)}"
    ends_never = "params: {count: 2, arrived: $(var arrived)}"  # the one message is not the last
    assert before in LAUNCH
    hostile.write("launch/hostile.yaml", LAUNCH.replace(before, ends_never))
    hostile.start("clock:=wall", "count:=1")
    done = hostile.palp.run("topic", "echo", "/source/blob", "--timeout", "0.5")
    assert "no message for 0.5 s" in done.stderr


@pytest.mark.parametrize(
    "closed",
    [*(pytest.param(one, marks=pytest.mark.nightly) for one in ("<&-", ">&-")), "<&- >&- 2>&-"],
)
def test_closed_standard_streams_do_no_harm(palp: Palp, tmp_path: Path, closed: str) -> None:
    command = palp.command("launch", CHAIN, "clock:=sim", "count:=5", f"out:={tmp_path}/out")
    shell = ["sh", "-c", f'exec "$@" {closed}', "sh", *command]
    assert subprocess.run(shell, env=palp.environment, check=False, timeout=PATIENCE_S).returncode == 0
    assert json.loads((tmp_path / "out").read_text()) == list(range(5))


def test_paths_count_from_the_users_folder_and_its_files_hide_no_module(palp: Palp, tmp_path: Path) -> None:
    for name in ("numpy.py", "random.py", "yaml.py"):
        (tmp_path / name).write_text("raise SystemError('not me')")
    command = [sys.executable, "-P", "-m", "palp_core", "launch", str(CHAIN), "clock:=sim", "count:=5"]
    done = subprocess.run(
        [*command, "out:=here.json"], env=palp.environment, cwd=tmp_path, check=False, timeout=60
    )
    assert done.returncode == 0
    assert json.loads((tmp_path / "here.json").read_text()) == list(range(5))


def test_a_fork_server_that_is_stopped_is_ended_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fork_server, "CLOSE_TIMEOUT_S", 0.1)
    server = fork_server.ForkServer()
    os.kill(server.pid, signal.SIGSTOP)
    server.close()
    assert not psutil.pid_exists(server.pid)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch, palp: Palp) -> Path:
    """Stand in for /tmp, and let what is said once be said again."""
    monkeypatch.setattr(user_folders, "SHORT", palp.runtime_dir)
    user_folders._remark.cache_clear()
    return palp.runtime_dir


def long_folder(tmp_path: Path, name: str) -> Path:
    long = tmp_path / (name * 80)
    long.mkdir(exist_ok=True)
    return long


@pytest.mark.parametrize("variable", ["XDG_RUNTIME_DIR", "TMPDIR"])
def test_a_setting_too_long_for_a_socket_has_a_short_folder_of_its_own_and_that_is_said(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    short: Path,
    capsys: pytest.CaptureFixture[str],
    variable: str,
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setenv(variable, str(long_folder(tmp_path, "x")))
    run = RunDirectory("a")
    assert len(str(Path("/tmp") / run.path.relative_to(short) / f"{'n' * 32}.pub")) <= 107
    assert run.path.parent.stat().st_mode & 0o777 == 0o700
    base = runtime_folder()
    assert run.path.parent == base
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"{variable}={long_folder(tmp_path, 'x')} is too long" in said
    assert f"in {base}; set {variable} to a folder of at most" in said

    monkeypatch.setenv(variable, str(long_folder(tmp_path, "y")))
    assert runtime_folder() not in {base, short / f"palp-{os.getuid()}"}
    link = tmp_path / ("l" * 80)
    link.symlink_to(long_folder(tmp_path, "x"))
    monkeypatch.setenv(variable, f"{link}/")  # the same folder, however it is written
    assert runtime_folder() == base
    run.remove()


def test_a_runtime_folder_that_is_not_there_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("TMPDIR", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "gone"))
    assert runtime_folder() == short / f"palp-{os.getuid()}"
    assert f"XDG_RUNTIME_DIR={tmp_path / 'gone'} is no folder" in capsys.readouterr().err
