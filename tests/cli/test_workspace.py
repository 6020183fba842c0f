"""``palp init`` and ``palp new``: what they write runs, checks and tests as it is."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.graph.launch import checking
from palp_core.graph.launch.checking import check_file
from tests.graph.workspaces.installed import forgetting
from tests.support.palp import Palp
from tests.support.rig_session import check_here

ADDED = (
    *(("node", "GripForce"), ("message", "grip"), ("policy", "in_turn")),
    *(("driver", f"my_{kind}", "--kind", kind) for kind in ("torque", "emg", "stage", "ring")),
)


def tool(folder: Path, *words: str) -> str:
    """Run a tool of this environment in a folder; return what it says; it must be content."""
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Be in a folder of one's own; what is imported from it is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    with forgetting():
        yield tmp_path


@pytest.fixture
def checked_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at node classes in this process, which has imported already what is heavy."""
    monkeypatch.setattr(checking, "check_file", check_here)


def new(palp: Palp, *words: str) -> None:
    done = palp.here("new", *words)
    assert done.returncode == 0, done.stderr


def test_a_workspace_runs_checks_and_tests_as_it_is_with_all_that_can_be_added(
    at: Path, palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = palp.here("init", "lab")
    assert "look at lab/nodes/average.py first" in text.stdout
    monkeypatch.chdir(at / "lab")
    for words in ADDED:
        new(palp, *words)
    checked = check_file("launch/demo.yaml")
    assert [spec.name for spec in checked.nodes] == ["sensor", "average"]
    assert palp.run("launch", "launch/demo.yaml", "count:=20").returncode == 0
    assert "33 passed" in tool(at / "lab", "pytest", "-q")
    assert "All checks passed!" in tool(at / "lab", "ruff", "check", ".")
    tool(at / "lab", "ruff", "format", "--check", ".")


@pytest.mark.nightly
def test_what_is_written_is_typed(at: Path, palp: Palp, monkeypatch: pytest.MonkeyPatch) -> None:
    palp.here("init", "lab")
    monkeypatch.chdir(at / "lab")
    for words in ADDED:
        new(palp, *words)
    assert "Success" in tool(at / "lab", "mypy")


@pytest.mark.nightly
def test_a_policy_of_ones_own_fits_and_decides_in_the_installed_rig(
    at: Path, palp: Palp, checked_here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    palp.here("init", "lab")
    monkeypatch.chdir(at / "lab")
    new(palp, "policy", "in_turn")
    words = ("launch", "rig:sim.yaml", "trials:=1", "training:=1")
    wrong = palp.here(*words, "policy:=nodes.policy_in_tune:InTurn", "--check")
    assert "did you mean 'nodes.policy_in_turn'?" in wrong.stderr
    done = palp.printed(*words, "policy:=nodes.policy_in_turn:InTurn", "--compose")
    assert "The policy “inturn (nodes.policy_in_turn:InTurn)” found" in done
    assert (at / "lab/results/latest/report.html").is_file()


def test_the_least_workspace_is_two_files_that_run(at: Path, palp: Palp) -> None:
    palp.here("init", "least", "--minimal")
    assert sorted(path.name for path in (at / "least").iterdir()) == ["counter.py", "launch.yaml"]
    assert palp.run("launch", "least/launch.yaml").returncode == 0


def test_the_rig_can_be_copied_and_the_check_says_what_was_changed_in_it(
    at: Path, checked_here: None, palp: Palp
) -> None:
    palp.here("init", "mine", "--rig")
    fixed = at / "mine/nodes/policy_fixed.py"
    assert fixed.is_file()
    assert (at / "mine/launch/parts/experiment.yaml").is_file()
    assert "in place of" not in palp.here("launch", "mine/launch/sim.yaml", "--check").stderr
    fixed.write_text(fixed.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    (line,) = palp.here("launch", "mine/launch/sim.yaml", "--check").stderr.splitlines()
    assert f"nodes.policy_fixed is {fixed}, in place of that of 'rig', " in line


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("init", "full"), "full is not empty (it has a, b, c, ...); name a new folder"),
        (("init", "full/a"), "full/a is a file; name a new folder"),
        (("init", "x", "--rig", "--minimal"), "one or the other"),
        (("new", "node", "grip"), "no workspace here: "),
        (("new", "node", "class"), "'class' is a word of Python"),
        (("new", "node", "9a"), "'9a' is not a name"),
        (("new", "message", "a/b"), "'a/b' is not a name"),
        (("new", "policy", "../x"), "'../x' is not a name"),
    ],
)
def test_what_cannot_be_written_is_refused(at: Path, palp: Palp, words: tuple[str, ...], text: str) -> None:
    (at / "full").mkdir()
    for name in "abcd":
        (at / "full" / name).touch()
    assert text in palp.refused(*words)
    assert sorted(path.name for path in at.iterdir()) == ["full"]


def test_nothing_is_overwritten_and_all_or_nothing_is_written(
    at: Path, palp: Palp, monkeypatch: pytest.MonkeyPatch
) -> None:
    (at / "nodes").mkdir()
    (at / "tests").mkdir()
    (at / "tests/test_grip.py").write_text("# mine\n", encoding="utf-8")
    assert "tests/test_grip.py" in palp.refused("new", "node", "grip")
    assert not (at / "nodes/grip.py").exists()
    assert (at / "tests/test_grip.py").read_text(encoding="utf-8") == "# mine\n"
    hiding = palp.here("new", "node", "policy")
    assert "nodes.policy takes the place of that of 'rig'" in hiding.stderr
    monkeypatch.chdir(at / "nodes")
    assert f"the workspace of this folder is {at}\n" in palp.here("new", "node", "other").stderr


@pytest.mark.parametrize(
    ("words", "test"),
    [
        (("node", "grip"), "checks/nodes/test_grip.py"),
        (("policy", "in_turn"), "checks/nodes/test_policy_in_turn.py"),
        (("driver", "cell", "--kind", "ring"), "checks/test_cell_driver.py"),
        (("message", "grip"), "checks/test_grip_message.py"),
    ],
)
def test_a_test_is_written_where_the_workspace_keeps_its_tests(
    at: Path, palp: Palp, words: tuple[str, ...], test: str
) -> None:
    (at / "nodes").mkdir()
    (at / "checks/nodes").mkdir(parents=True)
    (at / "pyproject.toml").write_text(
        '[tool.pytest.ini_options]\ntestpaths = ["checks"]\n', encoding="utf-8"
    )
    new(palp, *words)
    assert (at / test).is_file()
    assert not (at / "tests").exists()
