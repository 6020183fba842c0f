"""The script in an operator's place: answers each prompt once, in its time, and leaves people theirs."""

from __future__ import annotations

from msgs.operator import Prompt
from nodes.human.scripted_operator import ScriptedOperator
from palp_core import Bench


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
