"""The chosen rung is right enough on random scenes, and every stated bound is kept.

``data/picker.jsonl`` are lines of ``scenes.jsonl`` of ``palp study run contact-validity``: its first ten
random scenes and its first near the published rig, with the outputs of L4 at 0.5 mm. The slow test judges a
few again; set ``PALP_PICKER`` to a folder of the study to judge its 200 and 50, from what it holds on.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import MechanicsError
from palp_core.methods import find
from palp_core.palpation.mechanics import choose_rung, rung_model
from palp_core.palpation.mechanics.scene.output import answer, answer_error
from palp_core.palpation.studies.contact import validity as contact_validity
from palp_core.palpation.studies.contact.judged import NEAR, Judged, judge, reference_models, scene_of
from palp_core.palpation.studies.contact.scenes import near_scene, random_scene
from palp_core.palpation.studies.contact.validity import kept, scenes

LINES = (Path(__file__).parent / "data" / "picker.jsonl").read_text(encoding="utf-8").splitlines()
FOUND = [Judged.of_line(line, any_code=True) for line in LINES]
RECORDS = [one for one in FOUND if one is not None and not one.skipped]
LIVE_L4 = 7  # scene that L4 answers over a bead that is quickly set up
LIVE = [one for one in RECORDS if one.rung == "l2" or one.index == LIVE_L4]


def test_the_scenes_on_record_are_those_that_are_drawn() -> None:
    assert len(RECORDS) == len(LINES) >= 10
    assert {one.scene.tolerance.output for one in RECORDS} == {"peak", "contrast", "separation", "decision"}


def test_a_scene_whose_last_digit_another_machine_rounds_otherwise_is_the_same() -> None:
    kept = json.loads(LINES[0])
    depth_m = kept["phantom"]["bead"]["depth_m"]
    for change, found in ((1.0 + 1e-15, True), (1.0 + 1e-9, False)):
        kept["phantom"]["bead"]["depth_m"] = depth_m * change
        assert (Judged.of_line(json.dumps(kept), any_code=True) is not None) == found


@pytest.mark.parametrize("one", RECORDS, ids=lambda one: str(one.index))
def test_the_chosen_rung_is_right_enough_and_stated_bounds_are_kept(one: Judged) -> None:
    assert not one.wrong
    assert one.broken == []
    if one.rung:
        assert one.bound is not None
        assert one.own[one.rung] <= one.bound <= one.scene.tolerance.relative


@pytest.mark.parametrize("one", LIVE, ids=lambda one: str(one.index))
def test_the_chosen_rung_still_gives_what_is_on_record(
    one: Judged, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PALP_CACHE", str(tmp_path / "cache"))
    scene = one.scene
    probe = scene.probe
    models = [rung_model(one.rung, phantom, probe.tip_radius_m) for phantom in scene.phantoms]
    truth = one.truth
    if scene.tolerance.output == "decision":
        truth = [[int(c) for c in row] for row in truth]
    error = answer_error(answer(models, scene), np.array(truth, dtype=np.float64), scene)
    assert error == pytest.approx(one.own[one.rung], abs=0.1 * (one.bound or 0.0))


def test_a_rung_that_refuses_a_scene_states_no_bound_for_it() -> None:
    """Gel thinner than a quarter of the ball's radius: L2 has no answer there."""
    quantities = {"depth_m": 0.0016, "tip_radius_m": 0.0065, "depth_per_tip": 0.0016 / 0.0065}
    assert find("contact", "l2").bound("peak", quantities) is None
    assert find("contact", "l4").bound("peak", quantities) is not None


def test_random_scenes_are_the_same_for_the_same_index_and_within_the_ranges() -> None:
    assert [scene_of(i) for i in range(9)] == [scene_of(i) for i in range(9)]
    drawn = [scene_of(i) for i in range(200)]
    for scene in drawn:
        bead = scene.phantom.bead
        if bead is not None:
            assert 0.0005 <= bead.depth_m <= 0.015
        assert 0.3 <= scene.phantom.poisson <= 0.4999
        assert scene.path.indentation_m < scene.probe.tip_radius_m
    assert any(scene.phantom.bead is None for scene in drawn)
    outputs = [scene.tolerance.output for scene in drawn]
    assert all(outputs.count(output) >= 25 for output in set(outputs))
    near = scene_of(NEAR).phantom
    assert near.height_m == pytest.approx(0.030, abs=0.002)
    one, two = (near_scene(np.random.default_rng(3)), random_scene(np.random.default_rng(3)))
    assert one != two


def test_a_stopped_study_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[int] = []
    told: list[str] = []

    def found(index: int, *, timed: bool = True) -> Judged:
        judged.append(index)
        assert not timed
        skipped = "no lagging equilibrium" if index == 1 else ""
        return Judged(index, scene_of(index), {}, {}, {}, [], skipped)

    monkeypatch.setattr(contact_validity, "judge", found)
    first = scenes(tmp_path, 3, timed=False, tell=told.append)
    assert [next(first).index, next(first).index] == [0, 1]
    file = tmp_path / "scenes.jsonl"
    file.write_text(file.read_text(encoding="utf-8") + '{"index": 2, "cut sh', encoding="utf-8")
    assert [one.index for one in scenes(tmp_path, 3, timed=False, tell=told.append)] == [0, 1, 2, 3]
    assert judged == [0, 1, 2, 3]
    assert len(told) == 4
    assert [one.index for one in scenes(tmp_path, 3, timed=False)] == [0, 1, 2, 3]
    assert judged == [0, 1, 2, 3]
    monkeypatch.setattr("palp_core.palpation.studies.contact.judged.code", lambda: b"other models")
    assert kept(tmp_path) == {}
    assert sorted(kept(tmp_path, any_code=True)) == [0, 1, 2, 3]


@pytest.mark.slow
def test_random_scenes_are_right_enough_at_most_twice_the_cheapest_cost(tmp_path: Path) -> None:
    out, ratios = Path(os.environ.get("PALP_PICKER", tmp_path)), []
    anywhere, near = (200, 50) if "PALP_PICKER" in os.environ else (8, 2)
    for one in (*scenes(out, anywhere), *scenes(out, near, NEAR)):
        assert not one.failed, one.skipped
        assert not one.wrong, one.line()
        assert one.broken == []
        if one.cost_ratio is not None:
            ratios.append(one.cost_ratio)
    assert np.median(ratios) <= 2.0


@pytest.mark.slow
def test_where_the_reference_has_no_lagging_equilibrium_the_chosen_rung_has_none_either() -> None:
    scene = scene_of(11)
    chosen = rung_model(choose_rung(scene).rung, scene.phantom, scene.probe.tip_radius_m)
    for model in (chosen, *reference_models(scene)):
        with pytest.raises(MechanicsError, match="no lagging equilibrium"):
            answer([model], scene)


def test_a_scene_without_an_answer_is_not_wrong() -> None:
    one = Judged(11, scene_of(11), {}, {}, {}, [], "no lagging equilibrium")
    assert one.rung
    assert not one.wrong
    assert replace(one, skipped="").wrong


@pytest.mark.slow
def test_a_scene_judged_anew_gives_what_is_on_record() -> None:
    record = RECORDS[LIVE_L4]
    again = judge(record.index, timed=False)
    assert again.truth == pytest.approx(record.truth, rel=1e-6)
    assert again.own == pytest.approx(record.own, rel=1e-4)
