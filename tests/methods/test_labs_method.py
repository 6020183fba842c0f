"""A lab's own method joins by a row of a table: listed, chosen where it is cheapest, and reported."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from nodes.estimator import Estimator
from nodes.phantom import Phantom
from palp_core import Bench
from palp_core.cli.main import app
from palp_core.errors import MethodError, NodeError
from palp_core.methods import choose, find, left_out, register
from tests.support.palp import SIM
from tests.support.rig_session import ComposedGraph

LAB = """
from palp_core.methods import Bound, Method
from palp_core.palpation.mechanics.contact.l2 import LayeredHertz
from palp_core.palpation.perception.belief.stopping import FixedNumber

class Felt(LayeredHertz): ...

class Patient(FixedNumber): ...

METHODS = [
    Method(task="contact", name="felt", place="lab_of_ours:Felt", cost_s=1e-3, bounds=[Bound("peak", 0.004)],
           evidence="the lab"),
    Method(task="stop", name="patient", place="lab_of_ours:Patient", cost_s=1e-6, evidence="the lab"),
]
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The module of a lab, in no entry point yet; the register forgets it after the test."""
    (tmp_path / "lab_of_ours.py").write_text(LAB, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    register.register.cache_clear()
    yield tmp_path / "lab_of_ours.py"
    register.register.cache_clear()
    sys.modules.pop("lab_of_ours", None)


@pytest.fixture
def published(lab: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same, named by an entry point."""
    monkeypatch.setattr(register, "published", lambda group: {"lab": "lab_of_ours"})
    return lab


def listed(task: str) -> dict[str, str]:
    """Return the mark of each method."""
    done = CliRunner().invoke(app, ["methods", "list", task, "--json"], catch_exceptions=False)
    return {one["name"]: one["mark"] for one in json.loads(done.stdout)}


@pytest.mark.usefixtures("lab")
def test_it_is_named_by_its_module_in_a_parameter_and_reported() -> None:
    bench = Bench(Estimator, {"stop": "lab_of_ours:patient"})
    (report,) = bench.sent(Estimator.methods)
    (stop,) = [use for use in report.uses if use.task == "stop"]
    assert (stop.name, stop.asked, stop.evidence) == ("patient", True, "the lab")
    assert "patient" in listed("stop")


@pytest.mark.usefixtures("published")
def test_it_is_found_by_an_entry_point_and_chosen_where_it_is_the_cheapest_that_will_do() -> None:
    assert listed("contact")["felt"] == "chosen"
    (report,) = Bench(Phantom, {}).sent(Phantom.methods)
    rungs = [use for use in report.uses if use.task == "contact"]
    assert {(use.name, use.bound, use.asked) for use in rungs} == {("felt", 0.004, False)}


def test_one_that_is_broken_is_named_and_leaves_the_others_theirs(
    published: Path, caplog: pytest.LogCaptureFixture
) -> None:
    published.write_text(LAB.replace("cost_s=1e-6", "cost_s=-1.0"), encoding="utf-8")
    problem = "lab_of_ours cannot be imported: method 'patient' of task 'stop' costs -1 s"
    shown = CliRunner().invoke(app, ["methods", "list", "contact"], catch_exceptions=False)
    assert problem in shown.stderr
    assert "felt" not in shown.stdout
    assert "chosen: the cheapest" in shown.stdout
    (report,) = Bench(Phantom, {}).sent(Phantom.methods)
    assert {use.name for use in report.uses if use.task == "contact"} == {"l2"}
    assert problem in caplog.text
    with pytest.raises(MethodError, match=r"no method 'felt' for task 'contact'; .*costs -1 s"):
        find("contact", "felt")
    assert choose("contact", "peak", 0.02, {}).reason.endswith("left out: " + left_out()[0])
    checked = CliRunner().invoke(app, ["launch", str(SIM), "--check"], catch_exceptions=False)
    assert problem in checked.stderr


@pytest.mark.parametrize("when", ["set up", "asked for a force"])
def test_one_that_fails_in_a_run_is_named_with_the_error(published: Path, tmp_path: Path, when: str) -> None:
    name = "__init__" if when == "set up" else "force"
    failing = f"class Felt(LayeredHertz):\n    def {name}(self, *_, **__):\n        return 1 / 0\n"
    published.write_text(LAB.replace("class Felt(LayeredHertz): ...\n", failing), "utf-8")
    with pytest.raises(NodeError) as ended, ComposedGraph(SIM, out=tmp_path / "out") as graph:
        graph.run()
    assert "ZeroDivisionError: division by zero; in contact method 'felt' of lab_of_ours" in str(ended.value)
    assert "phantom: " in str(ended.value)
