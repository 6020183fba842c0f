"""The paper's question by other readings: sessions of the frontier, side by side."""

from dataclasses import replace

import pytest

from palp_core.palpation.studies.frontier.schemes import Scheme
from palp_core.palpation.studies.paper import readings
from palp_core.palpation.studies.paper.readings import (
    WORLDS,
    ReadingSize,
    by_readings,
    gathered,
    side_by_side,
)
from palp_core.palpation.studies.simulation.gel import Gel
from palp_core.palpation.studies.toolkit.parallel import Runner
from tests.palpation.studies.paper.made_readings import made_session

FIXED, HUMAN = (Scheme("contrast", policy, "threshold") for policy in ("fixed_best", "markov"))


def test_lines_are_by_reading_rule_and_cycle_and_compare_the_human_with_the_best_fixed() -> None:
    lines = side_by_side("paper", [made_session(0), made_session(1)])
    assert [(one["reading"], one["rule"], one["protocol"]) for one in lines] == [
        ("peak", "paper", "paper"),
        ("peak", "threshold", "paper"),
        ("contrast", "paper", "paper"),
        ("contrast", "threshold", "paper"),
        ("trace", "paper", "paper"),
        ("trace", "threshold", "paper"),
        ("trace", "threshold", "swift"),
    ]
    for one in lines:
        assert set(one["policies"]) == {"fixed_best", "uniform", "markov", "information_gain"}
        human, fixed = (one["policies"][name]["accuracy"] for name in ("markov", "fixed_best"))
        assert one["human_less_fixed"]["difference"] == pytest.approx(human - fixed)
    assert lines[0]["human_less_fixed"]["difference"] == pytest.approx(-0.2)
    assert lines[3]["human_less_fixed"]["difference"] == 0.0


def test_what_varying_is_worth_needs_both_policies() -> None:
    fixed = [{FIXED.name: made_session(number)[FIXED.name]} for number in (0, 1)]
    places = {name: side_by_side(name, fixed) for name in WORLDS}
    assert gathered(places, [], sessions=2, depth_sessions=0)["worth"] == []


@pytest.mark.slow
def test_the_sessions_are_the_frontiers_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a small world: the first sessions of a longer run are those of a shorter one."""
    small = replace(WORLDS["paper"], gel=Gel(rings_m=(0.0, 0.004, 0.008, 0.012, 0.016)))
    monkeypatch.setattr(readings, "WORLDS", {"paper": small})
    size = ReadingSize(1, 0, trials=4, scenes=False, schemes=(FIXED, HUMAN))
    found = by_readings(size, Runner())
    assert list(found["places"]) == ["paper"]
    (line,) = found["places"]["paper"]
    assert found["worth"] == [{"world": "paper", "reading": "contrast", **line["human_less_fixed"]}]
    assert line["policies"]["fixed_best"]["accuracy"] == 1.0
    assert not by_readings(replace(size, sessions=0), Runner())


@pytest.mark.slow
def test_the_scenes_and_31_depths_are_run_by_every_reading() -> None:
    schemes = (FIXED, Scheme("peak", "fixed_best", "threshold"), Scheme("trace", "fixed_best", "threshold"))
    found = by_readings(ReadingSize(2, 1, trials=30, schemes=schemes), Runner())
    assert set(found["places"]) == {"paper", "lab", "easy", "noisy", "unknown_height", "noisy_re_homed"}
    by_contrast = {
        name: line["policies"]["fixed_best"]["accuracy"]
        for name, lines in found["places"].items()
        for line in lines
        if line["reading"] == "contrast"
    }
    assert by_contrast["unknown_height"] == 1.0  # the height cancels
    error = {(one["world"], one["reading"], one["sweeps"]): one["rmse_m"] for one in found["depths"]}
    assert {world for world, _, _ in error} == {"paper", "lab"}
    assert max(error["paper", "contrast", 1], error["paper", "trace", 1]) < 0.6 * error["paper", "peak", 1]
