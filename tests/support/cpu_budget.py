"""CPU seconds of every test, with its processes: a test over the limit fails, a folder over its budget is named.

CPU time and not wall time: a machine that others use makes a test wait, not compute. What a fixture of a module or
of the session takes counts for its folder, not for the test that happens to come first.
"""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
LIMIT_S = 3.0
"""What a default test may take, unless it carries ``@pytest.mark.dear("reason")``."""


def cpu_s() -> float:
    """Return the CPU seconds of this process, of the children it has waited for, and of those that live."""
    ended = os.times()
    return time.process_time() + ended.children_user + ended.children_system + _living_s("self")


def _living_s(process: str) -> float:
    """Return what the living descendants of a process have taken, with the children they have waited for."""
    total = 0.0
    try:
        for thread in Path(f"/proc/{process}/task").iterdir():
            for child in (thread / "children").read_text().split():
                stat = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
                total += sum(map(int, stat[11:15])) / TICKS_PER_S + _living_s(child)
    except (FileNotFoundError, ProcessLookupError):  # it has just ended, and counts once it is waited for
        pass
    return total


class CpuBudget:
    """Charges each test with the CPU seconds of its setup and call, and its folder with all that passes."""

    def __init__(self) -> None:
        self._begin_s = self._folder_s = cpu_s()
        self._shared_s, self._in_shared = 0.0, False

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Generator[None, None, None]:
        self._begin_s, self._shared_s = cpu_s(), 0.0
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Generator[None, object, object]:
        if fixturedef.scope == "function" or self._in_shared:
            return (yield)
        self._in_shared, begin_s = True, cpu_s()
        try:
            return (yield)
        finally:
            self._in_shared = False
            self._shared_s += cpu_s() - begin_s

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        now_s = cpu_s()
        if report.when == "call":
            own_s = now_s - self._begin_s - self._shared_s
            report.user_properties.append(("cpu_s", round(own_s, 3)))
        elif report.when == "teardown":
            report.user_properties.append(("folder_cpu_s", round(now_s - self._folder_s, 3)))
            self._folder_s = now_s
        return report
