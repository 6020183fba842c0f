"""However a graph ends, it ends: no orphan, no hang, a status that tells, a message that names the node."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
from pathlib import Path

import psutil
import pytest

from palp_core.counted import counted
from palp_core.graph.supervision import interrupt
from palp_core.graph.supervision.interrupt import Interrupt, Interrupted
from palp_core.graph.supervision.supervisor import STILL_WAITING_S
from palp_core.palpation.session.trials_csv import read_rows, read_sweep
from tests.support.palp import CHAIN, PATIENCE_S, SIM, Palp, end, wait_for_error, wait_for_line

RIG_NODES = (
    "experiment", "policy", "actuator", "stage", "phantom", "torque", "estimator", "emg", "cocontraction",
)  # fmt: skip


def node_pid(palp: Palp, name: str) -> int:
    found = json.loads(palp.run("node", "list", "--json").stdout)
    return next(int(node["pid"]) for node in found if node["name"] == f"/{name}")


def start_rig(palp: Palp, out: Path) -> subprocess.Popen[str]:
    process = palp.start("launch", SIM, f"out:={out}", "trials:=50", "training:=25")
    wait_for_line(process, "training: ")
    return process


def assert_readable(out: Path) -> None:
    rows = read_rows(out)
    for row in rows:
        torque_n_m, rate_hz = read_sweep(out, row.row)
        assert len(torque_n_m) > 3000
        assert rate_hz == 1000.0


@pytest.mark.nightly
@pytest.mark.parametrize("name", RIG_NODES)
def test_the_record_of_a_rig_with_a_killed_node_is_kept_and_says_why(
    palp: Palp, tmp_path: Path, name: str
) -> None:
    process = start_rig(palp, out := tmp_path / "out")
    psutil.Process(node_pid(palp, name)).kill()
    said, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert f"{name}: its process was killed by SIGKILL" in errors
    assert palp.all_gone()
    assert_readable(out)
    assert said.splitlines()[-1].startswith(f"Kept: {counted(len(read_rows(out)), 'palpation')}")
    unfinished = json.loads((out / "result.json").read_text())["unfinished"]
    assert f"{name}: its process was killed by SIGKILL" in unfinished["why"]


@pytest.mark.parametrize("within_s", [PATIENCE_S, pytest.param(1.5, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("clock", "stopped"), [("sim", False), ("wall", True)])
def test_when_the_supervisor_is_killed_all_is_gone_and_a_stopped_node_too(
    palp: Palp, clock: str, within_s: float, *, stopped: bool
) -> None:
    process = palp.start("launch", CHAIN, "count:=1000000", f"clock:={clock}")
    wait_for_line(process, "blocks: 1/")
    assert len(palp.processes()) >= 5
    if stopped:
        psutil.Process(node_pid(palp, "relay")).suspend()
    process.kill()
    process.wait()
    assert palp.all_gone(within_s)


def test_a_graph_is_ended_from_elsewhere_as_ctrl_c_at_its_launch_ends_it(palp: Palp) -> None:
    process = palp.start("launch", CHAIN, "count:=1000000")
    wait_for_line(process, "blocks: 1/")
    name = json.loads(palp.run("graph", "list", "--json").stdout)[0]["name"]
    assert "no graph named 'none' is running" in palp.run("graph", "end", "none").stderr
    assert "name two graphs" in palp.run("graph", "end", name, "--graph", "none").stderr
    done = palp.printed("graph", "end", "--graph", name)
    assert done.startswith(f"graph '{name}' (id ")
    assert palp.all_gone()  # at once: it has waited for the end
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + signal.SIGINT
    assert "ended by palp graph end; all nodes exited" in errors
    assert palp.run("graph", "end").stderr.startswith("no graph is running")


def test_when_the_fork_server_is_killed_the_run_ends_and_says_so(palp: Palp) -> None:
    process = palp.start("launch", CHAIN, "count:=1000000")
    wait_for_line(process, "blocks: 1/")
    server = psutil.Process(node_pid(palp, "relay")).parent()
    assert server is not None
    server.kill()
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode != 0
    assert "fork server" in errors
    assert palp.all_gone()


@pytest.mark.parametrize("patience_s", [0.5, pytest.param(STILL_WAITING_S, marks=pytest.mark.nightly)])
def test_a_frozen_node_is_named_and_does_not_keep_the_graph_from_ending(
    palp: Palp, patience_s: float
) -> None:
    palp.constants["palp_core.graph.supervision.supervisor:STILL_WAITING_S"] = patience_s
    process = palp.start("launch", CHAIN, "clock:=sim", "count:=1000000")
    wait_for_line(process, "blocks: 1/")
    psutil.Process(node_pid(palp, "relay")).suspend()
    wait_for_error(process, "still waiting for relay")
    end(process)
    assert palp.all_gone()


@pytest.mark.parametrize(
    ("file", "moment", "compose"),
    [
        (CHAIN, "palp/*", ("--compose",)),
        (CHAIN, "palp/*/graph.json", ()),
        *(
            pytest.param(SIM, moment, compose, marks=pytest.mark.nightly)
            for moment in ("palp/*", "palp/*/graph.json", "out/trials.csv")
            for compose in ((), ("--compose",))
        ),
    ],
)
def test_ctrl_c_leaves_nothing_behind(palp: Palp, file: Path, moment: str, compose: tuple[str, ...]) -> None:
    length = ("trials:=100",) if file == SIM else ("count:=1000000",)
    process = palp.start("launch", file, f"out:={palp.runtime_dir / 'out'}", *length, *compose)
    while not list(palp.runtime_dir.glob(moment)):
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.01)
    assert_interruptible(palp, process, palp.runtime_dir / "out")


def assert_interruptible(palp: Palp, process: subprocess.Popen[str], out: Path) -> None:
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode in (130, -signal.SIGINT), errors
    assert "Traceback" not in errors or process.returncode == -signal.SIGINT
    assert palp.all_gone()
    if (out / "trials.csv").exists():
        assert_readable(out)


@pytest.mark.parametrize(
    ("number", "asked_by", "said"),
    [
        (signal.SIGINT, "", "interrupted by SIGINT"),
        (signal.SIGTERM, "", "interrupted by SIGTERM"),
        (signal.SIGINT, "palp graph end", "ended by palp graph end"),
    ],
)
def test_an_interruption_comes_out_of_a_worker_as_it_was(
    number: signal.Signals, asked_by: str, said: str
) -> None:
    """An exception that a process pool cannot unpickle ends in a traceback of the pool's own."""
    back = pickle.loads(pickle.dumps(Interrupted(number, asked_by)))
    assert (type(back), back.signal, str(back)) == (Interrupted, number, said)


@pytest.mark.parametrize("breaks_in", [True, False])
def test_a_second_request_breaks_into_the_work_only_where_it_may(
    monkeypatch: pytest.MonkeyPatch, breaks_in: bool
) -> None:
    monkeypatch.setattr(interrupt, "INSIST_NS", -1)
    with Interrupt(breaks_in=breaks_in) as asked:
        os.kill(os.getpid(), signal.SIGTERM)
        assert (asked.requested, asked.second_request) == (True, False)
        raised = False
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except Interrupted:
            raised = True
        assert (raised, asked.second_request) == (breaks_in, True)


def test_a_hang_up_that_is_ignored_as_under_nohup_ends_nothing() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupt(breaks_in=False) as asked:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not asked.requested
    finally:
        signal.signal(signal.SIGHUP, before)
