"""The phantoms' nodes: torque from pose, ring and mounting, in any world; and the emulated lab."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from msgs.actuator import RingTruth
from msgs.stage import StagePose
from nodes.emulated_phantom import EmulatedPhantom
from nodes.phantom import Phantom
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise, write_noise
from palp_core.palpation.world.model import LAB
from palp_core.units import Float64Array
from tests.support.rig_messages import mount

PATH_M = np.linspace(-0.03, 0.05, 401)


def ring(ring_m: float) -> RingTruth:
    return RingTruth(stamp_ns=0, trial=0, iteration=1, ring_m=ring_m)


def pose(position_m: Float64Array = PATH_M, rate_hz: float = 100.0) -> StagePose:
    """At 20 mm/s, but for another rate."""
    return StagePose(stamp_ns=0, goal_id=9, start_ns=3_000_000, rate_hz=rate_hz, position_m=position_m)


def torque_n_m(bench: Bench[Phantom], code: str = "A", remount: int = 0) -> Float64Array:
    bench.feed(Phantom.mount, mount(code, remount))
    bench.feed(Phantom.ring, ring(0.016))
    return swept(bench)


def swept(bench: Bench[Phantom]) -> Float64Array:
    bench.feed(Phantom.pose, pose())
    return bench.sent(Phantom.contact)[-1].torque_n_m


@pytest.fixture
def flat() -> Bench[Phantom]:
    return Bench(Phantom, {"height_sd_mm": 0.0})


@pytest.fixture
def lab() -> Bench[Phantom]:
    return Bench(Phantom, {"world": "lab"}, seed=4)


@pytest.mark.parametrize(
    ("given", "asked", "rungs"),
    [
        ({}, "peak", "l2 l2 l2"),
        ({"feature": "contrast"}, "contrast", "l4 l4 l4"),
        ({"reading": "trace"}, "trace", "l4 l4 l2"),
        ({"feature": "auto"}, "trace", "l4 l4 l2"),
    ],
)
def test_the_gel_is_right_in_what_the_run_reads(given: dict[str, str], asked: str, rungs: str) -> None:
    touched = Bench(Phantom, given).node.rig
    assert {choice.output for choice in touched.choices.values()} == {asked}
    assert [choice.name for choice in touched.choices.values()] == rungs.split()


def test_a_path_that_ends_near_the_bead_has_no_contrast_to_be_right_in() -> None:
    with pytest.raises(NodeError, match=r"no contact method gives 'contrast'.*margin_m = 0.015 is not in"):
        Bench(Phantom, {"feature": "contrast", "from_m": -0.015})


def test_a_failing_region_is_reported_once_per_mounting_and_ring(flat: Bench[Phantom]) -> None:
    torque_n_m(flat, "C")
    assert flat.sent(Phantom.guard) == []
    torque_n_m(flat, "A")
    flat.feed(Phantom.pose, pose())
    (guard,) = flat.sent(Phantom.guard)
    assert (guard.code, guard.remount, guard.ring_m) == ("A", 0, 0.016)
    assert "small strain" in guard.words[0]


def test_a_stage_too_fast_to_leave_inertia_out_is_reported_and_so_is_one_that_is_slow_again(
    flat: Bench[Phantom],
) -> None:
    torque_n_m(flat, "C")
    assert flat.sent(Phantom.guard) == []
    flat.feed(Phantom.pose, pose(rate_hz=300.0))  # 60 mm/s
    (fast,) = flat.sent(Phantom.guard)
    assert fast.words == [
        "inertia: quasi_static: no error bound for 'peak': speed_m_s = 0.06 is not in [0, 0.05]; "
        "dynamic is the next finer one"
    ]
    flat.feed(Phantom.ring, ring(0.012))
    flat.feed(Phantom.pose, pose(rate_hz=300.0), pose(rate_hz=300.0), pose())
    again, slow = flat.sent(Phantom.guard)[1:]
    assert (again.ring_m, again.words, slow.words) == (0.012, fast.words, [])
    speeds = [
        json.loads(use.scene)["speed_m_s"]
        for shown in flat.sent(Phantom.methods)
        for use in shown.uses
        if use.task == "motion"
    ]
    assert speeds == [0.02, 0.06, 0.02]


def test_it_says_which_rung_is_for_each_phantom_and_on_what(flat: Bench[Phantom]) -> None:
    (shown,) = flat.sent(Phantom.methods)
    rungs = {use.of: use for use in shown.uses if use.task == "contact"}
    assert set(rungs) == {"A", "B", "C"}
    for code, use in rungs.items():
        choice = flat.node.rig.choices[code]
        assert (use.name, use.bound, use.asked) == (choice.name, choice.bound, False)
        assert json.loads(use.scene)["phantom"] == asdict(flat.node.rig.phantoms[code])


def test_each_remount_draws_the_height_again() -> None:
    bench = Bench(Phantom, {"height_sd_mm": 0.1})
    for remount in range(200):
        bench.feed(Phantom.mount, mount("A", remount))
    heights_m = np.array([t.height_offset_m for t in bench.sent(Phantom.truth)])
    assert len(set(heights_m)) == 200
    assert heights_m.std() == pytest.approx(0.1e-3, rel=0.2)


@pytest.mark.parametrize("world", ["paper", "lab"])
def test_the_torque_does_not_depend_on_the_blocks(world: str) -> None:
    bench = Bench(Phantom, {"world": world})
    whole = torque_n_m(bench)
    for part in np.array_split(PATH_M, 7):
        bench.feed(Phantom.pose, pose(part))
    parts = [c.torque_n_m for c in bench.sent(Phantom.contact)[-7:]]
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0.0, atol=1e-15)


def test_an_unknown_code_is_named(flat: Bench[Phantom]) -> None:
    with pytest.raises(NodeError, match="no phantom 'Z'; there are A, B, C"):
        flat.feed(Phantom.mount, mount("Z"))


def test_a_sweep_over_nothing_is_an_error(flat: Bench[Phantom]) -> None:
    with pytest.raises(NodeError, match="no phantom is mounted"):
        flat.feed(Phantom.pose, pose())


def test_heights_are_those_of_the_papers_world(lab: Bench[Phantom]) -> None:
    """Worlds are compared with the same luck in what they share."""
    paper = Bench(Phantom, seed=4)
    for bench in (lab, paper):
        torque_n_m(bench)
        torque_n_m(bench, "C", 1)
    heights = [[t.height_offset_m for t in bench.sent(Phantom.truth)] for bench in (lab, paper)]
    assert heights[0] == heights[1]
    assert not paper.sent(Phantom.world_truth)
    assert "world" not in json.loads(paper.sent(Phantom.methods)[0].uses[0].scene)


def test_a_sweep_of_a_lab_begins_upright_and_has_a_surface(lab: Bench[Phantom]) -> None:
    torque, tidy = torque_n_m(lab), torque_n_m(Bench(Phantom, seed=4))
    assert abs(torque[0]) < 0.1 * tidy[0]
    rough = np.diff(torque, n=2)[150:].std() / np.diff(tidy, n=2)[150:].std()
    assert rough > 2.0


def test_what_a_mounting_is_off_by_is_published_and_the_world_with_the_methods(lab: Bench[Phantom]) -> None:
    for remount, code in enumerate("AAC"):
        torque_n_m(lab, code, remount)
    first, again, other = lab.sent(Phantom.world_truth)
    assert (first.world, first.code, again.remount) == ("lab", "A", 1)
    assert first.friction != again.friction
    assert first.modulus == again.modulus != other.modulus  # one phantom, put back
    world = json.loads(lab.sent(Phantom.methods)[0].uses[0].scene)["world"]
    assert world == {"name": "lab", **LAB.values()}


def test_castings_of_a_depth_are_phantoms_of_their_own(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("phantom: {modulus_pa: 15000.0}\n", encoding="utf-8")
    bench = Bench(Phantom, {"world": "lab", "phantoms": "castings", "scene": str(scene)}, seed=4)
    for remount, code in enumerate(("A1", "A6", "C1")):
        bench.feed(Phantom.mount, mount(code, remount))
    assert [truth.depth_m for truth in bench.sent(Phantom.truth)] == [0.002, 0.002, 0.008]
    assert len({one.modulus for one in bench.sent(Phantom.world_truth)}) == 3
    assert {phantom.modulus_pa for phantom in bench.node.rig.phantoms.values()} == {15000.0}


def test_a_mounting_keeps_its_surface_and_a_remount_has_another(lab: Bench[Phantom]) -> None:
    one = torque_n_m(lab)
    np.testing.assert_array_equal(one, swept(lab))
    assert np.abs(torque_n_m(lab, "A", 1) - one)[150:].max() > 0.2e-3
    np.testing.assert_array_equal(one, torque_n_m(Bench(Phantom, {"world": "lab"}, seed=4)))  # repeatable


PORTS = {"stage_port": 0, "stop_port": 0, "can_port": 0, "emg_port": 0}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench[EmulatedPhantom]]:
    started = Bench(EmulatedPhantom, {**PORTS, "folder": str(tmp_path), "height_sd_mm": 0.1}, seed=3)
    yield started
    started.executor.transition(Transition.SHUTDOWN)


def test_the_devices_are_there(bench: Bench[EmulatedPhantom], tmp_path: Path) -> None:
    options = bench.node.rig.options
    assert set(options) == {"aerotech", "maestro", "ati", "noraxon"}
    assert (tmp_path / "maestro").is_symlink()
    socket.create_connection((options["noraxon"]["host"], options["noraxon"]["port"])).close()


def test_each_mounting_has_its_own_height_and_is_reported(bench: Bench[EmulatedPhantom]) -> None:
    bench.feed(EmulatedPhantom.mount, mount("A", 0))
    bench.feed(EmulatedPhantom.mount, mount("C", 1))
    first, second = bench.sent(EmulatedPhantom.truth)
    assert (first.code, second.code) == ("A", "C")
    assert first.height_offset_m != second.height_offset_m
    assert 0.0 < first.depth_m < second.depth_m


def test_the_probe_starts_raised(bench: Bench[EmulatedPhantom]) -> None:
    truth = bench.node.rig.call(bench.node.rig.truth)
    assert truth["z_m"] == 0.020
    assert truth["torque_n_m"] == 0.0


def test_a_failing_region_is_reported_once_per_mounting_and_ring_and_only_when_it_was_touched(
    tmp_path: Path,
) -> None:
    exact = {"repeatability_mm": 0.0, "height_sd_mm": 0.0}
    bench = Bench(EmulatedPhantom, {**PORTS, **exact, "folder": str(tmp_path)}, seed=3)

    rig: EmulatedRig = bench.node.rig

    def touch(now_ns: int) -> None:
        rig.rod.move(0.017, 6e-3, 0)
        rig.contact.loads(now_ns)  # raised: nothing is felt
        assert not rig.contact.guards
        rig.axes.z.move(0.0, 0.05, 0)
        rig.contact.loads(60_000_000_000)
        rig.contact.loads(60_000_000_000)
        rig.axes.z.move(0.02, 0.05, 60_000_000_000)

    def touched(code: str, remount: int) -> list[tuple[str, int, float]]:
        bench.feed(EmulatedPhantom.mount, mount(code, remount))
        rig.call(touch)
        bench.advance(0.3)
        given = bench.sent(EmulatedPhantom.guard)
        return [(guard.code, guard.remount, round(guard.ring_m, 9)) for guard in given]

    assert touched("C", 0) == []
    assert touched("A", 1) == [("A", 1, 0.016)]
    assert "small strain" in bench.sent(EmulatedPhantom.guard)[0].words[0]
    assert touched("A", 2) == [("A", 1, 0.016), ("A", 2, 0.016)]

    def sweep(_: int) -> None:
        rig.axes.z.move(0.0, 0.05, 60_000_000_000)
        rig.axes.y.move(0.03, 0.2, 70_000_000_000)
        rig.contact.loads(70_050_000_000)

    rig.call(sweep)
    bench.advance(0.3)
    assert any("inertia: quasi_static" in words for words in bench.sent(EmulatedPhantom.guard)[-1].words)
    assert any(use.task == "motion" for use in bench.sent(EmulatedPhantom.methods)[-1].uses)
    bench.executor.transition(Transition.SHUTDOWN)


def test_a_noise_file_has_the_spreads_of_torque_ring_and_height(tmp_path: Path) -> None:
    noise = RigNoise(
        sample_sd_n_m=Component(3e-5),
        sweep_sd_n_m=Component(0.0),
        ring_sd_m=Component(0.0),
        height_sd_m=Component(0.0),
    )
    write_noise(noise, tmp_path / "noise.yaml")
    params = {**PORTS, "folder": str(tmp_path), "noise": str(tmp_path / "noise.yaml")}
    quiet = Bench(EmulatedPhantom, params, seed=3)
    quiet.feed(EmulatedPhantom.mount, mount("A", 0))
    (truth,) = quiet.sent(EmulatedPhantom.truth)
    assert truth.height_offset_m == 0.0

    rig: EmulatedRig = quiet.node.rig

    def torque_noise(now_ns: int) -> float:
        rig.rod.move(0.013, 6e-3, 0)
        assert rig.rod.ring_m(60_000_000_000) == pytest.approx(0.012, abs=1e-12)
        return float(np.std([rig.sensor.wrench(now_ns)[3] for _ in range(2000)]))

    assert rig.call(torque_noise) == pytest.approx(3e-5, rel=0.1)
    quiet.executor.transition(Transition.SHUTDOWN)


def test_a_noise_file_that_is_none_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(NodeError, match="cannot read the noise file"):
        Bench(EmulatedPhantom, {**PORTS, "folder": str(tmp_path), "noise": "no-such.yaml"})


def test_in_the_labs_world_each_mounting_reports_what_it_is_off_by(tmp_path: Path) -> None:
    bench = Bench(EmulatedPhantom, {**PORTS, "folder": str(tmp_path), "world": "lab"}, seed=3)
    for remount, code in enumerate("AAC"):
        bench.feed(EmulatedPhantom.mount, mount(code, remount))
    first, again, other = bench.sent(EmulatedPhantom.world_truth)
    heights = [given.height_offset_m for given in bench.sent(EmulatedPhantom.truth)]
    bench.executor.transition(Transition.SHUTDOWN)
    assert first.modulus == again.modulus != other.modulus
    assert first.friction != again.friction
    assert again.height_m - first.height_m == pytest.approx(heights[1] - heights[0])
