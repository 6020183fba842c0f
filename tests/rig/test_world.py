"""The simulated phantom in a world of its own: what differs, what is told, what a replacement inherits."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from msgs.actuator import RingTruth
from msgs.stage import StagePose
from nodes.phantom import Phantom
from palp_core import Bench
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array
from tests.support.rig_messages import mount

PATH_M = np.linspace(-0.03, 0.05, 401)


def swept(
    bench: Bench[Phantom], code: str = "A", remount: int = 0, goal: int = 1, path_m: Float64Array = PATH_M
) -> Float64Array:
    """Return what a sweep feels, in two blocks of poses."""
    bench.feed(Phantom.mount, mount(code, remount))
    bench.feed(Phantom.ring, RingTruth(stamp_ns=0, trial=0, iteration=1, ring_m=0.016))
    return felt(bench, goal, path_m)


def felt(bench: Bench[Phantom], goal: int, path_m: Float64Array = PATH_M) -> Float64Array:
    for part in np.array_split(path_m, 2):
        bench.feed(
            Phantom.pose, StagePose(stamp_ns=0, goal_id=goal, start_ns=0, rate_hz=100.0, position_m=part)
        )
    return np.concatenate([sent.torque_n_m for sent in bench.sent(Phantom.contact)[-2:]])


@pytest.fixture
def lab() -> Bench[Phantom]:
    return Bench(Phantom, {"world": "lab"}, seed=4)


def test_heights_are_those_of_the_papers_world(lab: Bench[Phantom]) -> None:
    """Worlds are compared with the same luck in what they share."""
    paper = Bench(Phantom, seed=4)
    for bench in (lab, paper):
        swept(bench)
        swept(bench, "C", 1, 2)
    heights = [[t.height_offset_m for t in bench.sent(Phantom.truth)] for bench in (lab, paper)]
    assert heights[0] == heights[1]
    assert not paper.sent(Phantom.world_truth)
    assert "world" not in json.loads(paper.sent(Phantom.methods)[0].uses[0].scene)


def test_a_sweep_begins_upright_and_has_a_surface(lab: Bench[Phantom]) -> None:
    torque = swept(lab)
    tidy = swept(Bench(Phantom, seed=4))
    assert abs(torque[0]) < 0.1 * tidy[0]
    rough = np.diff(torque, n=2)[150:].std() / np.diff(tidy, n=2)[150:].std()
    assert rough > 2.0


def test_what_a_mounting_is_off_by_is_told_and_the_world_with_the_methods(lab: Bench[Phantom]) -> None:
    swept(lab, "A", 0)
    swept(lab, "A", 1, 2)
    swept(lab, "C", 2, 3)
    first, again, other = lab.sent(Phantom.world_truth)
    assert (first.world, first.code, again.remount) == ("lab", "A", 1)
    assert first.friction != again.friction
    assert first.modulus == again.modulus != other.modulus  # one phantom, put back
    told = json.loads(lab.sent(Phantom.methods)[0].uses[0].scene)["world"]
    assert told == {"name": "lab", **LAB.values()}


def test_castings_of_a_depth_are_phantoms_of_their_own(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("phantom: {modulus_pa: 15000.0}\n", encoding="utf-8")
    bench = Bench(Phantom, {"world": "lab", "phantoms": "castings", "scene": str(scene)}, seed=4)
    for remount, code in enumerate(("A1", "A6", "C1")):
        bench.feed(Phantom.mount, mount(code, remount))
    assert [truth.depth_m for truth in bench.sent(Phantom.truth)] == [0.002, 0.002, 0.008]
    assert len({told.modulus for told in bench.sent(Phantom.world_truth)}) == 3
    assert {phantom.modulus_pa for phantom in bench.node.rig.phantoms.values()} == {15000.0}


def test_a_mounting_keeps_its_surface_and_a_remount_has_another(lab: Bench[Phantom]) -> None:
    smooth = Bench(Phantom, {"world": "lab"}, seed=4)
    one, two = swept(lab), felt(lab, 1)
    np.testing.assert_array_equal(one, two)
    assert np.abs(swept(lab, "A", 1, 1) - one)[150:].max() > 0.2e-3
    np.testing.assert_array_equal(one, swept(smooth))  # and a run is repeatable


def test_a_replacement_feels_what_it_would_have_felt(lab: Bench[Phantom]) -> None:
    swept(lab)
    heir = Bench(Phantom, {"world": "lab"}, seed=99)
    heir.node.state = copy.deepcopy(lab.node.state)
    np.testing.assert_array_equal(felt(heir, 5), felt(lab, 5))
