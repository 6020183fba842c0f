"""A graph opens the files that its nodes need, or says how many it must be allowed."""

from __future__ import annotations

import resource
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from palp_core.errors import GraphError
from palp_core.graph.supervision.fork_server import ForkServer
from tests.support.palp import CHAIN, PATIENCE_S, Palp

HARD = resource.getrlimit(resource.RLIMIT_NOFILE)[1]


def launched(palp: Palp, soft: int, hard: int) -> subprocess.CompletedProcess[str]:
    """Launch the chain where so many open files are allowed."""
    limits = f"resource.setrlimit(resource.RLIMIT_NOFILE, ({soft}, {hard}))"
    command = palp.command("launch", CHAIN, "count:=20", "rate_hz:=200.0")
    return subprocess.run(
        [sys.executable, "-c", f"import os, resource; {limits}; os.execv({command[0]!r}, {command!r})"],
        env=palp.environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip


def test_the_soft_limit_is_raised_as_far_as_the_nodes_need(palp: Palp) -> None:
    done = launched(palp, 21, HARD)  # the launcher of three nodes has more open
    assert done.returncode == 0, done.stderr


def test_a_hard_limit_that_is_too_low_is_told_with_the_number_needed(palp: Palp) -> None:
    done = launched(palp, 100, 100)
    assert done.returncode != 0
    assert "3 nodes need 206 open files in one process; 100 are allowed here" in done.stderr
    assert palp.all_gone()


def test_every_node_counts() -> None:
    with subprocess.Popen(["sleep", "60"]) as process:
        try:
            server: Any = SimpleNamespace(pid=process.pid)
            ForkServer.make_room(server, 900)
            assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE)[0] >= 2000
            if HARD != resource.RLIM_INFINITY:
                with pytest.raises(GraphError, match=f"need {200 + 2 * HARD} open files"):
                    ForkServer.make_room(server, HARD)
        finally:
            process.kill()
