"""Hot swap on the wall clock: real processes, a thousand numbers a second, and nothing lost or repeated."""

import contextlib
import itertools
import json
import os
import re
import signal
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import psutil
import pytest

from palp_core.errors import GraphError
from palp_core.graph.bag.reader import read
from palp_core.graph.messages.frame import Kind, parse
from palp_core.graph.swap.swap import STEPS
from palp_core.graph.transport.migration import read_move
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import PATIENCE_S, ROOT, SIM, Palp, wait_for_line
from tests.support.stage import SLOW, Stage

EARLY = [pytest.param(step, marks=pytest.mark.nightly) for step in ("configure", "state")]


def test_swaps_back_and_forth_lose_repeat_and_reorder_nothing(palp: Palp, launch: Path) -> None:
    stage = Stage(palp, launch)
    for turn in range(4):
        answer = stage.swap(("Other", "Relay")[turn % 2])
        assert answer["report"]["switched"], answer
        assert "report" in stage.graph.swap("asker", "swap_toys:Asker", timeout_s=PATIENCE_S)
        stage.passes(20)
    _, bad, makers = stage.judgement()
    assert bad == ""
    assert makers == ["Relay", "Other"] * 2 + ["Relay"]
    edges = (("sink", "/relay/out"), ("relay", "/source/out"), ("relay", "/asker/ask"))
    for node, topic in (*edges, ("asker", "/relay/ask/asker/ask")):
        account = stage.graph.ask(node, "info")["inputs"][topic]
        assert account["received"] > 0
        assert (account["lost"], account["dropped"]) == (0, 0)
        assert account["repeated"] == 0 or node == "asker"  # one that arrives again is dropped


HELD = "reliability: reliable, history: keep_all, depth: 16, max_blocking_ms: 60000"


@pytest.mark.nightly
def test_a_publisher_that_waits_for_its_reader_goes_on_across_swaps_of_either(
    palp: Palp, launch: Path
) -> None:
    text = launch.read_text()
    for source in ("source/out", "relay/out"):
        text = text.replace(f"{{num: {source}}}", f"{{num: {{from: {source}, {HELD}}}}}")
    launch.write_text(text)
    stage = Stage(palp, launch)
    for turn in range(4):
        answer = stage.swap(("Other", "Relay")[turn % 2])
        assert answer["report"]["switched"], answer
        stage.passes(100)  # more than a reader may be behind
    assert stage.judgement()[1:] == ("", ["Relay", "Other", "Relay", "Other", "Relay"])
    assert stage.graph.ask("sink", "info")["inputs"]["/relay/out"]["qos"]["history"] == "keep_all"


def test_a_swap_is_seen_in_event_info_and_the_runs_journal(stage: Stage) -> None:
    before = len(_changes(stage))
    report = stage.swap("Other", gain=7)["report"]
    (event,) = [event for event in stage.events() if event.kind == "swapped"]
    assert (event.node, json.loads(event.data)["after"]) == ("relay", "swap_toys:Other")
    info = stage.graph.ask("relay", "info")
    assert (info["run"], info["params"]) == ("swap_toys:Other", {"gain": 7})
    assert info["swaps"][-1]["before"] == "swap_toys:Relay"
    assert info["swaps"][-1]["gap_s"] == report["gap_s"] > 0.0
    assert next(n["run"] for n in stage.record["nodes"] if n["name"] == "relay") == "swap_toys:Other"
    stage.graph.ask("relay", "set_parameters", parameters={"gain": 9})
    while len(found := _changes(stage)) < before + 2:  # the launcher hears of it apart from the answer
        stage.wait_for_source()
    swap, given = found[before:]
    assert (swap["before"], swap["run"], swap["params"]) == (
        "swap_toys:Relay",
        "swap_toys:Other",
        {"gain": 7},
    )
    assert (given["node"], given["run"], given["params"]) == ("relay", "", {"gain": 9})
    assert 0.0 < swap["at_s"] < given["at_s"]


def _changes(stage: Stage) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = stage.graph.ask("graph", "summary")["summary"]["changes"]
    return found


REFUSED = [
    ("Agreeing", "rate_hz is 7.0 in node 'relay' and 200.0 in node 'source'; give both the same"),
    ("NoOut", "node 'sink' (Sink): node 'relay' (NoOut) has no output 'out'"),
    ("WrongType", "carries Word, not Num"),
    ("Wants", "input 'more' is not wired"),
    ("Nope", "no class 'Nope'"),
    ("nodes.nope:Relay", "no module 'nodes.nope'"),
    ("/nowhere/policy.py:Relay", "no file /nowhere/policy.py"),
]


