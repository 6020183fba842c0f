"""The table of verbs: every verb loads, its help is short, and asking for help imports nothing."""

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
from palp_core.cli.lazy import LazyGroup, load
from palp_core.cli.main import app

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
