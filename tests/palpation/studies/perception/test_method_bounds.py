"""What the methods of perception state is what they keep, on sessions simulated here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from palp_core.methods import names
from palp_core.methods.measured import measure_of
from palp_core.palpation.mechanics import Scene, run_scene
from palp_core.palpation.studies.catalogue import study
from palp_core.palpation.studies.perception import beliefs, signals
from palp_core.palpation.studies.perception.case import Seen
from palp_core.palpation.studies.perception.study import PARTS
from palp_core.palpation.studies.simulation.reading_table import Gel


@pytest.mark.parametrize("part", [signals.seen, beliefs.likelihoods_seen], ids=lambda part: part.__name__)
def test_bounds_are_kept_in_the_published_session(part: Callable[..., list[Seen]]) -> None:
    kept(part(quick=True))


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)
def test_bounds_are_kept_wherever_they_say_something(part: Callable[..., list[Seen]]) -> None:
    kept(part())


def kept(rows: Sequence[Seen]) -> None:
    stated = [one for one in rows if one.bound is not None]
    assert {one.method for one in stated} >= {one.method for one in rows}
    broken = [(one.task, one.method, one.condition, one.error, one.bound) for one in stated if not one.kept]
    assert not broken


def test_an_error_beyond_its_bound_is_seen() -> None:
    one = signals.seen(quick=True)[0]
    assert one.bound is not None
    assert not replace(one, error=2.0 * one.bound).kept
    elsewhere = replace(one, quantities={**one.quantities, "modulus_pa": 1e6})
    assert elsewhere.bound is None
    assert elsewhere.kept


@pytest.mark.slow
def test_the_latent_filter_is_calibrated_where_the_papers_is_not() -> None:
    found = {one.method: one.error for one in beliefs.filters_seen(quick=True)}
    assert found["naive"] > 3.0 * found["latent"]
    assert found["latent"] < 0.05


def test_sweeps_have_the_truth_of_their_own() -> None:
    gel = Gel()
    sweeps = signals.clean_sweeps((0.016,), gel)
    peaks = [
        run_scene(Scene(ring_m=(0.016,)).with_bead(depth_m), "l2").peak_n_m[0] for depth_m in gel.depths_m
    ]
    assert [one.truth_n_m["peak"] for one in sweeps] == pytest.approx(peaks, rel=1e-3)
    assert all(gap > 0.0 for one in sweeps for gap in one.gap_n_m.values())


def test_the_study_writes_its_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palp_core.palpation.studies.perception.study.PARTS", PARTS[:1])
    page = study("method-bounds").run(tmp_path, quick=True)
    table = (page.parent / "method_bounds.csv").read_text(encoding="utf-8").splitlines()
    assert table[0] == "task,method,output,session,error,bound,kept"
    assert "yes" in table[1] or "no" in table[1]
    assert "0 are beyond it" in page.read_text(encoding="utf-8").replace("\n", " ")


@pytest.mark.slow
def test_a_stop_rule_is_measured_in_seconds_on_the_rig_too() -> None:
    (measure,) = measure_of("stop")
    seconds = {one.method: one.error for one in measure(Scene()) if one.output == "rig_s"}
    assert set(seconds) == set(names("stop"))
    assert seconds["fixed_number"] > seconds["paper"] > 8.0