def test_a_class_given_by_its_file_is_the_one_that_runs_and_parameters_alone_change_it(
    stage: Stage,
) -> None:
    palp, file = stage.palp, stage.launch.parents[1] / "swap_toys.py"
    palp.printed("swap", "relay", "gain:=3")
    stage.graph.ask("relay", "set_parameters", parameters={"gain": 4})
    report = stage.swap(f"{file}:Relay")["report"]
    assert (report["before"], report["after"]) == ("swap_toys:Relay", "swap_toys:Relay")
    info = stage.graph.ask("relay", "info")
    assert (info["run"], info["params"], info["file"]) == ("swap_toys:Relay", {"gain": 4}, str(file))
    assert f"File: {file}" in palp.run("node", "info", "relay").stdout
    assert stage.swap(f"{file}:Plain")["failed"]["step"] == "state"  # another class of that file is another
    assert palp.run("swap", "relay", "swap_toys:Relay", "--reload").returncode == 2
    stage.passes(20)
    assert stage.judgement()[1:] == ("", ["Relay"])


def test_a_swap_of_parameters_alone_keeps_the_others_and_leaves_those_that_are_read_only(
    stage: Stage,
) -> None:
    stage.graph.ask("relay", "set_parameters", parameters={"gain": 3})
    stage.swap("Relay")
    assert stage.graph.ask("relay", "info")["params"] == {"gain": 3}
    assert "report" in stage.swap("Fixed", base=1)
    failed = stage.swap("Fixed", base=2)["failed"]
    assert failed["step"] == "check"
    assert "parameter 'base' is read-only; state it in the launch file" in failed["text"]
    assert "report" in stage.swap("Fixed", base=1, gain=2)
    assert stage.graph.ask("relay", "info")["params"] == {"base": 1, "gain": 2}


def test_what_does_not_fit_the_graph_is_refused_before_anything_starts(stage: Stage) -> None:
    for run, reason in REFUSED:
        failed = stage.swap(run)["failed"]
        assert failed["step"] == "check"
        assert reason in failed["text"]
    assert "gain" in stage.swap("Other", gian=2)["failed"]["text"]
    assert stage.judgement()[1:] == ("", ["Relay"])


FAULTS = [(step, deed) for step in ("configure", "state", "take over") for deed in ("raise", "kill")]
FAULTS += [("take over", "finish"), ("take over", "finish early")]


def test_a_fault_at_any_step_leaves_the_old_node_at_work(stage: Stage) -> None:
    for step, deed in [*FAULTS, ("state", "misfit")]:
        failed = stage.swap("Faulty", step=step, deed=deed)["failed"]
        assert failed["step"] == step, (step, deed, failed)
        stage.passes(5)
    assert stage.swap("Plain")["failed"]["step"] == "state"
    stage.passes(5)
    assert stage.judgement()[1:] == ("", ["Relay"])
    events = [event for event in stage.events() if event.kind == "swap_failed"]
    assert len(events) == len(FAULTS) + 2
    assert "report" in stage.swap("Other")
    stage.passes(5)
    assert stage.judgement()[1:] == ("", ["Relay", "Other"])


@pytest.mark.parametrize("step", [*EARLY, "take over"])
def test_a_step_that_takes_too_long_is_taken_back(stage: Stage, step: str) -> None:
    timeout_s = stage.patience_s()
    failed = stage.swap("Faulty", step=step, deed="hang", timeout_s=timeout_s)["failed"]
    assert failed["step"] == step
    assert f"within {timeout_s:g} s" in failed["text"]
    stage.passes(50)
    assert stage.judgement()[1:] == ("", ["Relay"])


@pytest.mark.parametrize("step", ["configure", pytest.param("state", marks=pytest.mark.nightly)])
def test_the_old_nodes_death_ends_the_swap_and_the_graph_by_its_rule(
    palp: Palp, own_stage: Stage, step: str
) -> None:
    with pytest.raises(GraphError, match="relay"):
        own_stage.swap("Faulty", step=step, deed="kill_other", pid=own_stage.pid("relay"))
    assert own_stage.launcher.wait() != 0
    assert palp.all_gone()


