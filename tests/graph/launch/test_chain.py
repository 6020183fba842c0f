"""The chain on both clocks, as real processes: nothing lost, the same bytes however it runs."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from palp_core.graph.messages.frame import topic_of
from tests.support.palp import CHAIN, Palp, own_workspace
from tests.support.rig_session import ComposedGraph

TEN: dict[str, object] = {"clock": "sim", "count": 10}


def test_sample_zero_and_every_other_arrives_on_the_wall_clock(palp: Palp, tmp_path: Path) -> None:
    out = tmp_path / "arrived.json"
    palp.printed("launch", CHAIN, "count:=200", "rate_hz:=400.0", f"out:={out}")
    assert json.loads(out.read_text()) == list(range(200))
    assert palp.all_gone()


@pytest.mark.nightly
def test_lockstep_under_load_gives_the_same_bytes_as_processes_and_composed(
    palp: Palp, tmp_path: Path
) -> None:
    arguments = ("launch", CHAIN, "clock:=sim", "count:=100", "--digest")
    composed = palp.run(*arguments, tmp_path / "composed", "--compose")
    assert composed.returncode == 0, composed.stderr
    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(3)]
    try:
        done = palp.here(*arguments, tmp_path / "processes")
    finally:
        for burner in burning:
            burner.kill()
            burner.wait()
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "processes").read_text())
    assert found == json.loads((tmp_path / "composed").read_text())
    assert found["/relay/amplified"]["count"] == 100
    assert "/relay/_order" in found


def test_another_seed_gives_other_bytes() -> None:
    found: list[list[bytes]] = []
    for seed in (1, 2):
        found.append([])
        with (
            own_workspace(),
            ComposedGraph(CHAIN, observe=lambda _, frame: found[-1].append(frame), seed=seed, **TEN) as graph,
        ):
            graph.run()
    first, second = ([raw for raw in frames if topic_of(raw) == b"/source/sample"] for frames in found)
    assert len(first) == 10
    assert not {*first} & {*second}


def test_a_crashed_node_restarts_by_its_rule_and_the_run_goes_on(palp: Palp) -> None:
    palp.printed("launch", CHAIN, "count:=100", "rate_hz:=100.0", "fail_at:=50")
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
    for how, extra in ((palp.here, ()), (palp.run, ("--compose",))):
        done = how("launch", CHAIN, "clock:=sim", "count:=100", "fail_at:=50", *extra)
        assert done.returncode == 1
        noted, _, said = done.stderr.partition("\n")
        assert noted.startswith(f"{CHAIN}: note: 'restart' (relay) has no effect in simulated time")
        assert said.startswith("relay: amplify (handler of 'sample') failed: ValueError: block 50")
        assert palp.all_gone()
