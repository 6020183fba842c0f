"""A launch file may be written by an attacker: each is refused at its place, soon, in little memory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.description.yaml_tree import LARGEST_BYTES, MOST_VALUES, parse_tree, read_tree
from palp_core.graph.problems import GraphProblems, Problems
from tests.support.palp import ROOT

HEAD = "graph: a\nclock: sim\n"
NODE = "    run: nodes.torque:TorqueSensor\n"
NODES = f"nodes:\n  one:\n{NODE}"
HUGE = "1" + "0" * 30
LAUGHS = "".join(f"  a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
RESTART = NODES + "    restart: {{when: on_failure, {}}}\n"
WIRE = NODES + "  two:\n    run: nodes.record:Record\n    inputs: {{truth: {{from: one/truth, {}}}}}\n"
MANY = [f"c{i}" for i in range(300)]
BRANCHES = (
    f"args:\n  s: {{default: c0, choices: [{', '.join(MANY)}]}}\nnodes:\n  one:\n"
    + f"    run: {{select: $(var s), {', '.join(f'{c}: nodes.torque:TorqueSensor' for c in MANY)}}}\n"
)

# the text behind HEAD, the place within the file, words of the message
FILES: dict[str, tuple[str, str, str]] = {
    "an alias bomb": (f"x:\n  a0: &a0 [1]\n{LAUGHS}{NODES}", "8:27", f"more than {MOST_VALUES} values"),
    "a long text, repeated": (f"x: [&a {'x' * 60_000}, {'*a, ' * 20}]\n", "3:60046", "an alias repeats"),
    "5,000 brackets": (f"seed: {'[' * 5000}{']' * 5000}\n{NODES}", "3:1006", "maximum nesting depth"),
    "a bell after an accent": (f"seed: é\a\n{NODES}", "3:8", r"character '\x07' is not allowed"),
    "2,000 braces": (f"seed: {'{a: ' * 2000}1{'}' * 2000}\n{NODES}", "3:200", "values lie in each other"),
    "700 indents": ("".join(" " * i + "a:\n" for i in range(700)), "52:50", "values lie in each other"),
    "too long a file": ("#" * LARGEST_BYTES, "1:1", f"more than {LARGEST_BYTES // 1024} KiB"),
    "2**70 as a seed": (f"seed: {2**70}\n{NODES}", "3:7", "at most 64 bits"),
    "5,000 digits": (
        f"seed: {'1' * 5000}\n{NODES}",
        "3:7",
        "...' cannot be read: a whole number has at most",
    ),
    "an octal number of 120 bits": (f"seed: 0o{'7' * 40}\n{NODES}", "3:7", "at most 64 bits"),
    "2**70 as a parameter": (f"{NODES}    params: {{samples: {2**70}}}\n", "6:23", "at most 64 bits"),
    "a default of 10**30": (
        f"args: {{x: {{default: {HUGE}}}}}\n{NODES}    params: {{samples: $(var x)}}\n",
        "3:21",
        "at most 64 bits",
    ),
    "a priority of 10**30": (f"{NODES}    realtime_priority: {HUGE}\n", "6:24", "at most 64 bits"),
    "a seed of infinity": (f"seed: .inf\n{NODES}", "3:7", "must be a whole number"),
    "10**30 restarts": (RESTART.format(f"max_restarts: {HUGE}"), "6:47", "at most 64 bits"),
    "10**18 restarts": (RESTART.format(f"max_restarts: {10**18}"), "6:47", "at most 1,000,000"),
    "a back-off of infinity": (RESTART.format("backoff_s: .inf"), "6:44", "at most 3,600"),
    "a back-off of 1e30": (RESTART.format("backoff_s: 1e30"), "6:44", "at most 3,600"),
    "a depth of 10**30": (WIRE.format(f"depth: {HUGE}"), "8:46", "at most 64 bits"),
    "a depth of 10**18": (WIRE.format(f"depth: {10**18}"), "8:46", "at most 1,000,000"),
    "a deadline of infinity": (WIRE.format("deadline_ms: .inf"), "8:52", "at most 1,000,000,000"),
    "300 branches": (BRANCHES, "5:1", "have 299 branches, more than 200"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_hostile_file_is_refused_once_and_at_its_place(workspace: Any, name: str) -> None:
    text, place, words = FILES[name]
    with pytest.raises(GraphProblems) as caught:
        workspace.load(HEAD + text)
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"{workspace.root}/launch/graph.yaml:{place}: ")
    assert words in problem.message
    assert len(problem.message) < 200


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("seed:=1" + "0" * 30, "(more than 64 bits); it must be a whole number"),
        ("seed:=1e30", "a whole number"),
    ],
)
def test_an_argument_that_fits_no_message_is_refused(workspace: Any, word: str, words: str) -> None:
    text = f"graph: a\nclock: sim\nseed: $(var seed)\nargs: {{seed: {{default: 1}}}}\n{NODES}"
    with pytest.raises(GraphProblems) as caught:
        workspace.load(text, word)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column) == (4, 8)
    assert words in problem.message


def test_files_that_include_ever_more_files_are_refused(workspace: Any) -> None:
    for i in range(8):
        inner = ", ".join([f"{{file: inc{i + 1}.yaml}}"] * 10)
        workspace.write(f"launch/inc{i}.yaml", f"include: [{inner}]\n")
    workspace.write("launch/inc8.yaml", "args: {}\n")
    with pytest.raises(GraphProblems, match="more than 64 files are included") as caught:
        workspace.load(f"{HEAD}include: [{{file: inc0.yaml}}]\n{NODES}")
    assert len(caught.value.problems) == 1


def test_a_launch_file_without_end_is_not_read_to_its_end() -> None:
    with pytest.raises(GraphProblems, match="/dev/zero:1:1: cannot be read: it is a device, not a file"):
        read_tree(Path("/dev/zero"), Problems())


@pytest.mark.parametrize("text", ["a: [1, &b [2, *b]]\n", "a: &a 5\nb: [*a, *a]\n"])
def test_a_few_aliases_are_no_bomb(text: str) -> None:
    assert parse_tree(text, "a.yaml", Problems()) is not None


ENDINGS = {
    "os._exit": ("import os; os._exit(0)", "the process that imported it ended with status 0"),
    "SIGSEGV": (
        "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
        'the process that imported it was killed by SIGSEGV: in "{module}", line 1',
    ),
    "SIGKILL": (
        "import os, signal; print('so long', flush=True); os.kill(os.getpid(), signal.SIGKILL)",
        "the process that imported it was killed by SIGKILL: so long",
    ),
    "BaseException": ("raise BaseException('b')", "nodes/odd.py:1: BaseException: b"),
    "KeyboardInterrupt": ("raise KeyboardInterrupt", "nodes/odd.py:1: KeyboardInterrupt"),
    "GeneratorExit": ("raise GeneratorExit", "nodes/odd.py:1: GeneratorExit"),
}
GUEST = "from palp_core import Node\nclass Odd(Node): ...\n"
GRAPH = "graph: a\nclock: sim\nnodes:\n  odd: {run: nodes.odd:Odd}\n  fine: {run: nodes.fine:Odd}\n"


@pytest.mark.nightly
@pytest.mark.parametrize("name", [*FILES, *ENDINGS])
def test_each_is_refused_soon_and_within_200_mib(workspace: Any, usual_s: float, name: str) -> None:
    text, place, words = (HEAD + FILES[name][0], *FILES[name][1:]) if name in FILES else (GRAPH, "4:14", "")
    if name in ENDINGS:
        workspace.write("nodes/odd.py", f"{ENDINGS[name][0]}\n{GUEST}")
        workspace.write("nodes/fine.py", GUEST)
        words = ENDINGS[name][1].format(module=workspace.root / "nodes/odd.py")
    file: Path = workspace.write("launch/graph.yaml", text)
    (line,) = _refused(workspace.root / "said", usual_s, file)
    assert f"{file}:{place}: " in line
    assert words in line


ENDLESS = {"/dev/zero": "a device", "pipe": "a pipe", "folder": "a folder", "sparse": "more than"}


@pytest.mark.nightly
@pytest.mark.parametrize("argument", ["noise", "shared.chain", "scene", "phantoms", ""])
@pytest.mark.parametrize("name", ENDLESS)
def test_a_file_without_end_is_refused_soon_and_within_200_mib(
    tmp_path: Path, usual_s: float, name: str, argument: str
) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(5 << 30)
    path = tmp_path / name
    arguments = [ROOT / "launch/sim.yaml", f"{argument}:={path}"] if argument else [path]
    (line,) = _refused(tmp_path / "said", usual_s, *arguments)
    assert f"{path}" in line
    assert ENDLESS[name] in line


MEASURED = """
import os, sys
process = os.posix_spawn(sys.executable, [sys.executable, *sys.argv[1:]], os.environ)
_, status, used = os.wait4(process, 0)  # of it and those it has waited for
print(os.waitstatus_to_exitcode(status), used.ru_maxrss, used.ru_utime + used.ru_stime)
"""
"""A small process of its own starts and measures: a child begins with the memory of whoever starts it."""


def _checked(said: Path, *arguments: str | Path) -> list[float]:
    """Check a launch file in a process of its own; return its status, its most KiB and its CPU seconds."""
    command = [sys.executable, "-c", MEASURED, "-m", "palp_core", "launch", *map(str, arguments), "--check"]
    with said.open("w") as errors:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=errors, cwd=ROOT, check=True)
    return [float(word) for word in done.stdout.splitlines()[-1].split()]


@pytest.fixture(scope="module")
def usual_s(tmp_path_factory: pytest.TempPathFactory) -> float:
    """CPU seconds of checking the rig, where nothing is wrong."""
    status, _, worked_s = _checked(tmp_path_factory.mktemp("usual") / "said", ROOT / "launch/sim.yaml")
    assert status == 0
    return worked_s


def _refused(said: Path, usual_s: float, *arguments: str | Path) -> list[str]:
    """Let a launch file be refused in little memory and time; return what is said."""
    status, most_kib, worked_s = _checked(said, *arguments)
    assert status == 2
    assert most_kib < 200 * 1024
    assert worked_s < 2.0 * usual_s
    return said.read_text().splitlines()
