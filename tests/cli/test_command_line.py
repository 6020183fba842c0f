"""The verbs that need no graph: check, print, show, draw; what they refuse; help imports nothing."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from palp_core import __version__
from palp_core.cli.launch.launch import log_levels
from palp_core.cli.lazy import LazyGroup, load
from palp_core.cli.main import app, main
from palp_core.errors import GraphError
from tests.support.palp import CHAIN, SIM, Palp
from tests.support.supervised import write_files

COMMANDS: list[tuple[tuple[object, ...], int, tuple[str, ...]]] = [
    (("graph", "args", SIM), 0, ("Arguments (pass arguments as '<name>:=<value>'):", "'policy':")),
    (("graph", "draw", CHAIN), 0, ("flowchart LR",)),
    (("graph", "show", CHAIN, "source.rate_hz:=50.0"), 0, ("rate_hz: 50.0",)),
    (("graph", "show", CHAIN, "source.rate_hz"), 2, ("'source.rate_hz' on the command line is no",)),
    (("graph", "show", CHAIN, "sorce.rate_hz:=1.0"), 2, ("no node 'sorce' on the", "did you mean 'source'?")),
    (("launch", CHAIN, "cuont:=5"), 2, ("no argument 'cuont'", "did you mean 'count'?")),
    (("launch", CHAIN, "--operate"), 2, ("give both",)),
    (("launch", CHAIN, "resume:=true"), 2, ("cannot resume",)),
    (("launch", "gone.yaml", "--check"), 2, ("gone.", "in {here}")),
    (("scene", "explain", "gone.yaml"), 2, ("gone.", "in {here}")),
    (("emg", "analyse", "gone.csv"), 2, ("gone.", "in {here}")),
    (
        ("interface", "show", "Grip"),
        2,
        ("looked in: palp itself, as {here} has no folder msgs and no graph runs", "--workspace DIR"),
    ),
    (("bag", "info", "node.py"), 2, ("node.py: not a bag; give a bag's folder",)),
    (("bag", "info", "torn.mcap"), 2, ("palp bag recover",)),
    (("bag", "play", "gone", "--delay", "nan"), 2, ("--delay", "must be a finite number")),
    (("session", "plan", "--limit-s", "inf"), 2, ("--limit-s", "must be a finite number")),
    (("swap", "relay", "F:N", "--timeout", "nan"), 2, ("--timeout", "must be a finite number")),
]
"""Words, exit status, and what is printed."""


@pytest.mark.parametrize(("words", "status", "texts"), COMMANDS)
def test_a_command_prints_or_is_refused(
    palp: Palp,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[object, ...],
    status: int,
    texts: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "node.py").write_text("x = 1\n", encoding="utf-8")
    (tmp_path / "torn.mcap").write_bytes(b"\0" * 100)
    done = palp.here(*words)
    assert done.returncode == status, done.stderr
    for text in texts:
        assert text.format(here=tmp_path) in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_check_finds_no_mistake_and_starts_nothing(palp: Palp, tmp_path: Path) -> None:
    done = palp.here("launch", SIM, "--check", f"out:={tmp_path / 'out'}")
    assert (done.returncode, "no mistake: 9 nodes" in done.stdout) == (0, True)
    assert not (tmp_path / "out").exists()
    assert palp.all_gone()


def test_a_word_that_is_no_text_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], palp: Palp
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(palp.runtime_dir))
    monkeypatch.setattr(sys, "argv", ["palp", "launch", str(CHAIN), "--check", "out:=\udcff"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "'\\udcff' is not UTF-8 text; write it as such\n"


LOUD = """
import logging
from palp_core import Message, Node, Params, Progress, Pub, every


class LoudParams(Params):
    rate_hz: float = 100.0


