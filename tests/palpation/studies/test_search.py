"""The study ``search``: what searches came to, the rig that they sweep, the peer, and the page."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palp_core.palpation.perception.search.searcher import Searcher
from palp_core.palpation.perception.search.settings import Lane
from palp_core.palpation.session.search_settings import SearchParams
from palp_core.palpation.studies.search import study as search_study
from palp_core.palpation.studies.search.cases import DIFFERENCES, FIRST, POLICIES, RINGS
from palp_core.palpation.studies.search.peer import GaussianMap
from palp_core.palpation.studies.search.rig import SearchCase, Searched, SearchRig, search
from palp_core.palpation.studies.search.study import depth_rows, summarise_searches
from palp_core.palpation.world.model import LAB
from palp_core.palpation.world.plane import PlaneBead, PlanePhantom, PlanePrior
from tests.palpation.perception.search.made_up import SETTINGS, answers, torque

EMPTY = Searched([], "none", [], [], 60.0, 7, 0.5, 0.7)
FOUND = Searched(
    [[0.01, 0.0, 0.004]], "bead", [[0.0103, 0.0004, 0.0042]], [[True, True, False]], 40.0, 5, 0.5, 0.5
)
AWAY = replace(FOUND, named=[[0.03, 0.0, 0.004]], held=[[False, True, True]], seconds=80.0)
MISSED = replace(FOUND, verdict="does_not_fit", named=[], held=[], seconds=100.0)


def test_searches_are_summed_up_by_what_they_named() -> None:
    alarm = replace(EMPTY, verdict="bead", named=[[0.0, 0.0, 0.005]], held=[])
    row = summarise_searches([EMPTY, EMPTY, alarm, FOUND, FOUND, AWAY, MISSED])
    assert (row["phantoms"], row["beads"], row["found"], row["false_alarms"]) == (7, 4, 2, 1)
    assert row["found_share"] == 0.5
    assert row["found_ci"][0] < 0.5 < row["found_ci"][1]
    assert row["place_rms_m"] == pytest.approx(0.0005)
    assert row["depth_rms_m"] == pytest.approx(0.0002)
    assert (row["holds_x_share"], row["holds_depth_share"]) == (1.0, 0.0)
    assert row["noticed_share"] == pytest.approx(1 / 7)
    assert (row["seconds_median"], row["seconds_none"], row["seconds_bead"]) == (60.0, 60.0, 60.0)
    assert math.isnan(summarise_searches([EMPTY])["place_rms_m"])


def test_errors_are_shown_by_depth() -> None:
    (row,) = depth_rows("greedy", [EMPTY, FOUND, AWAY])
    assert (row["from_m"], row["to_m"], row["beads"], row["found_share"]) == (0.003, 0.005, 2, 0.5)


def test_cases_are_told_apart_by_name_and_never_looked_at_before() -> None:
    names = [case.name for case in (*POLICIES, *RINGS, *DIFFERENCES)]
    assert len(names) == len(set(names))
    assert FIRST > 999


def test_a_phantom_has_what_its_case_adds() -> None:
    case = SearchCase("bead", prior=PlanePrior(shares=(0.0, 1.0)))
    plain, shifted = case.phantom(7), replace(case, shift={"modulus": 0.3}, radius_m=0.005).phantom(7)
    assert shifted.modulus == pytest.approx(plain.modulus + 0.3)
    assert replace(shifted.beads[0], radius_m=0.0075) == plain.beads[0]


def test_a_rig_sweeps_the_bins_of_a_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    bead = PlaneBead(x_m=0.0, y_m=0.0, depth_m=0.004)
    monkeypatch.setattr(SearchCase, "phantom", lambda *_: PlanePhantom(beads=(bead,)))
    settings = SearchParams().settings()
    world = replace(LAB, texture_sd_n_m=0.0, static_friction_excess=0.0)
    rig = SearchRig(SearchCase("one", world=world), 3, settings)
    there, back = (rig.sweep(Lane(0.0, forward)) for forward in (True, False))
    assert there.shape == (settings.bins,)
    np.testing.assert_allclose(back, -there, atol=0.3e-3)  # but for the zero: the ring stays landed
    assert there.max() - np.median(there) > 2e-3
    assert settings.bins_m[int(np.argmax(there))] > 0.005  # the tip lags


def test_the_peer_finds_a_bead_and_says_none() -> None:
    level = answers()
    for beads in (np.array([[0.003, -0.002, 0.003]]), np.zeros((0, 3))):
        peer = GaussianMap(SETTINGS, level)
        made = Searcher(SETTINGS, [level]).level_of(0.016, None)
        rng = np.random.default_rng(5)
        while (lane := peer.next_lane()) is not None:
            peer.read(lane, torque(made, lane, beads, np.zeros(6), rng))
        found = peer.outcome()
        assert found.verdict == ("bead" if len(beads) else "none")
        if len(beads):
            assert np.linalg.norm(found.beads[0].mean[:2] - beads[0, :2]) < 4e-3


def test_the_study_writes_every_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_study, "search", lambda case, number: FOUND if number % 2 else EMPTY)
    page = search_study.run(tmp_path, quick=True)
    report = json.loads((tmp_path / "search.json").read_text("utf-8"))
    assert [row["case"] for row in report["policies"]] == [case.name for case in POLICIES]
    assert len(report["differences"]) == len(DIFFERENCES)
    assert (tmp_path / "search_rings.csv").exists()
    assert "Is it worth changing the stiffness?" in page.read_text("utf-8")


@pytest.mark.nightly
def test_searches_find_beads_and_say_none() -> None:
    """On phantoms that were looked at: a whole search, not its figures."""
    ended = [search(POLICIES[0], number) for number in range(1, 13)]
    row = summarise_searches(ended)
    assert row["found"] == row["beads"] > 4
    assert row["false_alarms"] == 0
    assert row["seconds_p90"] < 110.0
