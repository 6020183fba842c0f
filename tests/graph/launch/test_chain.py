"""The chain on both clocks, as real processes: nothing lost, the same bytes however it runs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

from tests.support.palp import CHAIN, PATIENCE_S, Palp, wait_for_line


def test_sample_zero_and_every_other_arrives_on_the_wall_clock(palp: Palp, tmp_path: Path) -> None:
    out = tmp_path / "arrived.json"
    done = palp.run("launch", CHAIN, "count:=200", "rate_hz:=400.0", f"out:={out}")
    assert done.returncode == 0, done.stderr
    assert json.loads(out.read_text()) == list(range(200))
    assert palp.all_gone()


def test_lockstep_gives_the_same_bytes_as_processes_composed_and_under_load(
    palp: Palp, tmp_path: Path
) -> None:
    arguments = ("launch", CHAIN, "clock:=sim", "count:=100", "--digest")
    digests = []
    for name, extra in (("processes", ()), ("composed", ("--compose",))):
        done = palp.run(*arguments, tmp_path / name, *extra)
        assert done.returncode == 0, done.stderr
        digests.append(json.loads((tmp_path / name).read_text()))
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(3)]
    try:
        loaded = palp.run(*arguments, tmp_path / "loaded")
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    assert loaded.returncode == 0, loaded.stderr
    digests.append(json.loads((tmp_path / "loaded").read_text()))
    assert digests[0] == digests[1] == digests[2]
    assert digests[0]["/relay/amplified"]["count"] == 100
    assert "/relay/_order" in digests[0]


def test_another_seed_gives_other_bytes(palp: Palp, tmp_path: Path) -> None:
    arguments = ("launch", CHAIN, "clock:=sim", "count:=10", "--compose", "--digest")
    for seed in (1, 2):
        assert palp.run(*arguments, tmp_path / str(seed), f"seed:={seed}").returncode == 0
    first, second = (json.loads((tmp_path / str(seed)).read_text()) for seed in (1, 2))
    assert first["/source/sample"]["sha256"] != second["/source/sample"]["sha256"]


def test_tools_see_the_running_graph(palp: Palp) -> None:
    process = palp.start("launch", CHAIN, "count:=1000000", "rate_hz:=200.0")
    wait_for_line(process, "blocks: 1/")
    nodes = palp.run("node", "list", "--json")
    assert [node["name"] for node in json.loads(nodes.stdout)] == ["/source", "/relay", "/sink"]
    topics = palp.run("topic", "list", "--show-types")
    assert "/relay/amplified [Sample]" in topics.stdout.splitlines()
    echoed = palp.run("topic", "echo", "/relay/amplified", "--times", "3", "--json")
    indices = [json.loads(line)["index"] for line in echoed.stdout.splitlines()]
    assert indices == list(range(indices[0], indices[0] + 3))
    rate = json.loads(palp.run("topic", "hz", "/source/sample", "--window", "50", "--json").stdout)
    assert rate["lost"] == 0
    unknown = palp.run("topic", "echo", "/relay/amplifed", "--once")
    assert unknown.returncode == 2
    assert "did you mean '/relay/amplified'?" in unknown.stderr
    process.terminate()
    assert process.wait(PATIENCE_S) == 143
    assert palp.all_gone()
    assert palp.run("node", "list").returncode == 2


def test_a_crashed_node_restarts_by_its_rule_and_the_run_goes_on(palp: Palp) -> None:
    done = palp.run("launch", CHAIN, "count:=100", "rate_hz:=100.0", "fail_at:=50")
    assert done.returncode == 0, done.stderr
    logs = palp.run("logs", "--level", "warning", "--since", "1h")  # they are kept after a clean end
    assert re.match(r"graph 'chain' of \S+chain\.yaml, id chain-\w+, is over; it began at \d", logs.stderr)
    said = [re.sub(r"^\S+ ", "", line) for line in logs.stdout.splitlines()]
    failed = "relay: [CRITICAL] [relay]: amplify (handler of 'sample') failed: ValueError: block 50"
    for begin in (failed, "relay:     Traceback", "relay: [WARNING] [supervisor]: relay amplify"):
        assert [line for line in said if line.startswith(begin)]
    assert [line for line in said if "[INFO]" in line or line.startswith("sink")] == []
    assert palp.run("logs", "--since", "0s").stderr.endswith("nothing like that was printed\n")
    assert "\n    Traceback (most recent call last):\n" in palp.run("logs", "relay").stdout


def test_a_crash_in_lockstep_ends_the_run_and_names_the_node(palp: Palp) -> None:
    for extra in ((), ("--compose",)):
        done = palp.run("launch", CHAIN, "clock:=sim", "count:=100", "fail_at:=50", *extra)
        assert done.returncode == 1
        noted, _, said = done.stderr.partition("\n")
        assert noted.startswith(f"{CHAIN}: note: 'restart' (relay) has no effect in simulated time")
        assert said.startswith("relay: amplify (handler of 'sample') failed: ValueError: block 50")
        assert palp.all_gone()
