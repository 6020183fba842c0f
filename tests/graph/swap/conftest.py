"""Running graphs whose middle node is swapped."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.palp import Palp
from tests.support.stage import SLOW, SharedStage, Stage
from tests.support.swapping import workspace


@pytest.fixture
def launch(tmp_path: Path) -> Path:
    return workspace(tmp_path) / "wall.yaml"


@pytest.fixture
def own_stage(palp: Palp, launch: Path) -> Stage:
    """For a test that does not leave its graph whole."""
    return Stage(palp, launch, *SLOW)


@pytest.fixture(scope="module")
def shared_stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedStage]:
    with contextlib.closing(SharedStage(tmp_path_factory.mktemp("stage"))) as shared:
        yield shared


@pytest.fixture
def stage_palp(shared_stage: SharedStage) -> Palp:
    """The command line that has started the stage."""
    shared_stage.renew()
    return shared_stage.stage.palp


@pytest.fixture
def stage(shared_stage: SharedStage, stage_palp: Palp) -> Stage:
    """For a test that leaves the graph whole: it is as at its start."""
    return shared_stage.stage
