"""What is not found is said with where it was looked for, and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.palp import Palp


def test_a_type_that_is_not_known_outside_a_workspace_says_where_types_are(
    palp: Palp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = palp.here("interface", "show", "Grip").stderr
    assert f"looked in: palp itself, as {tmp_path} has no folder msgs and no graph runs" in said
    assert "--workspace DIR" in said
    (tmp_path / "msgs").mkdir()
    (tmp_path / "nodes").mkdir()
    assert f"looked in: {tmp_path / 'msgs'}" in palp.here("interface", "show", "Grip").stderr


def test_a_file_that_was_never_a_bag_is_not_to_be_recovered(palp: Palp, tmp_path: Path) -> None:
    (tmp_path / "node.py").write_text("x = 1\n", encoding="utf-8")
    (tmp_path / "torn.mcap").write_bytes(b"\0" * 100)
    other = palp.run("bag", "info", tmp_path / "node.py")
    assert other.returncode == 2
    assert "node.py: no bag, but another kind of file; give a bag's folder" in other.stderr
    assert "recover" not in other.stderr
    assert "palp bag recover" in palp.run("bag", "info", tmp_path / "torn.mcap").stderr


@pytest.mark.parametrize(
    "words",
    [
        ("launch", "gone.yaml", "--check"),
        ("scene", "explain", "gone.yaml"),
        ("emg", "analyse", "gone.csv"),
    ],
)
def test_a_file_that_is_not_there_is_said_with_the_folder_where_it_was_sought(
    palp: Palp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    done = palp.here(*words)
    assert done.returncode == 2
    assert "gone." in done.stderr
    assert f"in {tmp_path}" in done.stderr
