"""What is built holds everything: an installed palp has the rig, and the right name everywhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

import palp_core
from benchmarks.install import first_run, install
from palp_core import extras
from tests.support.palp import PATIENCE_S, ROOT

pytest.importorskip("hatchling", reason="hatchling, which .[dev] installs, builds palp")

PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
TRAVELS = ("nodes", "msgs", "launch")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the sdist of a copy of the repository, and from it the wheel, as an index is given them."""
    folder = tmp_path_factory.mktemp("built")
    ignored = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*_cache", ".hypothesis")
    shutil.copytree(ROOT, folder / "checkout", ignore=ignored, symlinks=True)
    _build(folder / "checkout", folder, "sdist")
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (source,) = (folder / "sdist").iterdir()
    _build(source, folder, "wheel")
    return folder


def _build(source: Path, into: Path, kind: str) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "--target", kind, "--directory", str(into)]
    environment = {**os.environ, "PYTHONPATH": ""}
    subprocess.run(command, cwd=source, env=environment, check=True, capture_output=True)


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel into an environment of its own, which borrows what palp needs; return its commands.

    No network is needed: the packages of this environment are on its path, but not palp itself.
    """
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, symlinks=True)
    (site,) = folder.glob("lib/python*/site-packages")
    borrowed = [path for path in sys.path if path.endswith("-packages")]
    (site / "borrowed.pth").write_text("\n".join(borrowed), encoding="utf-8")
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin/python"), "--disable-pip-version-check"]
    install = [
        *pip,
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        "--no-compile",
        "--ignore-installed",
        str(wheel),
    ]
    subprocess.run(install, check=True, capture_output=True)
    return folder / "bin"


def _outside(bin_: Path, folder: Path, *command: str) -> str:
    """Run a command of the new environment outside the checkout; return what it says."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(bin_ / command[0]), *command[1:]],
        cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.nightly
def test_the_installed_rig_runs_where_there_is_no_checkout(installed: Path, tmp_path: Path) -> None:
    small = ("trials:=1", "training:=1", "rings_mm:=0, 16", "policy:=fixed")
    said = _outside(installed, tmp_path, "palp", "launch", "rig:sim.yaml", *small, "--compose")
    assert "Report: results/" in said
    assert (tmp_path / "results/latest/report.html").is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


@pytest.mark.nightly
def test_an_installed_palp_writes_a_workspace_that_runs_and_derives_from_the_rig(
    installed: Path, tmp_path: Path
) -> None:
    _outside(installed, tmp_path, "palp", "init", "lab")
    lab = tmp_path / "lab"
    _outside(installed, lab, "palp", "launch", "launch/demo.yaml", "count:=20")
    _outside(installed, lab, "palp", "new", "policy", "in_turn")
    assert "no mistake: 9 nodes" in _outside(installed, lab, "palp", "launch", "rig:sim.yaml", "--check")
    assert "5 passed" in _outside(installed, lab, "python", "-m", "pytest", "-q")
    program = (
        "from palp_core.workspace.nodes.policy import PolicyNode\nimport nodes.policy, palp_core\n"
        "from nodes.policy_in_turn import InTurn\n"
        "print(issubclass(InTurn, PolicyNode), nodes.policy.PolicyNode is PolicyNode, palp_core.__file__)"
    )
    same, one, where = _outside(installed, lab, "python", "-c", program).split()
    assert (same, one) == ("True", "True")
    assert Path(where).is_relative_to(installed.parent)


@pytest.mark.nightly
def test_a_clean_environment_without_extras_runs_the_rig(built: Path, tmp_path: Path) -> None:
    """With the network, and nothing borrowed."""
    (wheel,) = built.glob("*.whl")
    (tmp_path / "at").mkdir()
    install(sys.executable, wheel, "", tmp_path / "venv")
    first_run(tmp_path / "venv", tmp_path / "at")
    assert {path.name for path in (tmp_path / "at").iterdir()} == {"results"}


def _python_files(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and p.suffix != ".pyc"}


def test_the_wheel_has_all_of_the_package_and_the_rig_within_it(built: Path) -> None:
    (wheel,) = built.glob("palp_core-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {name.partition("/")[0] for name in names} == {
        "palp_core", f"palp_core-{palp_core.__version__}.dist-info",
    }  # fmt: skip
    assert {f"palp_core/{name}" for name in _python_files(ROOT / "src/palp_core")} <= names
    for folder in TRAVELS:
        assert {f"palp_core/workspace/{folder}/{name}" for name in _python_files(ROOT / folder)} <= names
    assert "palp_core/workspace/tests/golden/session.mcap" in names  # which launch/replay.yaml plays
    assert not [name for name in names if "__pycache__" in name]


