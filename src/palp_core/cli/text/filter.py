"""A condition on a message, as in ``m.index > 3 and max(m.torque_n_m) < 0.5``.

It is Python's syntax, but nothing is ever handed to Python to run: the tree of the expression is checked
once, against a list of what is allowed and against the message's fields; simpleeval walks it per message.
"""

import ast
import operator
from collections.abc import Callable
from typing import Any

from simpleeval import EvalWithCompoundTypes

from palp_core.errors import GraphError
from palp_core.graph.messages.schema_reader import fields_of, has_elements, items_of
from palp_core.graph.problems import hint

LONGEST = 1000  # characters
DEEPEST = 50  # nested expressions
MESSAGE = "m"

_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "all": all,
    "any": any,
    "len": len,
    "max": max,
    "min": min,
    "sum": sum,
}
_ALLOWED = "fields, numbers, texts, + - * / // %, comparisons, and/or/not, " + ", ".join(_FUNCTIONS)


def _of_numbers(operation: Callable[..., Any]) -> Callable[..., Any]:
    """Return an operation that refuses all but numbers: texts and lists would grow without bound."""

    def calculate(*operands: Any) -> Any:
        for value in operands:
            if not isinstance(value, int | float):
                raise TypeError(f"{type(value).__name__} is no number to calculate with")
        return operation(*operands)

    return calculate


_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: _of_numbers(operator.add),
    ast.Sub: _of_numbers(operator.sub),
    ast.Mult: _of_numbers(operator.mul),
    ast.Div: _of_numbers(operator.truediv),
    ast.FloorDiv: _of_numbers(operator.floordiv),
    ast.Mod: _of_numbers(operator.mod),
    ast.USub: _of_numbers(operator.neg),
    ast.UAdd: _of_numbers(operator.pos),
    ast.Not: operator.not_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda item, container: item in container,
    ast.NotIn: lambda item, container: item not in container,
}


def message_filter(text: str, schema: dict[str, Any]) -> Callable[[dict[str, Any]], bool]:
    """Return a function that tells whether a message meets a condition.

    Args:
        text: The condition; the message is ``m``, its fields ``m.a.b``, elements of arrays ``m.a[0]``.
        schema: JSON Schema of the message; fields are checked against it now.

    Raises:
        GraphError: The text is no such condition, names a field that does not exist, or (when the function is
            called) fits no value, as ``m.text > 1`` does.
    """
    text = text.strip()
    if len(text) > LONGEST:
        raise GraphError(f"--filter: {len(text)} characters are too many; {LONGEST} are allowed")
    try:
        root = ast.parse(text, mode="eval").body
    except SyntaxError as error:
        column = error.offset or len(text) + 1  # 0 where the text ends too early
        raise _problem(text, column, f"{error.msg}; write it as in: m.index > 3") from error
    except (ValueError, RecursionError, MemoryError) as error:
        raise GraphError(f"--filter '{text}': {error}; write it as in: m.index > 3") from error
    _check(root, schema, text, 0)
    evaluator = _Evaluator(text)
    return lambda message: evaluator.holds(root, message)


class _Evaluator(EvalWithCompoundTypes):  # type: ignore[misc]
    """Walks a checked tree: a field is a key of the map, and an error says at which column it arose."""

    def __init__(self, text: str) -> None:
        super().__init__(_OPERATORS, dict(_FUNCTIONS), {})
        self.expr = text
        self.nodes[ast.Attribute] = lambda node: self._eval(node.value)[node.attr]
        self.nodes[ast.Tuple] = self._eval_list

    def holds(self, root: ast.expr, message: dict[str, Any]) -> bool:
        """Tell whether a message meets the condition."""
        self.names[MESSAGE] = message
        return bool(self._eval(root))

    def _eval(self, node: ast.expr) -> Any:
        try:
            return self.nodes[type(node)](node)  # values of messages need no search for what is dangerous
        except (TypeError, ZeroDivisionError, IndexError, KeyError, ValueError, OverflowError) as error:
            raise _problem(self.expr, node, f"{type(error).__name__}: {error}") from error


def _check(node: ast.expr, schema: dict[str, Any], text: str, depth: int) -> dict[str, Any] | None:
    """Refuse what is not listed; return the schema of a field."""
    if depth > DEEPEST:
        raise _problem(text, node, "nested too deeply")
    match node:
        case ast.Constant(value=bool() | int() | float() | str() | None):
            return None
        case ast.Name(id=name) if name == MESSAGE:
            return schema
        case ast.Attribute(value=inner, attr=name):
            known = fields_of(_check(inner, schema, text, depth + 1) or {})
            if name not in known:
                raise _problem(text, node, f"no field '{name}'{hint(name, known)}")
            field: dict[str, Any] = known[name]
            return field
        case ast.Subscript(value=inner, slice=index):
            outer = _check(inner, schema, text, depth + 1) or {}
            for part in (index.lower, index.upper, index.step) if isinstance(index, ast.Slice) else (index,):
                if part is not None:
                    _check(part, schema, text, depth + 1)
            if not has_elements(outer):
                raise _problem(text, node, "only an array has elements")
            return outer if isinstance(index, ast.Slice) else items_of(outer)
        case ast.BinOp(op=op) | ast.UnaryOp(op=op) if type(op) in _OPERATORS:
            pass
        case ast.Compare(ops=ops) if all(type(op) in _OPERATORS for op in ops):
            pass
        case ast.BoolOp() | ast.IfExp() | ast.List() | ast.Tuple():
            pass
        case ast.Call(func=ast.Name(id=name), keywords=[]) if name in _FUNCTIONS:
            for argument in node.args:
                _check(argument, schema, text, depth + 1)
            return None
        case ast.Name(id=name):
            raise _problem(text, node, f"'{name}' is unknown; the message is {MESSAGE}, as in m.index > 3")
        case _:
            raise _problem(text, node, f"{type(node).__name__} is not allowed; allowed: {_ALLOWED}")
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            _check(child, schema, text, depth + 1)
    return None


def _problem(text: str, where: ast.expr | int, what: str) -> GraphError:
    if isinstance(where, ast.expr):
        line = text.encode().splitlines()[where.lineno - 1]
        where = len(line[: where.col_offset].decode()) + 1  # Python counts bytes, people characters
    return GraphError(f"--filter '{text}', column {where}: {what}")
