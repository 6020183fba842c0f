"""A tolerance against finite strain: L5 where small strain is not enough, L2 where it is, words elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.rig.scene import app
from palp_core.errors import MechanicsError, MethodError, OutOfRange
from palp_core.palpation.mechanics import (
    Bead,
    Phantom,
    Probe,
    Scene,
    StagePath,
    Tolerance,
    choose_rung,
    read_scene,
    run_scene,
    rung_model,
    sweep,
)
from palp_core.palpation.mechanics.scene.output import answer, answer_error, grid_m
from palp_core.palpation.mechanics.scene.rig import rig
from palp_core.palpation.mechanics.scene.scene import pressed_share

TEXT = """\
phantom: {bead: {depth_m: 0.004}}
tolerance: {output: contrast, relative: 0.05, strain: finite}
"""


def asking(output: str, relative: float, depth_m: float = 0.004) -> Scene:
    asked = Tolerance(output=output, relative=relative, strain="finite")
    return Scene(phantom=Phantom(bead=Bead(depth_m=depth_m)), tolerance=asked)


@pytest.mark.parametrize(
    ("output", "relative", "depth_m", "rung"),
    [
        ("contrast", 0.05, 0.004, "l5"),
        ("contrast", 0.12, 0.004, "l2"),
        ("contrast", 0.06, 0.008, "l5"),
        ("peak", 0.02, 0.004, "l2"),
        ("peak", 0.01, 0.008, "l5"),
    ],
)
def test_the_cheapest_rung_that_is_right_against_finite_strain_is_chosen(
    output: str, relative: float, depth_m: float, rung: str
) -> None:
    choice = choose_rung(asking(output, relative, depth_m))
    assert choice.rung == rung
    assert choice.bound is not None
    assert choice.bound <= relative
    assert f"'finite_{output}'" in choice.contact.reason


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (
            asking("contrast", 0.05, 0.002),
            r"l5 \(not available here: no error bound for 'finite_contrast': pressed_share = ",
        ),
        (asking("separation", 0.5), "no error bound for 'finite_separation'"),
        (asking("contrast", 0.001), r"l5 \(not accurate enough: within 2.0% only"),
        (
            Scene(phantom=Phantom(), tolerance=Tolerance(output="contrast", relative=0.3, strain="finite")),
            r"l5 \(not available here: no error bound for 'finite_contrast'",
        ),
        (
            replace(asking("peak", 0.05), probe=Probe(tip_radius_m=0.009)),
            r"l4 \(not available here: no error bound for 'finite_peak'",
        ),
    ],
    ids=["too-deep", "no-such-bound", "too-tight", "no-bead", "another-ball"],
)
def test_a_tolerance_that_no_rung_keeps_is_refused_with_why(scene: Scene, words: str) -> None:
    with pytest.raises(MethodError, match=words):
        choose_rung(scene)


def test_the_tip_is_never_deeper_than_the_estimate_that_keeps_l5_out() -> None:
    """By L2, the stiffer the less deep: over bare gel it is L5's within a few per cent."""
    rng, shares = np.random.default_rng(3), list[float]()
    while len(shares) < 25:
        phantom = Phantom(
            bead=Bead(depth_m=rng.uniform(0.002, 0.010)), modulus_pa=float(np.exp(rng.uniform(8.5, 11.0)))
        )
        probe = Probe(friction=rng.uniform(0.2, 0.5), tip_mass_kg=rng.uniform(0.002, 0.02))
        scene = Scene(phantom=phantom, probe=probe, path=StagePath(indentation_m=rng.uniform(0.002, 0.005)))
        ring_m = float(rng.uniform(0.002, 0.016))
        share = pressed_share(phantom, probe, scene.path.indentation_m, ring_m)
        model = rung_model("l2", phantom, probe.tip_radius_m)
        try:
            solved = sweep(model, probe, ring_m, scene.path.indentation_m, grid_m(scene, 0.001))
        except MechanicsError:
            continue  # the tip leads
        assert phantom.bead is not None
        thinnest_m = min(probe.tip_radius_m, phantom.bead.depth_m)
        shares.append(float(solved.indentation_m.max()) / thinnest_m / share)
    assert 0.8 < min(shares) <= max(shares) <= 1.0


def test_a_file_says_against_which_law(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(TEXT, encoding="utf-8")
    assert read_scene(file).tolerance == asking("contrast", 0.05).tolerance
    shown = CliRunner().invoke(app, ["explain", str(file)])
    assert "rung l5: contrast against finite strain within 2 %" in shown.output
    with pytest.raises(MethodError, match="pressed_share"):  # at 2 mm, one of the paper's three depths
        rig(scene=str(file))
    file.write_text(TEXT.replace("finite", "large"), encoding="utf-8")
    with pytest.raises(MechanicsError, match=r"scene.yaml:2:\d+: strain: must be one of small, finite"):
        read_scene(file)
    with pytest.raises(OutOfRange, match="strain"):
        Tolerance(strain="large")


@pytest.mark.slow
def test_a_chosen_rung_answers_and_is_as_right_as_it_says() -> None:
    """Random scenes within the stated boxes; L5, itself held against three dimensions, is the truth."""
    rng, chosen = np.random.default_rng(11), list[str]()
    phantoms = [
        Phantom(
            bead=Bead(depth_m=depth_m, radius_m=rng.uniform(0.0074, 0.0076)),
            height_m=rng.uniform(0.0295, 0.0305),
            poisson=rng.uniform(0.488, 0.492),
        )
        for depth_m in (0.0024, 0.0033, 0.0043, 0.0062, 0.0083)
    ]
    while len(chosen) < 60:
        scene = Scene(
            phantom=replace(phantoms[int(rng.integers(5))], modulus_pa=rng.uniform(8e3, 40e3)),
            probe=Probe(friction=rng.uniform(0.25, 0.45), tip_mass_kg=rng.uniform(0.002, 0.02)),
            path=StagePath(indentation_m=rng.uniform(0.002, 0.005)),
            ring_m=(rng.uniform(0.004, 0.016),),
            tolerance=Tolerance(
                output=str(rng.choice(["peak", "contrast"])),
                relative=float(np.exp(rng.uniform(-5.0, -1.2))),
                strain="finite",
            ),
        )
        try:
            choice = choose_rung(scene)
        except MethodError:
            continue
        run_scene(scene)  # a rung that was chosen answers
        given, true = (
            answer([rung_model(name, scene.phantom, scene.probe.tip_radius_m)], scene)
            for name in (choice.rung, "l5")
        )
        assert choice.bound is not None
        assert answer_error(given, true, scene) <= choice.bound <= scene.tolerance.relative, scene
        chosen.append(choice.rung)
    assert {"l2", "l5"} <= set(chosen)
