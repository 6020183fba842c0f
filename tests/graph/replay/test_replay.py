"""``palp bag replay``: the same bytes from the bag alone, or the first difference by name."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.support.palp import CHAIN, SIM, Palp
from tests.support.rig_session import RigSession

LIGHT = ("policy", "actuator", "stage", "torque", "emg")
HEAVY = ("estimator", "phantom", "cocontraction")


@pytest.fixture(scope="module")
def chain_bag(shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded run of the chain."""
    bag = tmp_path_factory.mktemp("chain") / "bag"
    done = shared_palp.here("launch", CHAIN, "clock:=sim", "count:=300", "--record", bag)
    assert done.returncode == 0, done.stderr
    return bag


@pytest.fixture
def chain(chain_bag: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A recorded run of the chain, and a launch file of the same nodes that may be changed."""
    shutil.copytree(CHAIN.parents[1], tmp_path / "chain")
    return chain_bag, tmp_path / "chain" / "launch" / "chain.yaml"


@pytest.fixture
def rig_bag(rig_session: RigSession) -> Path:
    return rig_session.bag


@pytest.mark.parametrize("nodes", [LIGHT, pytest.param(HEAVY, marks=pytest.mark.nightly)])
def test_every_node_of_the_rig_replays_byte_for_byte(
    palp: Palp, rig_bag: Path, nodes: tuple[str, ...]
) -> None:
    done = palp.run("bag", "replay", rig_bag, "--nodes", ",".join(nodes), "--launch", SIM, "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    for node in json.loads(done.stdout):
        assert node["divergence"] is None
        assert node["compared"] > 0
        assert node["consumed"] > 0


def test_a_changed_node_is_caught_at_its_first_different_output(palp: Palp, chain: tuple[Path, Path]) -> None:
    bag, launch = chain
    relay = launch.parents[1] / "nodes" / "relay.py"
    same = palp.run("bag", "replay", bag, "--nodes", "source,relay", "--launch", launch)
    assert same.returncode == 0, same.stdout + same.stderr
    assert "relay: 301 outputs equal to the recorded ones, byte for byte" in same.stdout
    text = relay.read_text()
    assert "self.params.gain," in text
    relay.write_text(text.replace("self.params.gain,", "self.params.gain + (sample.index == 123),"))
    changed = palp.run("bag", "replay", bag, "--nodes", "relay", "--launch", launch, "--json")
    assert changed.returncode == 1
    (node,) = json.loads(changed.stdout)
    assert node["compared"] == 124
    assert node["divergence"]["topic"] == "/relay/amplified"
    assert node["divergence"]["sequence"] == 124
    assert node["divergence"]["what"].startswith("torque_n_m: recorded")
    assert node["divergence"]["after"].startswith("input:sample 124")


def test_an_output_too_few_or_too_many_is_a_difference(palp: Palp, chain: tuple[Path, Path]) -> None:
    bag, launch = chain
    relay = launch.parents[1] / "nodes" / "relay.py"
    text = relay.read_text()
    start = "        self.state.passed_count += 1\n"
    assert start in text
    relay.write_text(text.replace(start, start + "        if sample.index == 299:\n            return\n"))
    fewer = palp.run("bag", "replay", bag, "--nodes", "relay", "--launch", launch)
    assert fewer.returncode == 1
    assert "/relay/amplified 300" in fewer.stdout
    assert "recorded, but not replayed" in fewer.stdout


def test_what_cannot_be_replayed_is_refused_by_name(
    palp: Palp, chain: tuple[Path, Path], rig_bag: Path
) -> None:
    bag, launch = chain
    unknown = palp.run("bag", "replay", bag, "--nodes", "realy", "--launch", launch)
    assert unknown.returncode == 2
    assert "no node 'realy' in it; there are: source, relay, sink" in unknown.stderr
    record = palp.run("bag", "replay", rig_bag, "--nodes", "experiment", "--launch", SIM)
    assert record.returncode == 2
    assert "node 'experiment' keeps a record on disk" in record.stderr
