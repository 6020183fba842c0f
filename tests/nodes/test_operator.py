"""The person who puts phantoms on: asked, and believed once."""

from __future__ import annotations

from pathlib import Path

import pytest

from msgs.experiment import MountedRequest
from msgs.operator import AnswerRequest
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


def test_nobody_is_believed_twice_or_unasked() -> None:
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
