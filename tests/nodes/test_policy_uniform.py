"""The uniform policy: every ring position as often, whatever was felt."""

from __future__ import annotations

from collections import Counter

import pytest

from msgs.experiment import Trial
from nodes.policy_uniform import Uniform
from palp_core import Bench


def first_rings_m(**params: object) -> list[float]:
    bench = Bench(Uniform, params, seed=2)
    for number in range(1000):
        bench.feed(
            Uniform.trial,
            Trial(
                stamp_ns=0,
                trial=number,
                number=1,
                phase="estimation",
                code="",
                label_known=False,
                depth_m=0.0,
            ),
        )
    return [command.ring_m for command in bench.sent(Uniform.command)]


def test_every_position_comes_as_often() -> None:
    counts = Counter(first_rings_m())
    assert sorted(counts) == [0.0, 0.004, 0.008, 0.012, 0.016]
    assert all(count == pytest.approx(200, abs=55) for count in counts.values())


def test_only_the_positions_named_are_used() -> None:
    assert set(first_rings_m(rings_mm=[8.0, 12.0, 16.0])) == {0.008, 0.012, 0.016}