def test_an_old_node_that_dies_when_it_has_handed_over_is_gone_at_once_and_the_new_one_goes_on(
    own_stage: Stage,
) -> None:
    stage = own_stage
    listener = SubscriberSocket({"/relay/out": f"ipc://{stage.folder}/+1.pub"})
    try:
        old = stage.pid("relay")
        assert "report" in stage.swap("Faulty", step="take over", deed="kill_other", pid=old)
        last, phases = stage.judgement()[0], []
        while "gone" not in phases:  # it is said once: whoever listens goes on without the old place
            assert listener.wait(PATIENCE_S)
            for frame in map(parse, listener.receive()):
                assert frame.sequence < last + 5000
                phases += [read_move(frame.payload).phase] if frame.kind == Kind.MOVED else []
        assert phases == ["here", "gone"]
    finally:
        listener.close()
    stage.passes(20)
    assert stage.judgement()[1:] == ("", ["Relay", "Faulty"])


def test_a_new_node_that_dies_as_it_has_taken_over_leaves_the_old_one_at_work(stage: Stage) -> None:
    launcher = psutil.Process(stage.launcher.pid)

    def alive() -> set[int]:
        found: set[int] = set()
        for process in launcher.children(recursive=True):  # one that is just ending has no environment
            with contextlib.suppress(psutil.NoSuchProcess):
                found |= {process.pid} if process.status() != psutil.STATUS_ZOMBIE else set()
        return found

    before = alive()
    with ThreadPoolExecutor() as pool:
        answer = pool.submit(stage.swap, "Fleeting", step="take over", deed="stop_other", pid=launcher.pid)
        while launcher.status() != psutil.STATUS_STOPPED or alive() != before:
            assert not wait([answer], timeout=0.01).done
        launcher.resume()
        assert answer.result()["failed"]["step"] == "take over"
    stage.passes(50)
    assert stage.judgement()[1:] == ("", ["Relay"])
    assert "report" in stage.swap("Other")
    stage.passes(50)
    assert stage.judgement()[1:] == ("", ["Relay", "Other"])


@pytest.mark.parametrize("step", EARLY)
def test_the_launchers_death_during_a_swap_ends_everything(palp: Palp, own_stage: Stage, step: str) -> None:
    launcher = own_stage.launcher
    with pytest.raises(GraphError, match=r"did not answer: its process \d+ is gone"):
        own_stage.swap("Faulty", step=step, deed="kill_other", pid=launcher.pid)
    assert launcher.wait() == -signal.SIGKILL
    assert palp.all_gone()


def test_a_node_that_moves_something_is_swapped_in_its_safe_state_only(palp: Palp, launch: Path) -> None:
    stage = Stage(palp, launch, "run:=swap_toys:Mover", *SLOW)
    failed = stage.swap("Mover")["failed"]
    assert "palp lifecycle set /relay deactivate" in failed["text"]
    stage.graph.ask("relay", "transition", transition="deactivate")
    assert stage.swap("Mover")["report"]["switched"]
    assert stage.graph.ask("relay", "info")["lifecycle"] == "inactive"
    stage.graph.ask("relay", "transition", transition="activate")
    stage.passes(20)
    assert stage.judgement()[1] == ""


def test_the_command_line_swaps_a_file_of_the_users_and_reloads_it(stage: Stage, tmp_path: Path) -> None:
    palp = stage.palp
    mine = tmp_path / "elsewhere" / "mine.py"
    mine.parent.mkdir()
    mine.write_text("from swap_toys import Relay\n\n\nclass Mine(Relay):\n    word = 'one'\n")
    assert "gap" in palp.printed("swap", "relay", f"{mine}:Mine", "gain:=2")
    stage.passes(20)
    mine.write_text("from swap_toys import Other\n\n\nclass Mine(Other):\n    word = 'two'\n")
    done = palp.run("swap", "relay", "--reload", "--json")
    assert json.loads(done.stdout)["report"]["after"].endswith("mine.py:Mine")
    info = palp.run("node", "info", "/relay")
    assert "Changed hands" in info.stdout
    failed = palp.run("swap", "relay", "swap_toys:NoOut")
    assert failed.returncode == 10 + STEPS.index("check")
    assert "not swapped, the old node continues" in failed.stderr
    assert palp.run("swap", "nobody", "--reload").returncode == 2
    assert palp.run("swap", "relay").returncode == 2
    assert stage.judgement()[1:] == ("", ["Relay", "Mine"])


