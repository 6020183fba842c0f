"""The person who puts phantoms on, asked and believed once; and the script in an operator's place."""

from __future__ import annotations

from pathlib import Path

import pytest

from msgs.experiment import MountedRequest
from msgs.operator import AnswerRequest, Prompt
from nodes.human.scripted_operator import ScriptedOperator
from nodes.operator import Operator
from palp_core import Bench
from palp_core.errors import NodeError
from tests.support.rig_messages import mount

ASKED = mount("B", 3)


def test_the_phantom_is_on_when_the_person_says_so() -> None:
    bench = Bench(Operator)
    bench.feed(Operator.mount, ASKED)
    assert bench.sent(Operator.truth) == []
    assert bench.call(Operator.mounted, MountedRequest()).done
    (truth,) = bench.sent(Operator.truth)
    assert (truth.code, truth.remount, truth.height_offset_m) == ("B", 3, 0.0)
    assert truth.depth_m > 0.0


def test_a_person_is_believed_once_and_only_when_asked() -> None:
    bench = Bench(Operator)
    assert not bench.call(Operator.mounted, MountedRequest()).done
    bench.feed(Operator.mount, ASKED)
    assert bench.call(Operator.mounted, MountedRequest()).done
    assert not bench.call(Operator.mounted, MountedRequest()).done
    assert len(bench.sent(Operator.truth)) == 1


def test_the_wrong_phantom_is_refused() -> None:
    bench = Bench(Operator)
    bench.feed(Operator.mount, ASKED)
    reply = bench.call(Operator.mounted, MountedRequest(code="A"))
    assert (reply.done, reply.code) == (False, "B")
    assert bench.call(Operator.mounted, MountedRequest(code="B")).done


def test_a_phantom_that_does_not_exist_is_refused() -> None:
    with pytest.raises(NodeError, match="no phantom 'Z'"):
        Bench(Operator).feed(Operator.mount, mount("Z", 0))


def test_the_operators_desk_asks_with_the_indentation_and_takes_enter_once() -> None:
    bench = Bench(Operator)
    bench.feed(Operator.mount, ASKED)
    prompt = bench.sent(Operator.prompt)[-1]
    assert prompt.text == "Mount phantom B, indent 4.0 mm. Enter when it is there."
    wrong = bench.call(Operator.answer, AnswerRequest(number=prompt.number, text="A"))
    assert (wrong.taken, wrong.text) == (False, "asked for is phantom B")
    assert not bench.call(Operator.answer, AnswerRequest(number=prompt.number - 1)).taken
    assert bench.call(Operator.answer, AnswerRequest(number=prompt.number)).taken
    assert not bench.call(Operator.answer, AnswerRequest(number=prompt.number)).taken
    assert [truth.code for truth in bench.sent(Operator.truth)] == ["B"]
    assert bench.sent(Operator.prompt)[-1].kind == "none"


def test_the_indentation_is_that_of_the_scene(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("path: {indentation_m: 0.0025}\n")
    bench = Bench(Operator, {"scene": str(scene)})
    bench.feed(Operator.mount, ASKED)
    assert "indent 2.5 mm" in bench.sent(Operator.prompt)[-1].text


def prompt(number: int, kind: str, **more: object) -> Prompt:
    return Prompt(stamp_ns=0, number=number, kind=kind, text="", **more)  # type: ignore[arg-type]


def test_each_prompt_is_answered_in_its_time() -> None:
    bench = Bench(ScriptedOperator, {"palpation_s": 2.0, "answer_s": 1.0, "texts": ["C-1"]})
    bench.feed(ScriptedOperator.prompt, prompt(1, "text"))
    bench.feed(ScriptedOperator.prompt, prompt(2, "enter"))
    bench.feed(ScriptedOperator.prompt, prompt(3, "enter", ends_ns=60_000_000_000))
    bench.advance(1.9)
    assert [(one.number, one.text) for one in bench.requests(ScriptedOperator.answer)[:2]] == [
        (1, "C-1"),
        (2, ""),
    ]
    assert len({one.number for one in bench.requests(ScriptedOperator.answer)}) == 2
    bench.advance(0.2)
    assert bench.requests(ScriptedOperator.answer)[-1].number == 3
    bench.feed(ScriptedOperator.prompt, prompt(4, "choice", choices=["2", "4"]))
    bench.advance(1.0)
    last = bench.requests(ScriptedOperator.answer)[-1]
    assert (last.number, last.by) == (4, "script")
    assert last.text in ("2", "4")


def test_a_person_is_left_to_answer() -> None:
    bench = Bench(ScriptedOperator, {"by": "terminal"})
    bench.feed(ScriptedOperator.prompt, prompt(1, "enter"))
    bench.advance(5.0)
    assert bench.requests(ScriptedOperator.answer) == []


def test_what_only_reports_is_not_answered() -> None:
    bench = Bench(ScriptedOperator)
    bench.feed(ScriptedOperator.prompt, prompt(1, "none"))
    bench.advance(5.0)
    assert bench.requests(ScriptedOperator.answer) == []
