"""A study is its module, its page's template, and its line in the catalogue; its folder has its command."""

from __future__ import annotations

import importlib
import inspect
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palp_core.cli.rig.study import app
from palp_core.errors import PalpError
from palp_core.palpation import reporting
from palp_core.palpation.studies import catalogue
from palp_core.palpation.studies.catalogue import OPTIONS, STUDIES, Study

TEMPLATES = Path(reporting.__file__).parent / "templates" / "studies"


def test_a_study_is_found_from_its_line_of_the_catalogue() -> None:
    for name, one in STUDIES.items():
        module_name, _, function = one.target.partition(":")
        module = importlib.import_module(module_name)
        taken = list(inspect.signature(getattr(module, function)).parameters)
        assert taken[:2] == ["out", "quick"], name
        assert {*taken[2:]} <= {*OPTIONS, "seed"}, name
    assert {path.stem for path in TEMPLATES.glob("*.html")} == set(STUDIES)


def run_nothing(out: Path, *, quick: bool = False, workers: int = 1) -> Path:
    return out / "index.html"


ONE = Study("stability", "What survives?", f"{__name__}:run_nothing")


def test_a_study_refuses_an_option_that_it_cannot_use(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="'stability' does not take --dask; leave it out"):
        ONE.run(tmp_path, dask="tcp://127.0.0.1:1")


def test_a_run_leaves_a_note_that_runs_it_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "study", lambda _: ONE)
    out = tmp_path / "my run"
    done = CliRunner().invoke(app, ["run", "stability", "--out", str(out), "--quick", "--workers", "2"])
    assert done.exit_code == 0, done.output
    note = json.loads((out / "study.json").read_text("utf-8"))
    assert note["command"] == f"palp study run stability --out '{out}' --quick --workers 2"
    assert note["quick"] is True
    assert len(note["date"].split("-")) == 3
