"""``.ci/run``: Chromium first, then the README's test command; and what is tested without Chromium."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.view import browser

RUN = Path(__file__).resolve().parents[1] / ".ci" / "run"
TOOLS = ("bash", "dirname", "env")


class Machine:
    """A machine with nothing but what is put on it; what is called there is written down."""

    def __init__(self, folder: Path, *programs: str, user: int) -> None:
        self.calls = folder / "calls"
        self.calls.touch()
        self.path = folder / "bin"
        for place in (self.path, folder / ".venv" / "bin", folder / ".ci"):
            place.mkdir(parents=True)
        for name in TOOLS:
            (self.path / name).symlink_to(str(shutil.which(name)))
        for name in ("python3", "apt-get", *programs):
            self.put(self.path / name, f'echo "{name} $*" >> {self.calls}')
        self.put(self.path / "id", f"echo {user}")
        for name in ("pip", "ruff", "mypy", "lint-imports", "pytest"):
            self.put(folder / ".venv" / "bin" / name, f'echo "{name} $PALP_NEEDS_CHROMIUM" >> {self.calls}')
        self.script = folder / ".ci" / "run"
        shutil.copy(RUN, self.script)

    @staticmethod
    def put(path: Path, body: str) -> None:
        path.write_text(f"#!/usr/bin/env bash\n{body}\n", encoding="utf-8")
        path.chmod(0o755)

    def run(self) -> tuple[list[str], str]:
        done = subprocess.run(
            [self.script], env={"PATH": str(self.path)}, capture_output=True, text=True, check=True
        )
        return self.calls.read_text(encoding="utf-8").splitlines(), done.stderr


INSTALL = "install --quiet --yes --no-install-recommends chromium"


def test_chromium_is_installed_where_it_is_missing_and_one_may(tmp_path: Path) -> None:
    calls, errors = Machine(tmp_path, user=0).run()
    assert calls[:2] == ["apt-get update --quiet", f"apt-get {INSTALL}"]
    assert calls[-1] == "pytest 1"
    assert errors == ""


def test_another_user_asks_for_the_right_without_a_password(tmp_path: Path) -> None:
    calls, _ = Machine(tmp_path, "sudo", user=1000).run()
    assert calls[:3] == ["sudo -n true", "sudo -n apt-get update --quiet", f"sudo -n apt-get {INSTALL}"]
    assert calls[-1] == "pytest 1"


def test_who_may_not_is_told_what_to_type_and_the_tests_tell_the_rest(tmp_path: Path) -> None:
    calls, errors = Machine(tmp_path, user=1000).run()
    assert errors.endswith("sudo apt-get install chromium\n")
    assert calls[0].startswith("python3 -m venv")
    assert calls[-1] == "pytest 1"


def test_chromium_that_is_there_is_left_alone(tmp_path: Path) -> None:
    calls, _ = Machine(tmp_path, "chromium", user=0).run()
    assert calls[0].startswith("python3 -m venv")


def test_without_chromium_a_test_is_skipped_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(pytest.skip.Exception, match="needs Chromium: apt-get install chromium"):
        browser.chromium()