def test_the_sdist_has_what_a_reader_and_a_tester_of_the_repository_need(built: Path) -> None:
    (source,) = (built / "sdist").iterdir()
    for folder in ("src", "tests", "docs", "benchmarks", "examples", *TRAVELS):
        assert _python_files(ROOT / folder) - _python_files(source / folder) == set(), folder
    for file in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "conftest.py", ".ci/run"):
        assert (source / file).read_bytes() == (ROOT / file).read_bytes()


def test_the_metadata_is_complete(built: Path) -> None:
    (wheel,) = built.glob("palp_core-*.whl")
    info = f"palp_core-{palp_core.__version__}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        metadata = archive.read(f"{info}/METADATA").decode()
        assert b"MIT License" in archive.read(f"{info}/licenses/LICENSE")
    head, _, page = metadata.partition("\n\n")
    for line in (
        "Name: palp-core", f"Version: {palp_core.__version__}", "License-Expression: MIT",
        "License-File: LICENSE", "Requires-Python: >=3.11", "Description-Content-Type: text/markdown",
        *(f"Classifier: Programming Language :: Python :: {version}" for version in ("3.11", "3.12", "3.13")),
    ):  # fmt: skip
        assert f"\n{line}\n" in f"\n{head}\n"
    assert "# palp" in page
    assert not re.findall(r"\]\((?!https?://|#)", re.sub(r"```.*?```", "", page, flags=re.DOTALL))


def test_a_readmes_links_lead_to_the_repositorys_address_where_it_has_one() -> None:
    spec = spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hooks = module_from_spec(spec)
    spec.loader.exec_module(hooks)
    text = "![Seen](a.png), [page](docs/b.md), [away](https://c) and [below](#d)\n```sh\n[x](y)\n```\n"
    assert hooks.index_page(text, "https://h/blob/", "https://h/raw") == (
        "![Seen](https://h/raw/a.png), [page](https://h/blob/docs/b.md), [away](https://c) and [below](#d)\n"
        "```sh\n[x](y)\n```\n"
    )
    assert hooks.index_page(text, "", "").startswith("*Seen*, page, [away](https://c) and [below](#d)\n")


def test_every_message_and_page_names_what_is_to_be_installed() -> None:
    """``palp`` on the public index is somebody else's package."""
    wrong = re.compile(r"pip install[^\n]*?['\" ]palp(?:\[|['\"\s,;)`]|$)|\bpalp\\?\[[a-z]+\\?\]")
    folders = ("src", *TRAVELS, "docs", "tests", "examples", "benchmarks")
    kinds = {".py", ".md", ".yaml", ".html", ".toml"}
    files = [f for folder in folders for f in (ROOT / folder).rglob("*") if f.suffix in kinds]
    files += [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", ROOT / "pyproject.toml"]
    found = {
        f"{file.relative_to(ROOT)}:{number}: {line.strip()}"
        for file in files
        if file != Path(__file__).resolve()
        for number, line in enumerate(file.read_text("utf-8").splitlines(), 1)
        if wrong.search(line)
    }
    assert found == set()


def test_a_missing_module_is_named_with_the_extra_that_brings_it() -> None:
    of_module = {"foxglove": "foxglove-sdk", "rclpy": "ros-rclpy"}
    for module, extra in extras._EXTRA_OF.items():
        brought = [re.match(r"[\w-]+", one)[0] for one in PROJECT["optional-dependencies"][extra]]  # type: ignore[index]
        assert of_module.get(module, module) in brought
        line = extras.advice(ModuleNotFoundError(name=f"{module}.inner"))
        assert line == f"{module} is not installed; type: {extras.install_line(extra)}"
    assert set(extras._EXTRA_OF.values()) == set(PROJECT["optional-dependencies"]) - {
        "docs",
        "dev",
        "nightly",
    }
    assert extras.advice(ModuleNotFoundError(name="numpy_of_the_lab")) == ""
    assert PROJECT["name"] == extras.DISTRIBUTION


def test_what_others_promise_nothing_about_has_an_upper_bound() -> None:
    """Where palp builds on the inside of another's package, a new version waits until it was tried."""
    from can.interfaces.socketcand import SocketCanDaemonBus
    from typer.core import TyperCommand, TyperGroup

    assert callable(SocketCanDaemonBus.send)
    assert issubclass(TyperGroup, object)
    assert issubclass(TyperCommand, object)
    for name in ("typer", "python-can"):
        (line,) = [one for one in PROJECT["dependencies"] if one.startswith(name)]
        assert re.search(r",<\d", line), line
