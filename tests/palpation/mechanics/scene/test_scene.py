"""The cheapest rung that is good enough, an honest refusal where there is none, and scenes as read."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import MechanicsError, MethodError, OutOfRange
from palp_core.palpation.mechanics import (
    Bead,
    Phantom,
    Probe,
    Scene,
    StagePath,
    Tolerance,
    choose_rung,
    contact_model,
    read_scene,
    run_scene,
)
from palp_core.palpation.mechanics.equilibrium.sweep_table import solve
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.mechanics.scene.output import (
    answer,
    answer_error,
    contrast_n_m,
    peak_n_m,
)
from palp_core.palpation.mechanics.scene.rig import Rig, rig

TEXT = """\
phantom: {modulus_pa: 20000.0, poisson: 0.49, height_m: 0.030, bead: {radius_m: 0.0075, depth_m: 0.004}}
probe: {tip_radius_m: 0.006, friction: 0.3, tip_mass_kg: 0.008}
path: {indentation_m: 0.004, speed_m_s: 0.02, from_m: -0.03, to_m: 0.05}
ring_m: [0.004, 0.016]
tolerance: {output: contrast, relative: 0.1}
"""


def written(folder: Path, text: str = TEXT) -> Path:
    file = folder / "scene.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_default_scene_is_answered_by_l2_with_its_reason() -> None:
    model, choice = contact_model(Phantom(bead=Bead(depth_m=0.004)), 0.006)
    assert model.rung == choice.method.name == "l2"
    assert choice.bound is not None
    assert choice.bound <= 0.02
    assert "test_picker.py" in choice.reason
    assert model.force(np.zeros(1), np.array([0.003]))[0] > 0.0


CONTRAST = Tolerance(output="contrast", relative=0.1)
TIGHT = Tolerance(output="contrast", relative=0.03)
SHALLOW = Phantom(bead=Bead(depth_m=0.002))


@pytest.mark.parametrize(
    ("scene", "rung"),
    [
        (Scene(tolerance=CONTRAST), "l2"),
        (Scene(phantom=SHALLOW, tolerance=CONTRAST), "l2"),
        (Scene(tolerance=TIGHT), "l4"),
        (Scene(phantom=SHALLOW, tolerance=TIGHT, budget_s=1e3), "l4"),
        (Scene(phantom=Phantom(poisson=0.3, bead=Bead(depth_m=0.004))), "l4"),
        (Scene(phantom=Phantom(height_m=0.05, bead=Bead(depth_m=0.004))), "l4"),
        (Scene(phantom=Phantom(bead=Bead(depth_m=0.004, radius_m=0.003))), "l4"),
        (Scene(phantom=Phantom(bead=Bead(depth_m=0.0007))), "l4"),
    ],
)
def test_the_cheapest_rung_that_is_right_enough_is_chosen(scene: Scene, rung: str) -> None:
    assert choose_rung(scene).rung == rung


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (
            Scene(phantom=Phantom(poisson=0.2, bead=Bead(depth_m=0.004))),
            r"l2 \(not available here: no error bound for 'peak'.*relax the tolerance",
        ),
        (Scene(tolerance=Tolerance(relative=1e-9)), r"'peak' within 1e-07% at"),
        (Scene(tolerance=TIGHT, budget_s=0.1), r"budget_s is 0\.1, for which l2 gives"),
    ],
)
def test_where_no_rung_is_good_enough_the_refusal_has_the_state_of_each(scene: Scene, words: str) -> None:
    with pytest.raises(MethodError, match=words):
        choose_rung(scene)


def test_a_rung_asked_for_by_name_is_taken_with_its_stated_error_or_none() -> None:
    scene = Scene(tolerance=Tolerance(output="contrast", relative=1e-3))
    assert choose_rung(scene, "l2").bound is not None
    replayed = choose_rung(scene, "l0")
    assert (replayed.rung, replayed.bound) == ("l0", None)
    assert "finer: l2" in replayed.contact.reason
    assert [c.name for c in replayed.contact.candidates if c.mark == "chosen"] == ["l0"]


def test_a_fast_sweep_has_inertia_and_a_slow_one_does_without() -> None:
    assert choose_rung(Scene()).motion.name == "quasi_static"
    fast = choose_rung(Scene(path=StagePath(speed_m_s=0.3))).motion
    assert (fast.name, fast.bound) == ("dynamic", 0.015)
    assert (
        "quasi_static (not available here: no error bound for 'peak': speed_m_s = 0.3 is not in [0, 0.1]"
        in fast.reason
    )
    neither = choose_rung(Scene(tolerance=Tolerance(relative=1e-3)), "l4").motion
    assert (neither.name, neither.asked) == ("quasi_static", True)


def test_a_scene_reads_as_written(tmp_path: Path) -> None:
    scene = read_scene(written(tmp_path))
    assert scene == Scene(tolerance=Tolerance(output="contrast", relative=0.1))
    assert read_scene(
        written(tmp_path, TEXT.replace("0.004}}", "20e-3}}").replace("0.030", "0.04"))
    ).phantom.height_m
    bare = read_scene(written(tmp_path, TEXT.replace("{radius_m: 0.0075, depth_m: 0.004}", "none")))
    assert bare.phantom.bead is None
    assert read_scene(written(tmp_path, "ring_m: 8e-3\n")).ring_m == (0.008,)


@pytest.mark.parametrize(
    ("old", "new", "place", "says"),
    [
        ("modulus_pa", "modulis_pa", ":1:11:", "did you mean 'modulus_pa'"),
        ("depth_m: 0.004", "depth_m: .nan", ":1:98:", "nan is not in"),
        ("depth_m: 0.004", "depth_m: 0.025", ":1:98:", "below the floor"),
        ("depth_m: 0.004", "depth: 0.004", ":1:89:", "did you mean 'depth_m'"),
        (", depth_m: 0.004", "", ":1:70:", "needs depth_m"),
        ("{radius_m: 0.0075, depth_m: 0.004}", "deep", ":1:70:", "or 'none'"),
        ("friction: 0.3", "friction: lots", ":2:40:", "must be a number in SI units, not 'lots'"),
        ("friction: 0.3", "friction: 0.3, friction: 0.4", ":2:45:", "twice"),
        ("speed_m_s: 0.02", "speed_m_s: 0", ":3:41:", "speed_m_s"),
        ("[0.004, 0.016]", "[]", ":4:9:", "at least one ring"),
        ("[0.004, 0.016]", "[0.004, inf]", ":4:9:", "ring_m"),
        ("output: contrast", "output: colour", ":5:21:", "must be one of peak"),
        ("relative: 0.1", "relative: -1", ":5:41:", "positive share"),
        ("relative: 0.1", "relative: 0.1, depths_m: [0.004]", ":5:56:", "two or more"),
        ("output: contrast", "output: separation, depths_m: [0.004, 0.02]", ":5:12:", "do not fit"),
        ("probe: {", "probe: [", ":2:", "no YAML"),
    ],
)
def test_a_mistake_in_a_scene_is_named_with_its_place(
    old: str, new: str, place: str, says: str, tmp_path: Path
) -> None:
    file = written(tmp_path, TEXT.replace(old, new, 1))
    with pytest.raises(MechanicsError) as caught:
        read_scene(file)
    assert f"{file}{place}" in str(caught.value)
    assert says in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1\n", "just text\n", "a: &a [*a]\n", "\x00", "{"])
def test_what_is_no_scene_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(MechanicsError, match=r"scene\.yaml"):
        read_scene(written(tmp_path, text))
    with pytest.raises(MechanicsError, match="cannot read the scene"):
        read_scene(tmp_path / "missing.yaml")


def test_a_run_has_every_ring_and_states_what_it_met(tmp_path: Path) -> None:
    done = run_scene(read_scene(written(tmp_path)))
    told: dict[str, Any] = done.as_json()
    assert " ".join(told) == (
        "ring_m stage_m torque_n_m angle_rad normal_n peak_n_m contrast_n_m rung bound motion guards"
    )
    assert np.shape(told["torque_n_m"]) == (2, len(told["stage_m"])) == np.shape(told["normal_n"])
    assert told["peak_n_m"] == [max(row) for row in told["torque_n_m"]]
    assert 0.0 < told["contrast_n_m"][0] < told["contrast_n_m"][1] < told["peak_n_m"][1]
    assert told["rung"] == "l2"
    pressed = run_scene(Scene(phantom=Phantom(bead=Bead(depth_m=0.0015))), "l2")
    assert any("small strain" in words for words in pressed.guards)
    assert pressed.as_json()["guards"] == list(pressed.guards)


def test_contrast_is_the_height_over_the_line_through_the_ends() -> None:
    done = run_scene(Scene(), "l2")
    for one, peak, contrast in zip(done.sweeps, done.peak_n_m, done.contrast_n_m, strict=True):
        assert peak == peak_n_m(one) == one.torque_n_m.max()
        ends = sorted(one.torque_n_m[[0, -1]])
        assert peak - ends[1] <= contrast + 1e-15
        assert contrast <= peak - ends[0] + 1e-15
        assert contrast == contrast_n_m(one)
    mirrored = run_scene(Scene(path=StagePath(from_m=0.03, to_m=-0.05)), "l2")
    assert np.allclose(mirrored.contrast_n_m, done.contrast_n_m, rtol=1e-9)


@pytest.mark.parametrize(
    "given",
    [{"ring_m": ()}, {"ring_m": (math.nan,)}, {"budget_s": 0.0}, {"tolerance": Tolerance(output="separation"),
      "phantom": Phantom(height_m=0.016, bead=Bead(depth_m=0.0009))}],
)  # fmt: skip
def test_a_scene_that_is_none_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(OutOfRange):
        Scene(**given)
    with pytest.raises(OutOfRange, match="one of peak"):
        Tolerance(output="colour")


def met(touched: Rig, code: str, ring_m: float) -> tuple[str, ...]:
    """Return what a sweep over a phantom meets at the nominal height."""
    table = solve(touched.model(code), touched.probe, ring_m, touched.indentation_m, -0.03, 0.05)
    return touched.met(code, table.solved)


def test_a_rig_takes_gel_probe_and_tolerance_from_its_scene(tmp_path: Path) -> None:
    file = written(tmp_path, TEXT.replace("20000.0", "25000.0").replace("friction: 0.3", "friction: 0.35"))
    touched = rig(scene=str(file))
    assert touched.probe == Probe(friction=0.35)
    assert [p.bead.depth_m for p in touched.phantoms.values() if p.bead] == [0.002, 0.004, 0.008]
    assert {p.modulus_pa for p in touched.phantoms.values()} == {25e3}
    phantoms = tmp_path / "phantoms.yaml"
    phantoms.write_text("X: {bead: {depth_m: 0.003}}\nbare: {bead: none}\n", encoding="utf-8")
    named = rig(scene=str(file), phantoms=str(phantoms))
    assert list(named.phantoms) == ["X", "bare"]
    assert named.model("X").rung == "l2"
    assert met(named, "bare", 0.0) == met(named, "bare", 0.016) == met(named, "X", 0.0) == ()
    (words,) = met(named, "X", 0.016)
    assert "small strain" in words
    with pytest.raises(MechanicsError):
        met(named, "X", -0.01)
    phantoms.write_text("X: {bed: none}\n", encoding="utf-8")
    with pytest.raises(MechanicsError, match=r"phantoms\.yaml:1:5: phantom 'X' has no key 'bed'"):
        rig(phantoms=str(phantoms))


@pytest.mark.parametrize(
    ("read", "tolerance", "asked", "rungs"),
    [
        ("peak", "{output: contrast, relative: 0.1}", "peak", "l2 l2 l2"),
        ("contrast", "{relative: 0.1}", "contrast", "l2 l2 l4"),
        ("trace", "{relative: 0.1}", "trace", "l4 l2 l2"),
        ("trace", "{output: decision, relative: 0.1}", "trace", "l4 l2 l2"),
        ("area", "{relative: 0.02}", "trace", "l4 l4 l2"),
        ("peak", "{output: decision, relative: 0.1}", "decision", "l2 l2 l2"),
    ],
)
def test_a_rig_gets_right_what_its_run_reads(
    read: str, tolerance: str, asked: str, rungs: str, tmp_path: Path
) -> None:
    file = written(tmp_path, TEXT.replace("{output: contrast, relative: 0.1}", tolerance))
    touched = rig(scene=str(file), read=read)
    assert touched.output == asked
    assert [choice.name for choice in touched.choices.values()] == rungs.split()


def test_the_error_of_a_trace_is_its_largest_anywhere_over_the_peak() -> None:
    scene = Scene(ring_m=(0.008, 0.016), tolerance=Tolerance(output="trace"))
    models = [rung_model(rung, scene.phantom, 0.006) for rung in ("l2", "l4")]
    given, true = (answer([model], scene) for model in models)
    off = np.abs(given - true).max(axis=1) / np.abs(true).max(axis=1)
    assert answer_error(given, true, scene) == off.max()
    peaks, bound = replace(scene, tolerance=Tolerance()), choose_rung(scene, "l2").bound
    assert answer_error(given.max(axis=1), true.max(axis=1), peaks) < off.max() <= (bound or 0.0)


def test_a_fast_scene_is_run_with_inertia_and_one_too_fast_says_that_it_is_left_out() -> None:
    slow, fast, wild = (
        run_scene(Scene(path=StagePath(speed_m_s=v), ring_m=(0.004,))) for v in (0.02, 0.3, 3.0)
    )
    assert slow.choice.motion.name == wild.choice.motion.name == "quasi_static"
    assert any(words.startswith("inertia: quasi_static: no error bound for 'peak'") for words in wild.guards)
    assert not any("inertia" in words for words in slow.guards)
    assert fast.as_json()["motion"] == "dynamic"
    assert fast.sweeps[0].stage_m.tolist() == slow.sweeps[0].stage_m.tolist()
    assert fast.contrast_n_m[0] != pytest.approx(slow.contrast_n_m[0], rel=0.05)
    back = run_scene(Scene(path=StagePath(speed_m_s=0.3, from_m=0.03, to_m=-0.05), ring_m=(0.004,)))
    assert back.peak_n_m == pytest.approx(fast.peak_n_m, rel=1e-9)
