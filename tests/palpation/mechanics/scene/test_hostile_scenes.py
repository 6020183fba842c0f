"""A thousand scenes that nobody should ask for: a valid answer or an error by name, never garbage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from palp_core.errors import MechanicsError, MethodError
from palp_core.palpation.mechanics import Scene, read_scene, run_scene
from palp_core.palpation.mechanics.scene.choice import choose_rung
from palp_core.palpation.studies.contact.scenes import hostile_numbers

CLOSED_FORM = ("l0", "l1", "l2")
EVERY_RUNG = (*CLOSED_FORM, "l3", "l4", "l5")


def read(rng: np.random.Generator, file: Path) -> Scene | None:
    """Return a hostile scene; None where its file was refused by name."""
    file.write_text(yaml.safe_dump(hostile_numbers(rng)), encoding="utf-8")
    try:
        return read_scene(file)
    except MechanicsError as error:
        assert str(error).startswith(f"{file}:")  # noqa: PT017 -- either is an answer
        return None


def answered(scene: Scene, rung: str | None) -> bool:
    """Run a scene: what comes is a valid answer, or an error that says something."""
    try:
        done = run_scene(scene, rung)
    except (MechanicsError, MethodError) as error:
        assert str(error)  # noqa: PT017 -- an error by name is an answer
        return False
    for one in done.sweeps:
        assert np.isfinite([one.torque_n_m, one.angle_rad, one.normal_n, one.lateral_n]).all()
        assert np.all(one.normal_n >= 0.0)
        assert np.all(np.abs(one.angle_rad) <= np.pi / 2.0)
    assert np.isfinite([*done.peak_n_m, *done.contrast_n_m]).all()
    return True


@pytest.mark.parametrize("part", range(10))
def test_a_hostile_scene_gets_a_valid_answer_or_an_error_by_name(part: int, tmp_path: Path) -> None:
    rng, count = np.random.default_rng(part), 0
    for _ in range(100):
        scene = read(rng, tmp_path / "scene.yaml")
        if scene is None:
            continue
        try:
            choice = choose_rung(scene)
            assert choice.bound is not None
            assert choice.bound <= scene.tolerance.relative
        except MethodError as error:
            assert "vouches" in str(error) or "only" in str(error)  # noqa: PT017 -- either is an answer
        count += answered(scene, str(rng.choice(CLOSED_FORM)))
    assert count > 0


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_any_rung_gives_a_hostile_scene_a_valid_answer_or_an_error_by_name(part: int, tmp_path: Path) -> None:
    """As above with any rung of the ladder, or the one that the scene itself picks."""
    rng, count = np.random.default_rng([100, part]), 0
    for _ in range(100):
        scene = read(rng, tmp_path / "scene.yaml")
        if scene is not None:
            rung = str(rng.choice(["", *EVERY_RUNG]))
            count += answered(scene, rung or None)
    assert count > 0
