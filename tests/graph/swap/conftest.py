"""A running graph whose middle node is swapped."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.palp import Palp
from tests.support.swapping import Stage, workspace


@pytest.fixture
def launch(tmp_path: Path) -> Path:
    return workspace(tmp_path) / "wall.yaml"


@pytest.fixture
def stage(palp: Palp, launch: Path) -> Stage:
    return Stage(palp, launch)
