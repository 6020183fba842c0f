"""The README's first picture: drawn from kept data, which are younger than the methods in them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.errors import PalpError
from palp_core.methods import find
from palp_core.palpation.studies.tradeoff import signature
from palp_core.palpation.studies.tradeoff.panels import is_chosen, too_sure
from palp_core.palpation.studies.tradeoff.signature import COMMAND, DATA, FOLDER, outdated, read_signature

ROOT = Path(__file__).parents[4]
KEPT = ROOT / FOLDER
RESULTS = ROOT / "docs" / "explanation" / "results.md"


def test_a_method_that_changed_is_named_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = {"contact/l2": "aaaa", "policy/fixed": "bbbb", "stop/gone": "cccc"}
    (tmp_path / DATA).write_text(json.dumps({"digests": kept}), encoding="utf-8")
    now = {"contact/l2": "AAAA", "policy/fixed": "bbbb", "filter/new": "dddd"}
    monkeypatch.setattr(signature, "digests", lambda: now)
    rest = f"the README's first picture was measured; run: {COMMAND}"
    assert outdated(tmp_path) == [
        f"contact l2 has changed since {rest}",
        f"filter new is new since {rest}",
        f"stop gone is gone since {rest}",
    ]


def test_the_readme_shows_the_picture_first_and_the_page_of_results_names_its_command() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    first = text.index("![")
    assert text[first:].partition("](")[2].startswith(f"{FOLDER}/signature.png)")
    assert COMMAND in RESULTS.read_text(encoding="utf-8")


def test_it_is_drawn_again_from_what_is_kept(tmp_path: Path, strict_json: Callable[[Path], Any]) -> None:
    strict_json(KEPT / DATA)
    (tmp_path / DATA).write_bytes((KEPT / DATA).read_bytes())
    done = CliRunner().invoke(app, ["methods", "measure", "--signature", "--draw", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert done.stdout == f"{tmp_path / 'signature.png'}\n"
    assert {path.name for path in tmp_path.iterdir()} == {
        DATA,
        "signature.png",
        "signature.svg",
        "signature.csv",
    }
    assert (tmp_path / "signature.csv").read_bytes() == (KEPT / "signature.csv").read_bytes()


def test_each_panel_has_its_points_and_marks() -> None:
    kept = read_signature(KEPT)
    for points in (kept["contact"], kept["rungs"]):
        assert any(one["chosen"] for one in points)
    assert any(one["why_not"] and one["survivor"] for one in kept["contact"])
    assert any(one["unstable"] and one["words"] for one in kept["rungs"])
    assert any(too_sure(one) for one in kept["decisions"])
    assert {one["filter"] for one in kept["decisions"]} == {"naive", "latent"}


def test_the_register_s_names_are_found_among_the_decisions_of_studies() -> None:
    line = {"policy": "reposition_best", "stop": "posterior_threshold", "filter": "latent"}
    chosen = {"policy": "reposition", "stop": "posterior_threshold", "filter": "latent"}
    assert is_chosen(line, chosen)
    assert not is_chosen(line | {"filter": "naive"}, chosen)
    assert not is_chosen(line, chosen | {"policy": "fixed"})
    assert not is_chosen(line, {})
    assert is_chosen(line | {"policy": "fixed_16"}, chosen | {"policy": "fixed"})


def test_the_declared_costs_of_the_contact_rungs_are_the_measured_ones() -> None:
    """Within a factor of two and a half: a set-up is measured once, and caches of machines differ."""
    kept = read_signature(KEPT)
    slowness = kept["machine"]["unit_s"] / kept["machine"]["declared_unit_s"]
    for one in kept["contact"]:
        if one["usual"] and not one["condition"]:
            ratio = one["cost_s"] / slowness / find("contact", one["method"]).cost_s
            assert 0.4 < ratio < 2.5, (one["method"], ratio)


def test_what_the_page_of_results_says_beats_the_rings_is_in_the_data() -> None:
    kept, text = read_signature(KEPT), RESULTS.read_text(encoding="utf-8")
    (ring,) = [one for one in kept["decisions"] if is_chosen(one, kept["chosen"])]
    (once,) = [
        one
        for one in kept["decisions"]
        if (one["policy"], one["stop"], one["filter"]) == (ring["policy"], "fixed_1", ring["filter"])
    ]
    assert once["accuracy"] > ring["accuracy"]
    assert once["seconds"] < ring["seconds"]
    for one in (once, ring):
        assert f"{one['accuracy']:.1%} after {one['seconds']:.1f} s".replace("%", " %") in text
    cpu_s = {one["rung"]: one["cpu_s_per_trial"] for one in kept["rungs"]}
    (chosen,) = [one["rung"] for one in kept["rungs"] if one["chosen"]]
    assert chosen == "l2"
    assert f"takes {cpu_s['l2'] / cpu_s['l4']:.1f} times l4's CPU" in text


def test_there_is_nothing_to_draw_where_nothing_was_measured(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["methods", "measure", "--draw", "--out", str(tmp_path)])
    assert isinstance(done.exception, PalpError)
    assert COMMAND in str(done.exception)
