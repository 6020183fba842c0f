"""A lab's own method joins by one decorator: listed, chosen where it is cheapest, and said."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nodes.estimator import Estimator
from nodes.phantom import Phantom
from palp_core import Bench
from palp_core.cli.main import app
from palp_core.errors import MethodError, NodeError
from palp_core.methods import choose, find, left_out, names, register, tasks
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph

LAB = """
from palp_core.methods import Bound, method
from palp_core.palpation.mechanics.contact.l2 import LayeredHertz
from palp_core.palpation.perception.belief.stopping import FixedNumber


@method(task="contact", name="felt", cost_s=1e-3, bounds=[Bound("peak", 0.004)], evidence="the lab")
class Felt(LayeredHertz): ...


@method(task="stop", name="patient", cost_s=1e-6, evidence="the lab")
class Patient(FixedNumber): ...
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module of a lab's own, forgotten after the test with what it declared."""
    tasks()  # what a run imports is declared for good, not for this test
    (tmp_path / "lab_of_ours.py").write_text(LAB, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(register, "_REGISTER", dict(register._REGISTER))
    monkeypatch.setattr(register, "_BROKEN", dict(register._BROKEN))
    yield "lab_of_ours"
    sys.modules.pop("lab_of_ours", None)


def listed(task: str) -> dict[str, str]:
    """Return the mark of each method."""
    done = CliRunner().invoke(app, ["methods", "list", task, "--json"], catch_exceptions=False)
    return {one["name"]: one["mark"] for one in json.loads(done.stdout)}


def test_it_is_named_by_its_module_in_a_parameter_and_said(lab: str) -> None:
    bench = Bench(Estimator, {"stop": f"{lab}:patient"})
    (said,) = bench.sent(Estimator.methods)
    (stop,) = [use for use in said.uses if use.task == "stop"]
    assert (stop.name, stop.asked, stop.evidence) == ("patient", True, "the lab")
    assert "patient" in listed("stop")


def test_it_is_found_by_an_entry_point_and_chosen_where_it_is_the_cheapest_that_will_do(
    lab: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "felt" not in names("contact")
    points = (*register._points(), EntryPoint("contact", lab, register.GROUP))
    monkeypatch.setattr(register, "_points", lambda: points)
    assert listed("contact")["felt"] == "chosen"
    assert find("contact", "felt").evidence == "the lab"
    bench = Bench(Phantom, {})
    (said,) = bench.sent(Phantom.methods)
    rungs = [use for use in said.uses if use.task == "contact"]
    assert {(use.name, use.bound, use.asked) for use in rungs} == {("felt", 0.004, False)}


def test_one_that_is_broken_is_named_and_leaves_the_others_theirs(
    lab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    broken = LAB.replace("cost_s=1e-6", "cost_s=-1.0")  # what it declared before is forgotten
    (tmp_path / f"{lab}.py").write_text(broken, encoding="utf-8")
    points = (*register._points(), EntryPoint("contact", lab, register.GROUP))
    monkeypatch.setattr(register, "_points", lambda: points)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    words = f"{lab} cannot be imported: method 'patient' of task 'stop' costs -1 s"
    shown = CliRunner().invoke(app, ["methods", "list", "contact"], catch_exceptions=False)
    assert words in shown.stderr
    assert "felt" not in shown.stdout
    assert "chosen: the cheapest" in shown.stdout
    (said,) = Bench(Phantom, {}).sent(Phantom.methods)
    assert {use.name for use in said.uses if use.task == "contact"} == {"l2"}
    assert words in caplog.text
    with pytest.raises(MethodError, match=r"no method 'felt' for task 'contact'; .*costs -1 s"):
        find("contact", "felt")
    assert choose("contact", "peak", 0.02, {}).reason.endswith("left out: " + left_out("contact")[0])
    checked = CliRunner().invoke(app, ["launch", str(SIM), "--check"], catch_exceptions=False)
    assert words in checked.stderr


@pytest.mark.parametrize("when", ["set up", "asked for a force"])
def test_one_that_fails_in_a_run_is_named_with_the_error(
    lab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    name = "__init__" if when == "set up" else "force"
    failing = f"class Felt(LayeredHertz):\n    def {name}(self, *_, **__):\n        return 1 / 0\n"
    (tmp_path / f"{lab}.py").write_text(LAB.replace("class Felt(LayeredHertz): ...\n", failing), "utf-8")
    points = (*register._points(), EntryPoint("contact", lab, register.GROUP))
    monkeypatch.setattr(register, "_points", lambda: points)
    with pytest.raises(NodeError) as ended, ComposedGraph(SIM, out=tmp_path / "out") as graph:
        graph.run()
    words = f"ZeroDivisionError: division by zero; contact method 'felt' of {lab} was at work"
    assert words in str(ended.value)
    assert "phantom: " in str(ended.value)
