"""The policies that the benchmark compares are those that the launch file takes."""

from __future__ import annotations

import pytest

from benchmarks.policies import LAUNCH, POLICIES
from tests.support.rig_session import check_here


@pytest.mark.parametrize("name", ["fixed_16", "markov"])
def test_a_policy_of_the_benchmark_passes_the_check(name: str) -> None:
    (policy,) = [node for node in check_here(LAUNCH, POLICIES[name]).nodes if node.name == "policy"]
    assert policy.run.startswith(f"nodes.policy_{name.partition('_')[0]}:")
