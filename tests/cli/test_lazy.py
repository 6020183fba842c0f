"""The table of verbs: what the help says is what the functions say, and asking for help imports nothing."""

from __future__ import annotations

import importlib
import inspect
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from palp_core import __version__
from palp_core.cli.lazy import LazyGroup, Verb, load
from palp_core.cli.main import app
from palp_core.cli.plain_values import PlainValues


def verbs(group: typer.Typer, path: str = "") -> Iterator[tuple[str, Verb]]:
    cls = group.info.cls
    assert isinstance(cls, type)
    assert issubclass(cls, LazyGroup)
    for name, verb in cls.verbs.items():
        yield f"{path} {name}".strip(), verb
        target = target_of(verb)
        if isinstance(target, typer.Typer) and isinstance(target.info.cls, type):
            yield from verbs(target, f"{path} {name}".strip())


def target_of(verb: Verb) -> object:
    module, _, attribute = verb.target.partition(":")
    return getattr(importlib.import_module(module), attribute)


@pytest.mark.parametrize(("path", "verb"), list(verbs(app)))
def test_the_help_of_a_verb_is_what_it_says_itself(path: str, verb: Verb) -> None:
    target = target_of(verb)
    if isinstance(target, typer.Typer):
        assert target.info.help == verb.help
    elif verb.hidden:
        assert "same as" in verb.help
    else:
        said = (inspect.getdoc(target) or "").splitlines()[0]
        assert said.startswith(verb.help.removesuffix(".")), f"palp {path}: {said}"


@pytest.mark.parametrize(("path", "verb"), list(verbs(app)))
def test_every_verb_can_be_loaded_and_has_help(path: str, verb: Verb) -> None:
    command = load(path.rpartition(" ")[2], verb)
    with typer.Context(command) as context:
        assert "Usage:" in command.get_help(context)


def test_the_table_of_the_documentation_has_every_verb() -> None:
    text = (Path(__file__).parents[2] / "docs/command_line.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `palp ?(\w*)` \| `([a-z_ ]+)`", text, flags=re.MULTILINE)
    known: dict[str, set[str]] = {"": set()}
    assert isinstance(app.info.cls, type)
    assert issubclass(app.info.cls, LazyGroup)
    for name, verb in app.info.cls.verbs.items():
        verbs_of = set(getattr(load(name, verb), "commands", ()))
        if verbs_of:
            known[name] = verbs_of
        elif not verb.hidden:
            known[""].add(name)
    assert {group: set(words.split()) for group, words in rows} == known


def taken(way: Any, value: object, param: Any, context: Any) -> object:
    """Return what a value becomes, or the words that refuse it."""
    try:
        return way.coerce(value, param=param, ctx=context)
    except typer.BadParameter as error:
        return str(error)


@pytest.mark.parametrize(("path", "verb"), [(path, verb) for path, verb in verbs(app) if not verb.hidden])
def test_what_is_given_is_taken_as_typer_takes_it(path: str, verb: Verb) -> None:
    command = load(path.rpartition(" ")[2], verb)
    with typer.Context(command) as context:
        for param in command.get_params(context):
            plain, own = param.get_runtime_param(), type(param).get_runtime_param(param)
            assert isinstance(plain, PlainValues)
            assert not isinstance(own, PlainValues)
            many = param.multiple or param.nargs == -1
            for text in (*(param.type_descriptor.choices or ()), "x", "3", "", str(Path.home())):
                given = (text,) if many else text
                assert taken(plain, given, param, context) == taken(own, given, param, context)
            for default in (param.default, None):
                assert taken(plain, default, param, context) == taken(own, default, param, context)


def palp(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "palp_core", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_misspelt_verb_is_status_2_with_the_nearest_name() -> None:
    done = palp("topci")
    assert done.returncode == 2
    assert "Did you mean 'topic'" in done.stderr


def test_a_misspelt_verb_of_a_group_is_status_2_with_the_nearest_name() -> None:
    done = palp("topic", "ehco")
    assert done.returncode == 2
    assert "Did you mean 'echo'" in done.stderr


def test_ros_2_users_find_wtf() -> None:
    assert palp("wtf", "--help").returncode == 0


def test_the_version_is_told() -> None:
    done = palp("--version")
    assert (done.returncode, done.stdout) == (0, f"palp {__version__}\n")


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
def test_a_full_disk_is_said_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").touch()
    command = [sys.executable, "-m", "palp_core", "bag", "list", str(tmp_path)]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "the output cannot be written: No space left on device\n")