def test_a_listening_tool_follows_the_node(stage: Stage) -> None:
    listener = stage.palp.start("topic", "echo", "/relay/out", "--json", "--qos-reliability", "reliable")
    assert listener.stdout is not None
    first = json.loads(listener.stdout.readline())["index"]
    for turn in range(4):
        stage.swap(("Other", "Relay")[turn % 2])
    last = stage.passes(20)
    heard = [json.loads(listener.stdout.readline())]
    while heard[-1]["index"] < last:
        heard.append(json.loads(listener.stdout.readline()))
    assert [message["index"] for message in heard] == list(range(first + 1, first + 1 + len(heard)))
    listener.kill()
    listener.wait()


@pytest.mark.parametrize("neighbour", ["sink", pytest.param("source", marks=pytest.mark.nightly), "relay"])
def test_a_neighbour_that_is_stopped_keeps_a_node_from_a_swap_at_once_and_misses_nothing(
    stage: Stage, neighbour: str
) -> None:
    process = stage.process(neighbour)
    process.suspend()
    while process.status() != psutil.STATUS_STOPPED:
        psutil.wait_procs([process], timeout=0.01)
    failed = stage.swap("Other")["failed"]
    assert failed["step"] == "start"
    assert f"is stopped; continue it with: kill -CONT {process.pid}" in failed["text"]
    assert (f"/{neighbour}" in failed["text"]) is (neighbour != "relay")
    process.resume()
    stage.passes(100)
    assert "report" in stage.swap("Other")
    stage.passes(100)
    assert stage.judgement()[1:] == ("", ["Relay", "Other"])
    account = stage.graph.ask("sink", "info")["inputs"]["/relay/out"]
    assert (account["lost"], account["repeated"]) == (0, 0)


def test_a_reader_that_stops_in_the_middle_of_a_swap_takes_it_back(stage: Stage) -> None:
    sink, timeout_s = stage.pid("sink"), stage.patience_s()
    failed = stage.swap("Faulty", step="configure", deed="stop_other", pid=sink, timeout_s=timeout_s)[
        "failed"
    ]
    assert failed["step"] == "connect"
    assert "/sink" in failed["text"]
    os.kill(sink, signal.SIGCONT)
    stage.passes(100)
    assert stage.judgement()[1:] == ("", ["Relay"])


def test_a_second_swap_while_one_runs_hears_so_at_once(stage: Stage) -> None:
    palp = stage.palp
    before = {process.pid for process in palp.processes()}
    with ThreadPoolExecutor() as pool:
        first = pool.submit(stage.swap, "Faulty", step="configure", deed="hang")
        while {process.pid for process in palp.processes()} <= before:  # under way once it has a process
            assert not wait([first], timeout=0.01).done
        progress = stage.graph.ask("graph", "swap_progress")
        assert (progress["node"], tuple(progress["steps"])) == ("relay", STEPS)
        assert progress["step"] in ("check", "start", "configure")
        second = stage.graph.swap("asker", "swap_toys:Asker", dry_run=True, timeout_s=PATIENCE_S)
        assert second["failed"]["step"] == "start"
        assert second["failed"]["text"] == "a swap of /relay is under way; ask again when it is done"
        while not wait([first], timeout=0.01).done:
            for process in palp.processes():
                if process.pid not in before:
                    with contextlib.suppress(psutil.NoSuchProcess):  # it may have gone since it was listed
                        process.kill()
        assert first.result()["failed"]["step"] in ("check", "configure")
    assert "report" in stage.graph.swap("asker", "swap_toys:Asker", timeout_s=PATIENCE_S)
    assert stage.graph.ask("graph", "swap_progress")["node"] == ""


def test_swaps_leave_no_descriptor_and_no_file_behind(stage: Stage) -> None:
    processes = {name: stage.process(name) for name in ("sink", "asker", "source")}
    stage.swap("Other")
    before = {name: process.num_fds() for name, process in processes.items()}
    for turn in range(3):
        stage.swap(("Relay", "Other")[turn % 2])
        stage.swap("Faulty", step="state", deed="raise")
        stage.passes(20)
    for name, process in processes.items():
        while process.num_fds() > before[name] + 2:  # a connection may be closing
            stage.passes(20)
    while len(list(stage.folder.glob("+*"))) > 4:  # of relay, and of asker, which another test may swap
        stage.passes(20)
    assert not list(stage.folder.glob("description[0-9]*"))


