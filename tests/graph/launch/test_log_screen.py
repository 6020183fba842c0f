"""What nodes log is shown where their graph was launched: from a level on, or all that a node prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palp_core.graph.discovery.logs import LogLine
from palp_core.graph.launch.graph import Graph
from palp_core.graph.launch.log_screen import MOST_PER_S, Shown
from palp_core.graph.log_format import ENDS_NODE
from tests.support.palp import Palp
from tests.support.supervised import write_files

TOYS = """
import warnings

from palp_core import Node, Params, every


class TalkerParams(Params):
    rate_hz: float = 100.0


class Talker(Node):
    params: TalkerParams

    @every("rate_hz")
    def talk(self):
        self.log.debug("a debug")
        self.log.info("an info")
        self.log.warning("a warning\\nof two lines")
        warnings.warn("of Python", RuntimeWarning)
        self.log.error("an error")
        print("printed")
        self.finish()
"""
LAUNCH = """
graph: talkers
clock: $(var clock)
args:
  clock: {default: wall, choices: [sim, wall]}
  output: {default: log, choices: [screen, log]}
nodes:
  talker: {run: talker_toys:Talker, on_exit: shutdown, output: $(var output)}
"""
WARNING, ERROR = "[WARNING] [talker]: a warning", "[ERROR] [talker]: an error"


@pytest.fixture
def talkers(tmp_path: Path) -> Path:
    write_files(tmp_path, {"nodes/__init__.py": "", "talker_toys.py": TOYS, "launch/talkers.yaml": LAUNCH})
    return tmp_path / "launch/talkers.yaml"


@pytest.mark.parametrize("more", [(), ("clock:=sim", "--compose")])
def test_warnings_and_errors_of_nodes_are_shown(palp: Palp, talkers: Path, more: tuple[str, ...]) -> None:
    done = (palp.run if more else palp.here)("launch", talkers, *more)
    assert done.returncode == 0
    logged = [line for line in done.stderr.splitlines() if line.startswith("[")]
    assert (logged[0], logged[-1]) == (WARNING, ERROR)
    assert "RuntimeWarning: of Python" in "".join(logged[1:-1])


@pytest.mark.parametrize(("log_level", "first"), [("error", 3), ("debug", 0)])
def test_the_level_says_what_is_shown(talkers: Path, log_level: str, first: int) -> None:
    lines: list[str] = []
    with Graph(
        talkers, log_level=log_level, show_log=lambda line: lines.append(line.text), clock="sim"
    ) as graph:
        graph.run()
    everything = ["[DEBUG] [talker]: a debug", "[INFO] [talker]: an info", WARNING, ERROR]
    assert [line for line in lines if "RuntimeWarning" not in line] == everything[first:]


def test_all_that_a_node_prints_reaches_the_screen_if_its_launch_entry_says_so(
    palp: Palp, talkers: Path
) -> None:
    done = palp.here("launch", talkers, "output:=screen")
    assert done.returncode == 0
    said = done.stderr.splitlines()
    for line in (
        "[INFO] [talker]: an info",
        WARNING,
        "[talker]:     of two lines",
        ERROR,
        "[talker]: printed",
    ):
        assert line in said
    assert [line for line in said if re.match(r"\[WARNING\] \[talker\]: \S+ RuntimeWarning: of Python", line)]


def test_a_flood_is_cut_and_what_is_left_out_is_counted() -> None:
    lines: list[LogLine] = []
    screen = Shown("warning", {}, lines.append)
    for _ in range(MOST_PER_S + 7):
        screen.take("2026-11-22T12:00:00.000+00:00 a: [WARNING] [a]: again")
    screen.flush()
    assert len(lines) == MOST_PER_S + 1
    assert lines[-1].text == "... and 7 more lines: palp logs"


@pytest.mark.parametrize(("output", "shown"), [("log", [0]), ("screen", [0, 1])])
def test_a_critical_line_that_ends_no_node_is_shown_and_what_ends_one_the_launcher_reports(
    output: str, shown: list[int]
) -> None:
    lines: list[LogLine] = []
    screen = Shown("critical", {"a": output}, lines.append)
    texts = ["[CRITICAL] [a]: too hot", "    by 3 K", f"[CRITICAL] [a]: failed{ENDS_NODE}", "    Traceback"]
    texts.append("[CRITICAL] [supervisor]: a failed; restart 1 of 3")
    for text in texts:
        screen.take(f"2026-11-22T12:00:00.000+00:00 a: {text}")
    assert [line.text for line in lines] == [texts[i] for i in shown]
    screen.take("2026-11-22T12:00:01.000+00:00 a: [CRITICAL] [a]: of the node that was restarted")
    assert len(lines) == len(shown) + 1
