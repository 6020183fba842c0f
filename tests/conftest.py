"""What every test shares: surroundings that are the same everywhere, and the same examples each time.

Hypothesis tries the same examples in every run, so that a run says something about what was changed. Another
set each time, and more of them, with ``pytest --hypothesis-profile=explore``.
"""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import hypothesis
import pytest

from tests.support.palp import Palp, palp, shared_palp
from tests.support.rig_session import rig_session, shared_folder

__all__ = ["palp", "rig_session", "shared_folder", "shared_palp"]

SLOW_S = 3600.0
"""What a study of minutes may take before it counts as hanging; for the others see ``pyproject.toml``."""

COMMON = hypothesis.settings(
    deadline=None,
    print_blob=True,
    suppress_health_check=[
        hypothesis.HealthCheck.too_slow,  # a busy machine is no failure
        hypothesis.HealthCheck.function_scoped_fixture,  # what an example does to one, the next one may meet
    ],
)
hypothesis.settings.register_profile("ci", COMMON, derandomize=True)
hypothesis.settings.register_profile("explore", COMMON, max_examples=1000)
hypothesis.settings.load_profile("ci")


def pytest_configure() -> None:
    """Make the surroundings the same everywhere: the terminal's width, no colours, Ctrl-C."""
    for name in (
        "PYTEST_ADDOPTS",
        "GITHUB_ACTIONS",
        "FORCE_COLOR",
        "PY_COLORS",
        "CLICOLOR_FORCE",
        "NO_COLOR",
    ):
        os.environ.pop(name, None)
    os.environ["COLUMNS"] = "80"
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # the tests themselves run in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup, what is started here would be deaf to it, too


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give slow tests their time, where pytest-timeout is there to take it."""
    for item in items:
        if (
            item.get_closest_marker("slow") or item.get_closest_marker("nightly")
        ) and item.config.pluginmanager.hasplugin("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Let a failure tell what the graphs of its test have said."""
    report = yield
    if report.failed:
        for one in getattr(item, "funcargs", {}).values():
            if isinstance(one, Palp):
                report.sections.append(("what its graphs printed", one.output()))
    return report


def folder_of_set_ups(config: pytest.Config, otherwise: Path) -> Path:
    """Return the folder of contact set-ups, kept from run to run: ``$PALP_TEST_CACHE``, else beside pytest's.

    An entry's name holds its inputs and its source, and it is written whole or not at all.
    """
    kept = config.rootpath / ".pytest_cache" / "d" / "palp"  # which pytest --cache-clear empties
    if folder := os.environ.get("PALP_TEST_CACHE"):
        return Path(folder)
    return kept if os.access(config.rootpath, os.W_OK) else otherwise


@pytest.fixture(scope="session", autouse=True)
def folders_of_the_session(shared_folder: Path, pytestconfig: pytest.Config) -> Iterator[None]:
    with (
        tempfile.TemporaryDirectory(prefix="palp-", dir="/tmp", ignore_cleanup_errors=True) as runtime,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("PALP_CACHE", str(folder_of_set_ups(pytestconfig, shared_folder / "palp-cache")))
        patch.setenv("XDG_RUNTIME_DIR", runtime)  # pytest's own folders are too long for the paths of sockets
        yield
