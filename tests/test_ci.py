"""``.ci/run`` on a machine of which every program is made up: what it calls, and whose failure fails it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

CI = Path(__file__).resolve().parents[1] / ".ci"
REAL = ("bash", "dirname", "env", "mktemp", "cat")
CHECKS = ("ruff", "lint-imports", "mypy", "pytest")


def run(folder: Path, failing: str = "", found: str = "", user: int = 0) -> tuple[int, list[str], str]:
    """Run the script with made-up programs; return its status, what it called, and what it said."""
    calls, path, venv = folder / "calls", folder / "bin", folder / ".venv" / "bin"
    for place in (path, venv, folder / ".ci"):
        place.mkdir(parents=True)
    for name in REAL:
        (path / name).symlink_to(str(shutil.which(name)))
    for program in (
        path / "python3",
        path / "apt-get",
        path / (found or "sudo"),
        *map(venv.joinpath, CHECKS),
        venv / "pip",
    ):
        status = 1 if program.name == failing else 0
        program.write_text(
            f'#!/usr/bin/env bash\necho "{program.name} $*" >>{calls}\nexit {status}\n', encoding="utf-8"
        )
        program.chmod(0o755)
    (path / "id").write_text(f"#!/usr/bin/env bash\necho {user}\n", encoding="utf-8")
    (path / "id").chmod(0o755)
    for script in ("run", "install_chromium"):
        shutil.copy(CI / script, folder / ".ci" / script)
    done = subprocess.run(
        [folder / ".ci" / "run"], env={"PATH": str(path)}, capture_output=True, text=True, check=False
    )
    return done.returncode, calls.read_text(encoding="utf-8").splitlines(), done.stderr


@pytest.mark.parametrize("failing", ["", *CHECKS])
def test_each_check_that_fails_fails_the_run(failing: str, tmp_path: Path) -> None:
    status, calls, _ = run(tmp_path, failing, found="chromium")
    assert (status != 0) == (failing != "")
    assert failing in {"", "ruff", "lint-imports"} or {name.split()[0] for name in calls} >= set(CHECKS)
    assert not any(call.startswith("apt-get") for call in calls)


@pytest.mark.parametrize(("user", "installer"), [(0, "apt-get"), (1000, "sudo")])
@pytest.mark.parametrize("may", [True, False])
def test_chromium_is_installed_by_one_who_may_and_is_not_needed(
    user: int, installer: str, may: bool, tmp_path: Path
) -> None:
    status, calls, errors = run(tmp_path, "" if may else installer, user=user)
    assert status == 0
    assert any(call.startswith(installer) for call in calls)
    assert ("tests in a browser are skipped" in errors) != may
    assert "pytest " in calls
