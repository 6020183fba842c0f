"""CPU seconds of every test, with its processes: one over the limit fails.

CPU time and not wall time: a machine that others use makes a test wait, not compute. What a fixture of a
module or of the session takes counts for its folder, not for the test that happens to come first.
"""

from __future__ import annotations

import os
import resource
import time
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import pytest

TICKS_PER_S = os.sysconf("SC_CLK_TCK")
LIMIT_S = 3.0
"""What a default test may take, unless it carries ``@pytest.mark.expensive("reason")``."""

TOLERANCE = 3.0
"""Processes that share caches with others take up to three times what the loop of `slowness` shows."""

NIGHTLY = ("slow", "nightly")
UNLIMITED = ("expensive", *NIGHTLY)
STEPS = 1_000_000
STEPS_S = 0.016
"""What that many turns of an empty loop take on the machine for which the limits were set."""

BUDGETS_S = {
    "tests/rig": 40,
    "tests/palpation/studies": 25,
    "tests/palpation/session": 35,
    "tests/graph/network": 25,
    "tests/cli": 22,
    "tests/palpation/mechanics": 20,
    "tests/view": 21,
    "tests/palpation/live_page": 2,
    "tests/palpation/reporting": 2,
    "tests/graph/swap": 15,
    "tests/graph/process": 5,
    "tests/graph/supervision": 15,
    "tests/graph/launch": 8,
    "tests/graph/recording": 6,
    "tests/graph/replay": 6,
    "tests/graph": 42,
    "tests/nodes": 14,
    "tests/palpation/devices": 10,
    "tests/palpation": 28,
    "": 15,
}
"""CPU seconds by folder, the longest name that fits; the last is everything else."""


def cpu_s() -> float:
    """Return the CPU seconds of this process, of the children it has waited for, and of those that live."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + _living_s("self")


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


def slowness() -> float:
    """Return how many times slower this machine is at present than the one of the limits, at least 1."""
    begin_s = time.process_time()
    for _ in range(STEPS):
        pass
    return max(1.0, (time.process_time() - begin_s) / STEPS_S)


def budget_of(path: str) -> str:
    """Return the folder whose budget a test file counts for."""
    return next(name for name in sorted(BUDGETS_S, key=len, reverse=True) if path.startswith(name))


class CpuMeter:
    """In each worker: charges a test with its setup and call, and its folder with all that passes."""

    def __init__(self) -> None:
        self._counted_s = cpu_s()
        self._shared_s, self._in_shared = 0.0, False
        self._slowness = 1.0

    @pytest.hookimpl(wrapper=True)
    def pytest_runtestloop(self) -> Generator[None, object, object]:
        self._counted_s = cpu_s()  # what collecting took is no folder's
        return (yield)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        self._shared_s = 0.0

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
        if report.when == "setup":
            return report
        now_s = cpu_s()
        if report.when == "call":
            own_s = now_s - self._counted_s - self._shared_s
            report.user_properties.append(("cpu_s", own_s))
            if report.passed and own_s > LIMIT_S and not any(map(item.get_closest_marker, UNLIMITED)):
                self._slowness = max(self._slowness, slowness())  # a machine is not always equally slow
                limit_s = LIMIT_S * TOLERANCE * self._slowness
                if own_s > limit_s:
                    report.outcome = "failed"
                    report.longrepr = (
                        f"{item.nodeid}: took {own_s:.1f} CPU seconds of {limit_s:.1f}; make it cheaper, or "
                        'mark it @pytest.mark.expensive("reason")'
                    )
        else:
            report.user_properties.append(("all_cpu_s", now_s - self._counted_s))
            self._counted_s = now_s
        return report

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if (output := getattr(session.config, "workeroutput", None)) is not None:
            output["cpu_s"] = cpu_s()


class CpuSummary:
    """In the controller: names the folders over budget and, with ``--durations=N``, the N dearest tests."""

    def __init__(self) -> None:
        self._tests: defaultdict[str, float] = defaultdict(float)
        self._folders: defaultdict[str, float] = defaultdict(float)
        self._workers_s = 0.0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, value in report.user_properties:
            if name == "cpu_s" and report.when == "call":
                self._tests[report.nodeid] += float(str(value))
            elif name == "all_cpu_s" and not set(NIGHTLY) & set(report.keywords):
                self._folders[budget_of(report.nodeid)] += float(str(value))

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object, error: object) -> None:
        self._workers_s += getattr(node, "workeroutput", {}).get("cpu_s", 0.0)

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter, config: pytest.Config
    ) -> None:
        all_s = self._workers_s + time.process_time() if self._workers_s else cpu_s()
        slow = slowness()
        terminalreporter.section("CPU seconds")
        terminalreporter.line(
            f"{all_s:.0f} in all, {sum(self._folders.values()):.0f} of them for default tests; "
            f"budgets count {slow:.1f} times on this machine"
        )
        for folder, used_s in _dearest_first(self._folders):
            budget_s = BUDGETS_S[folder] * slow
            if used_s > budget_s:
                name = folder or "all other folders"
                terminalreporter.line(f"{name}: {used_s:.0f} of a budget of {budget_s:.0f}")
        for test, used_s in _dearest_first(self._tests)[: config.getoption("durations") or 0]:
            terminalreporter.line(f"{used_s:8.2f}  {test}")


def _dearest_first(seconds: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(seconds.items(), key=lambda one: -one[1])