class Loud(Node):
    params: LoudParams
    progress = Pub(Progress)

    @every("rate_hz")
    def go(self):
        print("\\x1b[2Jprinted")
        logging.getLogger("loud").warning("\\x1b[2Jlogged")
        self.progress.publish(Progress(stamp_ns=0, phase="\\x1b[2J", done_count=1, total_count=1))
        raise ValueError("\\x1b[2Jraised")
"""


def test_a_nodes_text_commands_no_terminal(palp: Palp, tmp_path: Path) -> None:
    graph = "graph: loud\nclock: sim\nnodes: {loud: {run: 'nodes.loud:Loud'}}\n"
    write_files(tmp_path, {"nodes/loud.py": LOUD, "loud.yaml": graph})
    launched = palp.run("launch", tmp_path / "loud.yaml")
    kept = palp.run("logs", "--graph", "loud")
    text = launched.stdout + launched.stderr + kept.stdout
    assert launched.returncode == 1
    for what in ("printed", "logged", "raised"):
        assert f"\\x1b[2J{what}" in text
    assert not {"\x1b", "\x07", "\x9b"} & {*text}


def test_a_wall_clock_graph_cannot_be_composed(palp: Palp) -> None:
    done = palp.run("launch", CHAIN, "--compose")
    assert done.returncode == 2
    assert "only a graph with 'clock: sim' can be composed" in done.stderr


def test_a_node_has_a_log_level_of_its_own() -> None:
    levels = log_levels(["ERROR", "/policy:=debug"])
    assert (levels.shown("policy"), levels.shown("stage")) == ("debug", "error")
    assert (levels.logged("policy"), levels.logged("stage")) == ("debug", "info")
    with pytest.raises(GraphError, match="--log-level policy:=debg: no level 'debg'; did you mean 'debug'"):
        log_levels(["policy:=debg"])


GOLDEN = Path(__file__).parents[1] / "golden/emg.mcap"
LONGEST_LINE = 60
MOST_AT_TOP = 28


def verbs(group: Any, path: str = "palp") -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        whole = load(name, group.verbs[name]) if isinstance(group, LazyGroup) else command
        yield f"{path} {name}", whole
        if hasattr(whole, "commands"):
            yield from verbs(whole, f"{path} {name}")


def test_every_verb_loads_and_its_line_is_short_and_whole() -> None:
    group = typer.main.get_command(app)
    found = dict(verbs(group))
    assert len(found) > 100
    assert len([path for path in found if path.count(" ") == 1]) <= MOST_AT_TOP
    for path, command in found.items():
        with typer.Context(command, info_name=path) as context:
            text = command.get_help(context)
        line = text.split("\n\n")[1].strip()
        assert text.startswith("Usage:"), path
        assert line == (command.help or "").partition("\n\n")[0], f"{path}: the line is folded or cut off"
        assert line.endswith("."), path
        assert len(line) <= LONGEST_LINE, f"{path}: {line}"
        for parameter in command.params:
            assert len(getattr(parameter, "help", None) or "") <= LONGEST_LINE, f"{path} {parameter.name}"
        listed = getattr(command, "commands", {})
        for name in listed:
            assert re.search(rf"^  {name} +\S.*[^.]\.$", text, flags=re.MULTILINE), f"{path} {name}"


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("topci",), 2, "Did you mean 'topic'"),
        (("topic", "ehco"), 2, "Did you mean 'echo'"),
        (("--version",), 0, f"palp {__version__}\n"),
    ],
)
def test_a_misspelt_verb_gets_the_nearest_name(words: tuple[str, ...], status: int, text: str) -> None:
    done = CliRunner().invoke(app, words)
    assert done.exit_code == status
    assert text in done.output


def test_ctrl_c_before_the_first_verb_is_read_ends_without_a_traceback() -> None:
    program = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'palp_core.cli.main': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from palp_core.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_reported_without_a_traceback() -> None:
    command = [sys.executable, "-m", "palp_core", "bag", "echo", str(GOLDEN), "-n", "1"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "the output cannot be written: No space left on device\n")
