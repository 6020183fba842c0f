"""When tests with ROS 2 can run, in which domain, and nodes of ROS 2 by bare rclpy."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zlib
from collections.abc import Mapping

import pytest

from tests.support.palp import PATIENCE_S, ROOT

NEEDS_RCLPY = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        importlib.util.find_spec("rclpy") is None, reason="needs rclpy: pip install --editable '.[dev,ros2]'"
    ),
]


def own_domain() -> dict[str, str]:
    """Return the surroundings of ROS 2 on this host only, in a domain that no other test's worker has."""
    domain = 1 + zlib.crc32(os.environ.get("PYTEST_XDIST_WORKER", str(os.getpid())).encode()) % 100
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def run_node(script: str, environment: Mapping[str, str], *arguments: str) -> str:
    """Run a script of this folder that is a node of ROS 2's own; return what it prints."""
    done = subprocess.run(
        [sys.executable, ROOT / "tests/graph/ros2" / script, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
