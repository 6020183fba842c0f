"""Conditions on messages: they say what Python would, and nothing else gets through."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palp_core.cli.text.filter import message_filter
from palp_core.errors import GraphError

NUMBER = {"type": "number"}
SCHEMA: dict[str, Any] = {
    "title": "Sample",
    "type": "object",
    "properties": {
        "index": {"type": "integer"},
        "force_n": NUMBER,
        "name": {"type": "string"},
        "torque_n_m": {"type": "string", "contentEncoding": "base64", "x-dtype": "<f8"},
        "pose": {"title": "Pose", "type": "object", "properties": {"x_m": NUMBER}},
        "poses": {"type": "array", "items": {"type": "object", "properties": {"x_m": NUMBER}}},
    },
}
MESSAGE = {
    "index": 7,
    "force_n": -0.5,
    "name": "a",
    "torque_n_m": [1.0, -2.0],
    "pose": {"x_m": 3.0},
    "poses": [{"x_m": 4.0}],
}


@pytest.mark.parametrize(
    "text",
    [
        "m.index > 3",
        "m.index > 3 and m.force_n < 0",
        "not m.index == 8",
        "0 <= m.index < 8",
        "abs(m.force_n) == 0.5",
        "max(m.torque_n_m) == 1 and min(m.torque_n_m) == -2",
        "m.torque_n_m[0] + m.torque_n_m[-1] == -1",
        "len(m.torque_n_m[1:]) == 1",
        "m.pose.x_m // 2 == 1",
        "m.poses[0].x_m == 4",
        "m.name in ['a', 'b']",
        "m.name == 'a' if m.index else m.index == 0",
        "m.index % 7 == 0 or m.index / 0 > 1",
    ],
)
def test_what_is_true_of_a_message_passes_it(text: str) -> None:
    assert message_filter(text, SCHEMA)(MESSAGE) is True


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "m.__class__",
        "m.index.__class__",
        "().__class__.__bases__",
        "open('/etc/passwd')",
        "(lambda: 1)()",
        "[x for x in m.torque_n_m]",
        "m.name.format(m)",
        "f'{m}'",
        "exec('1')",
        "m.index ** 99999",
        "1 << 99999",
        "(n := 3)",
        "print(m)",
        "max(m.torque_n_m, key=len)",
        "max(*m.torque_n_m)",
        "{**m}",
        "await m",
        "m.index; m.index",
        "import os",
        "b'1' == m.name",
        "1j > 0",
        "x > 3",
        "m.indx > 3",
        "m.index[0] > 3",
        "m['index'] > 3",
        "(" * 400 + "1" + ")" * 400,
        "-" * 900 + "1",
        "1" * 2000,
        "",
    ],
)
def test_anything_else_is_refused_before_a_message_comes(text: str) -> None:
    with pytest.raises(GraphError, match="--filter"):
        message_filter(text, SCHEMA)


@pytest.mark.parametrize(
    "text", ["m.name > 1", "m.name * 9 == ''", "m.torque_n_m[5] > 0", "1 % 0 == 1", "max([])"]
)
def test_what_makes_no_sense_for_a_message_is_an_error_not_a_crash(text: str) -> None:
    with pytest.raises(GraphError, match="--filter"):
        message_filter(text, SCHEMA)(MESSAGE)


def test_a_misspelt_field_gets_the_nearest_name() -> None:
    with pytest.raises(GraphError, match="did you mean 'index'"):
        message_filter("m.indx > 3", SCHEMA)


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ("m.index > 3 and m.indx > 4", 17),
        ("m.name == 'é' and x > 3", 19),
        ("m.index >", 10),
        (" m.index > 3 and m.name > 1", 17),
        ("m.index > 3 and m.torque_n_m[5] > 0", 17),
        ("(m.name == 'éé'\n and x > 3)", 6),
    ],
)
def test_an_error_tells_where(text: str, column: int) -> None:
    with pytest.raises(GraphError, match=rf", column {column}: "):
        message_filter(text, SCHEMA)(MESSAGE)


@pytest.mark.parametrize("name", ["items", "keys", "get"])
def test_a_field_may_have_the_name_of_a_method_of_maps(name: str) -> None:
    schema = {"type": "object", "properties": {name: NUMBER}}
    assert message_filter(f"m.{name} == 2", schema)({name: 2}) is True


NUMBERS = st.integers(-9, 9).map(str) | st.just("m.index") | st.just("m.force_n")


@settings(deadline=None, max_examples=60)
@given(
    left=NUMBERS,
    right=NUMBERS,
    operation=st.sampled_from(["+", "-", "*"]),
    comparison=st.sampled_from(["<", "<=", "==", "!=", ">", ">="]),
    bound=st.integers(-20, 20),
)
def test_conditions_mean_what_they_mean_in_python(
    left: str, right: str, operation: str, comparison: str, bound: int
) -> None:
    text = f"{left} {operation} {right} {comparison} {bound}"
    plain = text.replace("m.index", "7").replace("m.force_n", "(-0.5)")
    assert message_filter(text, SCHEMA)(MESSAGE) is bool(eval(plain))


@settings(deadline=None, max_examples=100)
@given(st.text(alphabet="m.indexforc_[]()<>=+-*/% '1,:andort", max_size=40))
def test_no_text_does_anything_but_answer_or_be_refused(text: str) -> None:
    with contextlib.suppress(GraphError):
        assert message_filter(text, SCHEMA)(MESSAGE) in (True, False)
