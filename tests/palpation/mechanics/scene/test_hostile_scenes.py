"""A thousand absurd scenes: a valid answer or an error by name, never garbage."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from palp_core.errors import MechanicsError, MethodError
from palp_core.palpation.mechanics import Scene, read_scene, run_scene
from palp_core.palpation.mechanics.scene.choice import choose_rung

CLOSED_FORM = ("l0", "l2")
EVERY_RUNG = ("", *CLOSED_FORM, "l4", "l5")
"""The first: what the scene itself picks."""


def hostile_numbers(rng: np.random.Generator) -> dict[str, Any]:
    """Return a scene's content as in its file, some of its numbers absurd."""

    def odd(*usual: float) -> float:
        wild = (0.0, -1.0, 1e-12, 1e12, math.nan, math.inf, -math.inf, 0.5, 1e-3, 0.4999999)
        return float(rng.choice(wild if rng.random() < 0.05 else usual))

    bead: Any = {"radius_m": odd(0.0075, 0.002, 0.012), "depth_m": odd(0.0005, 0.002, 0.004, 0.012, 0.028)}
    return {
        "phantom": {
            "modulus_pa": odd(20e3, 1.0, 1e-3, 1e9),
            "poisson": odd(0.49, 0.3, 0.4999, 0.499999, 0.5, 0.0),
            "height_m": odd(0.030, 0.030, 0.060, 0.015),
            "bead": "none" if rng.random() < 0.2 else bead,
        },
        "probe": {
            "tip_radius_m": odd(0.006, 0.002, 0.012, 0.0699),
            "friction": odd(0.3, 0.0, 0.01, 5.0),
            "tip_mass_kg": odd(0.008, 0.0, 10.0),
        },
        "path": {
            "indentation_m": odd(0.004, 0.0, -0.001, 0.0019, 0.0059, 0.02),
            "speed_m_s": odd(0.02, 1e-6, 5.0),
            "from_m": odd(-0.03, 0.05, -1e-6),
            "to_m": odd(0.05, -0.03, 1e-6),
        },
        "ring_m": [odd(0.0, 0.004, 0.016, 1e-9, -0.0003), odd(0.0, 0.016)],
        "tolerance": {
            "output": str(rng.choice(["peak", "contrast", "separation", "decision"])),
            "relative": odd(0.05, 0.5, 1.0),
        },
    }


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


@pytest.mark.parametrize(
    "part", [pytest.param(part, marks=pytest.mark.slow) if part else part for part in range(10)]
)  # one of the fifth hundred is a minute's way of a joint with inertia
def test_a_hostile_scene_gets_a_valid_answer_or_an_error_by_name(part: int, tmp_path: Path) -> None:
    rng, count = np.random.default_rng(part), 0
    for _ in range(100 if part else 40):
        scene = read(rng, tmp_path / "scene.yaml")
        if scene is None:
            continue
        try:
            choice = choose_rung(scene)
            assert choice.bound is not None
            assert choice.bound <= scene.tolerance.relative
        except MethodError as error:
            assert "no error bound" in str(error) or "only" in str(error)  # noqa: PT017 -- either is an answer
        count += answered(scene, str(rng.choice(CLOSED_FORM if part == 0 else EVERY_RUNG)) or None)
    assert count > 0
