"""The chosen rung is right enough on random scenes, and every stated bound is kept.

``data/picker.json`` is ``reference.json`` of ``palp study run contact-validity --quick``: the first ten of
its
random scenes with the outputs of L4 at 0.5 mm. The study's 200 are the slow test.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from palp_core.errors import MechanicsError
from palp_core.mechanics import Scene, choose_rung, read_scene, rung_model
from palp_core.mechanics.scene_output import decisions, outputs
from palp_core.methods import find
from palp_core.studies.contact_scenes import random_scene
from palp_core.studies.contact_validity import judge

RECORDS: list[dict[str, Any]] = json.loads((Path(__file__).parent / "data" / "picker.json").read_text())
LIVE_L4 = 5  # one of L4's, over a bead that is quickly set up


def scene_of(record: dict[str, Any], folder: Path) -> Scene:
    keys = ("phantom", "probe", "path", "ring_m", "tolerance")
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump({key: record[key] for key in keys}), encoding="utf-8")
    return read_scene(file)


def error_of(scene: Scene, rung: str, truth: list[Any]) -> float:
    models = [rung_model(rung, phantom, scene.probe.tip_radius_m) for phantom in scene.phantoms]
    if scene.tolerance.output == "decision":
        made = decisions(models, scene, np.random.default_rng(1))
        return float(np.mean(made != np.array([[int(c) for c in row] for row in truth])))
    return float(np.max(np.abs(outputs(models, scene) / np.array(truth) - 1.0)))


@pytest.mark.parametrize("index", range(len(RECORDS)))
def test_the_chosen_rung_is_right_enough(index: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PALP_CACHE", str(tmp_path / "cache"))
    record = RECORDS[index]
    scene = scene_of(record, tmp_path)
    choice = choose_rung(scene)
    assert choice.bound is not None
    assert choice.bound <= scene.tolerance.relative
    if choice.rung == "l2" or index == LIVE_L4:
        error = error_of(scene, choice.rung, record["truth"])
        assert error == pytest.approx(record["errors"][choice.rung], abs=0.1 * choice.bound)
    else:
        error = record["errors"][choice.rung]
    assert error <= choice.bound


@pytest.mark.parametrize("index", range(len(RECORDS)))
def test_a_stated_bound_is_kept_by_every_rung_that_states_one(index: int, tmp_path: Path) -> None:
    record = RECORDS[index]
    scene = scene_of(record, tmp_path)
    for rung, error in record["errors"].items():
        bound = find("contact", rung).bound(scene.tolerance.output, scene.quantities())
        assert bound is None or error <= bound


def test_random_scenes_are_the_same_for_the_same_seed_and_within_the_ranges() -> None:
    one, two = ([random_scene(rng) for _ in range(50)] for rng in map(np.random.default_rng, (3, 3)))
    assert one == two
    for scene in one:
        bead = scene.phantom.bead
        assert bead is not None
        assert 0.0005 <= bead.depth_m <= 0.015
        assert 0.3 <= scene.phantom.poisson <= 0.4999
        assert scene.path.indentation_m < scene.probe.tip_radius_m


@pytest.mark.slow
def test_two_hundred_random_scenes_are_right_enough_at_most_twice_the_cheapest_cost() -> None:
    rng, ratios, judged = np.random.default_rng(20), [], 0
    while judged < 200:
        try:
            one = judge(random_scene(rng))
        except MechanicsError:
            continue  # no equilibrium with a lagging tip
        judged += 1
        assert not one.wrong, one
        assert not one.broken, one
        if one.cost_ratio is not None:
            ratios.append(one.cost_ratio)
    assert max(ratios) <= 2.0