def test_a_class_that_takes_too_long_to_import_is_not_taken_for_the_next_one(
    stage: Stage, tmp_path: Path
) -> None:
    endless, begun = tmp_path / "endless.py", tmp_path / "begun"
    endless.write_text(f"import signal\nopen({str(begun)!r}, 'w').close()\nsignal.pause()\n")
    timeout_s = stage.patience_s()
    failed = stage.swap(f"{endless}:X", timeout_s=timeout_s)["failed"]
    assert failed["step"] == "check"
    assert f"within {timeout_s:g} s" in failed["text"]
    assert begun.exists()
    assert "has no output 'out'" in stage.swap("NoOut")["failed"]["text"]
    assert "report" in stage.swap("Other")


def test_the_bag_shows_one_owner_of_every_message(palp: Palp, launch: Path, tmp_path: Path) -> None:
    stage = Stage(palp, launch, *SLOW, "--record", tmp_path / "bag")
    for name in ("Other", "Relay"):
        assert "report" in stage.swap(name)
        assert "failed" in stage.swap("Faulty", step="take over", deed="kill")
        stage.passes(20)
    with contextlib.suppress(GraphError):
        stage.swap("Faulty", step="take over", deed="kill_other", pid=stage.launcher.pid)
    assert stage.launcher.wait() == -signal.SIGKILL
    assert palp.all_gone()
    recovered = tmp_path / "recovered"
    assert palp.run("bag", "recover", tmp_path / "bag", "-o", recovered).returncode in (0, 1)
    owners: dict[int, set[str]] = {}
    for entry in read(recovered, ["/relay/out"]):
        owners.setdefault(entry.sequence, set()).add(entry.value.by)
    assert len(owners) > 40
    assert all(len(makers) == 1 for makers in owners.values())
    changes = [next(iter(owners[sequence])) for sequence in sorted(owners)]
    assert [maker for maker, _ in itertools.groupby(changes)] == ["Relay", "Other", "Relay"]
    events = [entry.value.kind for entry in read(recovered, ["/graph/events"])]
    assert events.count("swapped") == 2


def test_a_shadow_is_compared_and_not_heard(stage: Stage) -> None:
    report = stage.graph.swap("relay", "swap_toys:Other", shadow_s=0.5, dry_run=True)["report"]
    assert not report["switched"]
    shadow = report["shadow"]
    assert shadow["compared"] > 0
    assert shadow["differing"] == shadow["compared"]  # each says who it is
    assert "/relay/out.by" in shadow["largest"]
    assert "/relay/out.index" not in shadow["largest"]
    assert stage.judgement()[1:] == ("", ["Relay"])
    report = stage.graph.swap("relay", "swap_toys:Relay", shadow_s=0.5)["report"]
    assert report["switched"]
    assert (report["shadow"]["differing"], report["shadow"]["equal"]) == (0, report["shadow"]["compared"])
    stage.passes(100)
    assert stage.judgement()[1:] == ("", ["Relay"])
    answer = stage.graph.swap("relay", "swap_toys:Other", dry_run=True)
    assert not answer["report"]["switched"]
    stage.passes(20)
    assert stage.judgement()[1:] == ("", ["Relay"])


@pytest.mark.nightly
def test_the_policy_that_the_tutorial_shows_takes_over_in_the_middle_of_a_run(
    palp: Palp, tmp_path: Path
) -> None:
    (source,) = re.findall(
        r"```python\n(# my_policy\.py\n.*?)```", (ROOT / "docs/tutorial/swap.md").read_text(), re.DOTALL
    )
    assert len(source.splitlines()) <= 30
    (tmp_path / "my_policy.py").write_text(source)
    run = palp.start("launch", SIM, "trials:=100000", "training:=3", f"out:={tmp_path / 'out'}")
    wait_for_line(run, "estimation")
    done = palp.printed("swap", "policy", tmp_path / "my_policy.py:MyPolicy")
    assert "my_policy.py:MyPolicy at" in done
    tried = palp.printed("swap", "policy", "nodes.policy_uniform:Uniform", "--shadow", "60", "--dry-run")
    assert "messages of both compared" in tried
    assert palp.run("swap", "policy", "--reload").returncode == 0
    refused = palp.run("swap", "stage", "nodes.stage:Stage")
    assert refused.returncode == 11
    assert "safe state" in refused.stderr
    run.send_signal(signal.SIGINT)
    assert run.wait() == 128 + signal.SIGINT
