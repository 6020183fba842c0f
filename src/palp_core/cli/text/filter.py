"""A condition on a message, as in ``m.index > 3 and max(m.torque_n_m) < 0.5``.

It is Python's syntax, but nothing is ever handed to Python to run: the tree of the expression is walked here,
and every kind of node that is not listed is refused.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

from palp_core.cli.text.message_text import is_array
from palp_core.errors import GraphError
from palp_core.graph.problems import hint

LONGEST = 1000  # characters
DEEPEST = 50  # nested expressions
MESSAGE = "m"

_OPERATORS: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_COMPARISONS: dict[type[ast.AST], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda item, container: item in container,
    ast.NotIn: lambda item, container: item not in container,
}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "all": all,
    "any": any,
    "len": len,
    "max": max,
    "min": min,
    "sum": sum,
}
_LEAVES = (ast.Constant, ast.Name)


def message_filter(text: str, schema: dict[str, Any]) -> Callable[[dict[str, Any]], bool]:
    """Return a function that tells whether a message meets a condition.

    Args:
        text: The condition; the message is ``m``, its fields ``m.a.b``, elements of arrays ``m.a[0]``.
        schema: JSON Schema of the message; fields are checked against it now.

    Raises:
        GraphError: The text is no such condition, names a field that does not exist, or (when the function is
            called) fits no value, as ``m.text > 1`` does.
    """
    if len(text) > LONGEST:
        raise GraphError(f"--filter: {len(text)} characters are too many; {LONGEST} are allowed")
    try:
        root = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or error
        raise GraphError(f"--filter '{text}': {reason}; write it as in: m.index > 3") from error
    _check(root, schema, text, 0)

    def condition(message: dict[str, Any]) -> bool:
        try:
            return bool(_value(root, message))
        except (TypeError, ZeroDivisionError, IndexError, KeyError, ValueError, OverflowError) as error:
            raise GraphError(f"--filter '{text}': {type(error).__name__}: {error}") from error

    return condition


def _check(node: ast.AST, schema: dict[str, Any], text: str, depth: int) -> dict[str, Any] | None:
    """Refuse what is not listed; return the schema of a field."""
    if depth > DEEPEST:
        raise GraphError(f"--filter '{text}': nested too deeply")
    match node:
        case ast.Constant(value=bool() | int() | float() | str() | None):
            return None
        case ast.Name(id=name) if name == MESSAGE:
            return schema
        case ast.Attribute(value=inner, attr=name):
            known = (_check(inner, schema, text, depth + 1) or {}).get("properties", {})
            if name not in known:
                raise GraphError(f"--filter '{text}': no field '{name}'{hint(name, known)}")
            field: dict[str, Any] = known[name]
            return field
        case ast.Subscript(value=inner, slice=index):
            outer = _check(inner, schema, text, depth + 1) or {}
            for part in (index.lower, index.upper, index.step) if isinstance(index, ast.Slice) else (index,):
                if part is not None:
                    _check(part, schema, text, depth + 1)
            if outer.get("type") != "array" and not is_array(outer):
                raise GraphError(f"--filter '{text}': only an array has elements")
            return outer if isinstance(index, ast.Slice) else outer.get("items", {})
        case ast.BinOp(op=op) if type(op) in _OPERATORS:
            pass
        case ast.Compare(ops=ops) if all(type(op) in _COMPARISONS for op in ops):
            pass
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.UAdd()) | ast.BoolOp() | ast.IfExp():
            pass
        case ast.List() | ast.Tuple():
            pass
        case ast.Call(func=ast.Name(id=name), keywords=[]) if name in _FUNCTIONS:
            for argument in node.args:
                _check(argument, schema, text, depth + 1)
            return None
        case ast.Name(id=name):
            raise GraphError(
                f"--filter '{text}': '{name}' is unknown; the message is {MESSAGE}, as in m.index > 3"
            )
        case _:
            allowed = "fields, numbers, texts, + - * / // %, comparisons, and/or/not, " + ", ".join(
                _FUNCTIONS
            )
            raise GraphError(f"--filter '{text}': {type(node).__name__} is not allowed; allowed: {allowed}")
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            _check(child, schema, text, depth + 1)
    return None


def _value(node: ast.AST | None, message: dict[str, Any]) -> Any:
    """Return the value of a node that :func:`_check` has passed."""
    match node:
        case None:
            return None
        case ast.Constant(value=value):
            return value
        case ast.Name():
            return message
        case ast.Attribute(value=inner, attr=name):
            return _value(inner, message)[name]
        case ast.Subscript(value=inner, slice=ast.Slice(lower=low, upper=high, step=step)):
            return _value(inner, message)[
                _value(low, message) : _value(high, message) : _value(step, message)
            ]
        case ast.Subscript(value=inner, slice=index):
            return _value(inner, message)[_value(index, message)]
        case ast.BinOp(left=left, op=op, right=right):
            return _calculated(op, _value(left, message), _value(right, message))
        case ast.UnaryOp(op=op, operand=operand):
            value = _value(operand, message)
            return (
                not value
                if isinstance(op, ast.Not)
                else _calculated(ast.Sub() if isinstance(op, ast.USub) else ast.Add(), 0, value)
            )
        case ast.BoolOp(op=op, values=values):
            results = (_value(part, message) for part in values)
            return all(results) if isinstance(op, ast.And) else any(results)
        case ast.Compare(left=first, ops=ops, comparators=others):
            left = _value(first, message)
            for comparison, other in zip(ops, others, strict=True):
                right = _value(other, message)
                if not _COMPARISONS[type(comparison)](left, right):
                    return False
                left = right
            return True
        case ast.IfExp(test=test, body=body, orelse=other):
            return _value(body if _value(test, message) else other, message)
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return [_value(item, message) for item in items]
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return _FUNCTIONS[name](*(_value(argument, message) for argument in arguments))
    raise AssertionError(node)


def _calculated(op: ast.operator, left: Any, right: Any) -> Any:
    """Return the result of an operation on numbers; text and lists would grow without bound."""
    for value in (left, right):
        if not isinstance(value, int | float):
            raise TypeError(f"{type(value).__name__} is no number to calculate with")
    return _OPERATORS[type(op)](left, right)
