"""The ball's form: its gap, every rung by it, and no place that takes another than the probe's."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics import Phantom, Probe, Scene, StagePath, read_scene, run_scene
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.mechanics.scene.rig import rig
from palp_core.palpation.mechanics.tip import TIP_FORMS, TipForm, contact_radius_m, gap_m, overlap_radius_m

ROOT, TIP_M = Path(__file__).parents[3], 0.006
PLACES = ("rung_model", "contact_model", "target")
RUNGS = ("HarmonicContact", "LayeredHertz", "FittedBump", "FiniteStrainContact")


def test_the_gap_is_that_of_a_circle_and_of_its_parabola() -> None:
    aside_m = np.linspace(0.0, TIP_M, 50)
    sphere = gap_m("sphere", TIP_M, aside_m)
    assert np.allclose((TIP_M - sphere) ** 2 + aside_m**2, TIP_M**2, rtol=1e-12)
    assert np.allclose(gap_m("paraboloid", TIP_M, aside_m), aside_m**2 / 0.012, rtol=1e-15)
    assert gap_m("sphere", TIP_M, np.array(0.007)) == TIP_M


@pytest.mark.parametrize("tip", TIP_FORMS)
def test_the_undeformed_bodies_overlap_as_far_as_the_gap_is_less_than_the_indentation(tip: TipForm) -> None:
    for indentation_m in (0.0001, 0.003, 0.006):
        edge = overlap_radius_m(tip, TIP_M, indentation_m)
        assert float(gap_m(tip, TIP_M, np.array(edge))) == pytest.approx(indentation_m, rel=1e-9)
        assert contact_radius_m(tip, TIP_M, indentation_m) < edge


@pytest.mark.parametrize("rung", ["l0", "l2", "l4", pytest.param("l5", marks=pytest.mark.slow)])
def test_a_sphere_presses_less_than_its_paraboloid(rung: str) -> None:
    """By a tenth of the indentation over the radius on a half-space, by somewhat more on a slab."""
    depth_m = np.array([0.0006, 0.003])
    sphere, paraboloid = (
        rung_model(rung, Phantom(), TIP_M, tip).force(np.zeros(()), depth_m)[0] for tip in TIP_FORMS
    )
    assert sphere / paraboloid == pytest.approx(1.0 - 0.12 * depth_m / TIP_M, abs=0.015)


@pytest.mark.parametrize("rung", ["l0", "l1", "l2", "l3", "l4", "l5"])
def test_a_form_that_there_is_not_is_refused_by_every_rung(rung: str) -> None:
    phantom = Phantom(poisson=0.4)
    with pytest.raises(OutOfRange, match="'cone' is no form of the tip; use sphere or paraboloid") as caught:
        rung_model(rung, phantom, TIP_M, "cone").force(np.zeros(()), np.array(0.001))  # type: ignore[arg-type]
    assert caught.value.quantity == "tip"


@pytest.mark.parametrize("rung", ["l1", "l3"])
def test_a_rung_that_knows_the_paraboloid_only_says_so(rung: str) -> None:
    scene = Scene(
        phantom=Phantom(poisson=0.4), path=StagePath(indentation_m=0.001, from_m=-0.002, to_m=0.002)
    )
    forces = [
        rung_model(rung, scene.phantom, TIP_M, tip).force(np.zeros(()), np.array(0.001))[0]
        for tip in TIP_FORMS
    ]
    assert forces[0] == forces[1]
    words = f"tip: {rung} takes the sphere for a paraboloid"
    assert any(words in said for said in run_scene(scene, rung).guards)
    as_it_is = replace(scene, probe=Probe(tip="paraboloid"))
    assert not any("paraboloid" in said for said in run_scene(as_it_is, rung).guards)


def test_forms_have_set_ups_of_their_own_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PALP_CACHE", str(tmp_path))
    for _ in range(2):  # computed, then read
        forces = [
            float(rung_model("l4", Phantom(), TIP_M, tip).force(np.zeros(()), np.array(0.004))[0])
            for tip in TIP_FORMS
        ]
        assert forces[0] < 0.95 * forces[1]
    assert len(list(tmp_path.glob("l4-table-*.npz"))) == 2


def test_a_scene_file_names_the_form_and_its_runs_take_it(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text("probe: {tip_radius_m: 0.006, tip: paraboloid}\n", encoding="utf-8")
    scene = read_scene(file)
    assert scene.probe == Probe(tip="paraboloid")
    assert rig(scene=str(file)).model("A").tip == "paraboloid"  # type: ignore[attr-defined]
    assert rig().model("A").tip == "sphere"  # type: ignore[attr-defined]
    peaks = [run_scene(one).peak_n_m[0] for one in (scene, replace(scene, probe=Probe()))]
    assert 1e-4 < abs(peaks[0] / peaks[1] - 1.0) < 0.01  # the joint gives way: the peak hardly feels it


@pytest.mark.parametrize("text", ["cube", "[sphere]", "1.0"])
def test_a_form_that_there_is_not_is_named_with_its_place(text: str, tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(f"ring_m: 0.008\nprobe: {{tip: {text}}}\n", encoding="utf-8")
    with pytest.raises(MechanicsError) as caught:
        read_scene(file)
    assert f"{file}:2:14:" in str(caught.value)
    assert "is no form of the tip; use sphere or paraboloid" in str(caught.value)


def forgetful(source: str) -> list[int]:
    """Return the lines of calls that take the probe's radius and leave its form to chance."""
    lines = []
    for call in ast.walk(ast.parse(source)):
        if not isinstance(call, ast.Call):
            continue
        name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        given = [*call.args, *(keyword.value for keyword in call.keywords)]
        named = {one.attr for one in given if isinstance(one, ast.Attribute)}
        if name in (*PLACES, *RUNGS) and "tip_radius_m" in named:
            told = "tip" in named or any(keyword.arg == "tip" for keyword in call.keywords)
            lines += [] if told else [call.lineno]
    return lines


def test_whoever_takes_the_probes_radius_takes_its_form_too() -> None:
    assert forgetful("rung_model('l2', phantom, probe.tip_radius_m)\n") == [1]
    assert forgetful("rung_model('l2', phantom, probe.tip_radius_m, probe.tip)\n") == []
    texts = {
        str(file): file.read_text(encoding="utf-8")
        for part in ("src", "nodes", "benchmarks")
        for file in (ROOT / part).rglob("*.py")
    }
    takers = {file: text for file, text in texts.items() if "tip_radius_m" in text}
    assert len(takers) > 15
    assert {file: lines for file, text in takers.items() if (lines := forgetful(text))} == {}
