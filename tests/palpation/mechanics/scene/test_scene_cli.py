"""``palp scene`` and ``palp study`` as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.rig import scene, study
from palp_core.errors import MethodError, PalpError
from palp_core.palpation.studies.summary import pareto_front

TEXT = """
phantom: {bead: {depth_m: 0.004}}
ring_m: [0.004, 0.016]
tolerance: {output: contrast, relative: 0.1}
"""


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "scene.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return str(path)


def test_explain_says_rung_bound_evidence_cost_and_what_was_refused(file: str) -> None:
    result = CliRunner().invoke(scene.app, ["explain", file])
    assert result.exit_code == 0
    for words in ("rung l2", "contrast within 8.5 %", "evidence:", "cost:", "motion:", "but more expensive"):
        assert words in result.output
    told = json.loads(CliRunner().invoke(scene.app, ["explain", file, "--json"]).output)
    assert (told["rung"], told["bound"]) == ("l2", 0.085)
    assert {one["name"] for one in told["candidates"]} >= {"l0", "l2", "l4"}


def test_run_gives_each_ring_with_any_rung_and_refuses_an_unknown_one(file: str) -> None:
    for rung in ("l0", "l2"):
        shown = json.loads(CliRunner().invoke(scene.app, ["run", file, "--rung", rung, "--json"]).stdout)
        assert shown["rung"] == rung
        assert np.shape(shown["angle_rad"]) == (2, len(shown["stage_m"]))
    assert "contrast, N mm" in CliRunner().invoke(scene.app, ["run", file, "--rung", "l2"]).stdout
    refused = CliRunner().invoke(scene.app, ["run", file, "--rung", "l9"]).exception
    assert isinstance(refused, MethodError)
    assert "l4" in str(refused)


def test_studies_are_listed_and_an_unknown_one_is_named(tmp_path: Path) -> None:
    assert "robustness" in CliRunner().invoke(study.app, ["list"]).output
    assert {one["name"] for one in json.loads(CliRunner().invoke(study.app, ["list", "--json"]).output)} >= {
        "paper",
        "robustness",
    }
    result = CliRunner().invoke(study.app, ["run", "contact-magic", "--out", str(tmp_path)])
    assert isinstance(result.exception, PalpError)
    assert "there is no study 'contact-magic'" in str(result.exception)


def test_the_cheapest_points_that_nothing_beats_are_the_front() -> None:
    nan = float("nan")
    assert pareto_front([1.0, 2.0, 3.0, 0.5, nan, 0.1], [0.5, 0.6, 0.1, 0.9, 0.0, nan]) == [3, 0, 2]
