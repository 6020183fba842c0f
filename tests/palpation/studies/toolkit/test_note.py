"""A study's folder has the command that makes it again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palp_core.cli.rig.study import app
from palp_core.palpation.studies import catalogue
from palp_core.palpation.studies.catalogue import Study


def run_nothing(out: Path, *, quick: bool = False, workers: int = 1) -> Path:
    return out / "index.html"


def test_a_run_leaves_a_note_that_runs_it_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = Study("stability", "What survives?", f"{__name__}:run_nothing")
    monkeypatch.setattr(catalogue, "study", lambda _: one)
    out = tmp_path / "my run"
    done = CliRunner().invoke(app, ["run", "stability", "--out", str(out), "--quick", "--workers", "2"])
    assert done.exit_code == 0, done.output
    note = json.loads((out / "study.json").read_text("utf-8"))
    assert note["command"] == f"palp study run stability --out '{out}' --quick --workers 2"
    assert note["quick"] is True
    assert len(note["date"].split("-")) == 3
