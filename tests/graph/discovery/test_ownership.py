"""What another user puts where runs are looked for is passed over or refused; a run's files are its own."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from palp_core.cli.host import examine_runs
from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import RunDirectory, running, runs
from palp_core.user_folders import folder_mistake, own_folder
from tests.support.fake_graph import FakeGraph
from tests.support.palp import CHAIN, Palp, wait_for_line

STRANGER = 4_000_000
READERS: tuple[tuple[str, ...], ...] = (
    ("node", "list"),
    ("safety", "status"),
    ("stop",),
    ("topic", "list"),
    ("param", "set", "source", "index", "1"),
    ("logs",),
    ("doctor",),
)


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch, palp: Palp) -> Path:
    """Where the runs of this user are."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    return palp.runtime_dir / "palp"


@pytest.fixture
def forged(base: Path, tmp_path: Path) -> Iterator[Path]:
    """A run with all that makes it live: a record, sockets that answer, and the lock."""
    graph = FakeGraph(tmp_path)
    graph.announce(graph.node("source", depth=1))
    yield graph.directory.path
    graph.close()


def given_away(folder: Path) -> None:
    """Let a folder be a stranger's, who can do with it what he likes."""
    if os.getuid() != 0:
        pytest.skip("only root can give a folder away")
    os.chown(folder, STRANGER, STRANGER)


def linked(folder: Path) -> None:
    """Let a folder be a link to where it was."""
    elsewhere = Path(os.environ["XDG_RUNTIME_DIR"], "elsewhere")
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)


def opened(folder: Path) -> None:
    """Let a folder be one that all can write to."""
    folder.chmod(0o777)


DEEDS = [given_away, linked, opened]


@pytest.mark.parametrize("deed", DEEDS)
def test_no_verb_reads_from_a_folder_of_runs_that_another_can_write_to(
    palp: Palp, base: Path, forged: Path, deed: Callable[[Path], None]
) -> None:
    deed(base)
    with pytest.raises(GraphError, match="set XDG_RUNTIME_DIR to a folder of your own"):
        running()
    for words in READERS:
        done = palp.refused(*words)
        assert str(base) in done, words
        assert "set XDG_RUNTIME_DIR to a folder of your own" in done, words


@pytest.mark.parametrize("deed", DEEDS)
def test_a_run_that_another_can_write_to_is_passed_over_and_the_doctor_says_so(
    palp: Palp, base: Path, forged: Path, deed: Callable[[Path], None]
) -> None:
    assert [record.graph for record in running()] == ["fake"]
    deed(forged)
    assert runs() == []
    for words in READERS[:-1]:
        done = palp.here(*words)
        assert (done.returncode, done.stdout) == (2, ""), words
    said = [finding.text for finding in examine_runs() if finding.level == "warn"]
    assert len(said) == 1
    assert str(forged) in said[0]
    assert said[0].endswith("it is passed over")


def test_a_record_that_is_a_link_is_not_read(base: Path, forged: Path, tmp_path: Path) -> None:
    shutil.copy(forged / "graph.json", tmp_path / "graph.json")
    (forged / "graph.json").unlink()
    (forged / "graph.json").symlink_to(tmp_path / "graph.json")
    assert runs() == []


def test_a_launch_shuts_its_users_folder_and_refuses_a_strangers(base: Path) -> None:
    base.mkdir()
    base.chmod(0o777)
    RunDirectory("a").remove()
    assert stat.S_IMODE(base.stat().st_mode) == 0o700
    given_away(base)
    with pytest.raises(
        GraphError, match=f"palp is not a folder of this user but of user {STRANGER}; set XDG"
    ):
        RunDirectory("a")


def test_a_folder_is_made_for_its_user_alone(tmp_path: Path) -> None:
    assert own_folder(tmp_path / "new") is None
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700
    (tmp_path / "link").symlink_to(tmp_path / "new")
    assert (
        own_folder(tmp_path / "link") == f"{tmp_path}/link is not a folder of this user but a symbolic link"
    )
    (tmp_path / "file").touch()
    assert folder_mistake(tmp_path / "file") == f"{tmp_path}/file is not a folder of this user but a file"


def test_all_that_a_run_leaves_in_its_folder_is_its_users_alone(
    base: Path, palp: Palp, tmp_path: Path
) -> None:
    words = (
        "launch",
        CHAIN,
        "clock:=wall",
        "count:=100000",
        f"out:={tmp_path}/out",
        "--listen",
        "tcp://127.0.0.1:0",
    )
    process = subprocess.Popen(
        ["sh", "-c", 'umask 0; exec "$@"', "sh", *palp.command(*words, "--record", tmp_path / "bag")],
        env=palp.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        wait_for_line(process, "blocks")
        assert palp.run("topic", "echo", "/relay/amplified", "-n", "5").returncode == 0
        found = {path: path.lstat().st_mode for path in base.rglob("*")}
        process.terminate()
    sockets = [path.name for path, mode in found.items() if stat.S_ISSOCK(mode)]
    assert {"graph.srv", "relay.pub", "relay.srv", "supervisor.sock"} <= set(sockets)
    assert "relay.readers" in {path.name for path in found}
    assert {path.name for path, mode in found.items() if mode & 0o077} == set()
