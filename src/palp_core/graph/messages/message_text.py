"""Messages as people read them, by the JSON Schema that the running graph has of each topic."""

import csv
import io
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from palp_core.errors import GraphError, in_words
from palp_core.graph.messages.schema_reader import FLOAT64_DTYPE, fields_of, has_elements, is_array, items_of
from palp_core.graph.problems import hint

Path = tuple[str | int, ...]
_STEP = re.compile(r"(?:^|\.)([A-Za-z_]\w*)|\[(-?\d+)\]")


class Truncation(NamedTuple):
    """How much of a message is shown."""

    length: int | None = 128  # elements of an array, characters of a text; None: all
    arrays: bool = True
    texts: bool = True


def decoded(payload: bytes | memoryview, schema: dict[str, Any]) -> dict[str, Any]:
    import msgspec

    try:
        message = msgspec.msgpack.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise GraphError(
            f"a {schema.get('title', 'message')} that is not msgpack: {in_words(error)}"
        ) from error
    if not isinstance(message, dict):
        raise GraphError(f"a {schema.get('title', 'message')} that is not a map but {type(message).__name__}")
    plain: dict[str, Any] = readable(message, schema)
    return plain


def readable(value: Any, schema: dict[str, Any]) -> Any:
    """Turn numeric arrays into lists and other bytes into hexadecimal text, by the schema."""
    if isinstance(value, bytes):
        if is_array(schema) and len(value) % 8 == 0:
            import numpy as np

            return np.frombuffer(value, dtype=FLOAT64_DTYPE).tolist()
        return value.hex()
    if isinstance(value, dict):
        fields = fields_of(schema)
        return {name: readable(item, fields.get(name, {})) for name, item in value.items()}
    if isinstance(value, list):
        return [readable(item, items_of(schema)) for item in value]
    return value


def parse_path(text: str, schema: dict[str, Any]) -> Path:
    """Read a field's path, as in ``pose.position[2]``, and check it against a schema."""
    steps: list[str | int] = []
    end = 0
    for match in _STEP.finditer(text):
        if match.start() != end:
            break
        end = match.end()
        name, index = match.groups()
        steps.append(int(index) if name is None else name)
    if not steps or end != len(text):
        raise GraphError(f"'{text}' is not a field; write it as in a.b or a[0].b")
    at, title = schema, schema.get("title", "the message")
    for step in steps:
        if isinstance(step, int):
            if not has_elements(at):
                raise GraphError(f"field '{text}': only an array has elements")
            at = items_of(at)
            continue
        known = fields_of(at)
        if step not in known:
            raise GraphError(f"{title} has no field '{step}'{hint(step, known)}")
        at, title = known[step], known[step].get("title", f"{title}.{step}")
    return tuple(steps)


def pick(message: Any, path: Sequence[str | int]) -> Any:
    for step in path:
        try:
            message = message[step]
        except IndexError:
            raise GraphError(f"no element {step}: the array has {len(message)}") from None
    return message


def truncated(value: Any, how: Truncation) -> Any:
    """Return a value with long parts left out, and marked so."""
    if isinstance(value, dict):
        return {name: truncated(item, how) for name, item in value.items()}
    if isinstance(value, str):
        if not how.texts:
            return f"<string length: {len(value)}>"
        return value if how.length is None or len(value) <= how.length else value[: how.length] + "..."
    if isinstance(value, list):
        if not how.arrays:
            return f"<array of {len(value)}>"
        kept = value if how.length is None else value[: how.length]
        more = [f"... {len(value) - len(kept)} more"] if len(kept) < len(value) else []
        return [*(truncated(item, how) for item in kept), *more]
    return value


def csv_line(value: Any) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(_leaves(value))
    return line.getvalue()


def _leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for item in value.values() for leaf in _leaves(item)]
    if isinstance(value, list):
        return [leaf for item in value for leaf in _leaves(item)]
    return [value]
