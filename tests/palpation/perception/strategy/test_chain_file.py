import json
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.strategy import figure5
from palp_core.palpation.perception.strategy.chain_file import (
    Chain,
    ChainFile,
    markov_policy,
    read_chains,
    write_chains,
)

RAGGED: dict[str, object] = {"depth_m": None, "counts": [], "mean_level": 0.3, "sd_level": 0.1}


def chain(matrix: np.ndarray, depth_m: float | None = None) -> Chain:
    rows = matrix.tolist()
    return Chain(depth_m=depth_m, matrix=rows, counts=rows, mean_level=0.28, sd_level=0.07)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "chain.json"
    by_depth = [chain(m, d) for m, d in zip(figure5.matrices(), figure5.DEPTHS_M, strict=True)]
    pooled = chain(figure5.matrices().mean(axis=0))
    write_chains(ChainFile(levels=list(figure5.LEVELS), prior_count=0.5, chains=[pooled, *by_depth]), path)
    return path


def test_what_is_written_is_what_the_policy_follows(file: Path) -> None:
    average = markov_policy(file)
    assert np.array_equal(average.matrices, figure5.matrices().mean(axis=0)[None])
    assert (average.mean_level, average.sd_level) == (0.28, 0.07)
    weighted = markov_policy(file, mixture="posterior", depths_m=figure5.DEPTHS_M[::-1])
    assert np.array_equal(weighted.matrices, figure5.matrices()[::-1])
    assert not list(file.parent.glob("*.part"))


def test_a_depth_that_was_not_learnt_is_named(file: Path) -> None:
    with pytest.raises(PerceptionError, match=r"0\.003"):
        markov_policy(file, mixture="posterior", depths_m=(0.002, 0.003))
    with pytest.raises(PerceptionError, match="posterior"):
        markov_policy(file, mixture="posterior")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"chains": []}, "pooled"),
        ({"levels": [0.1]}, "levels"),
        ({"chains": [RAGGED | {"matrix": [[1.0], [0.0, 1.0]]}]}, "differ"),
        ({"chains": [RAGGED | {"matrix": [[2.0]]}]}, "stochastic"),
        ({"levels": "x"}, "palp emg fit-policy"),
    ],
)
def test_a_damaged_file_says_what_is_wrong_and_where(
    file: Path, change: dict[str, object], match: str
) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(PerceptionError, match=match) as caught:
        read_chains(file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PerceptionError, match=r"none\.json"):
        read_chains(tmp_path / "none.json")
