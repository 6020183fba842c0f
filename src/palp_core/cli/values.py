"""Words that verbs take: a type and a message, ``name:=value``, points of time."""

from __future__ import annotations

import re
from datetime import UTC, datetime, time, timedelta
from typing import Any

from palp_core.errors import GraphError, PalpError
from palp_core.graph.clock import unix_ns


def type_name(text: str) -> str:
    """Return the name in a type as ROS 2 and palp write it.

    >>> type_name("msgs.contact:ContactSample"), type_name("msgs/msg/ContactSample")
    ('ContactSample', 'ContactSample')
    """
    return text.rpartition(":")[2].rpartition("/")[2]


def type_and_message(typed: list[str], example: str) -> tuple[str | None, str | None]:
    """Tell the type from the message; a message is a YAML mapping and looks like none.

    >>> type_and_message(["Sample", "{index: 1}"], "")
    ('Sample', '{index: 1}')
    """
    kinds = [word for word in typed if type_name(word).isidentifier()]
    texts = [word for word in typed if word not in kinds]
    if len(kinds) > 1 or len(texts) > 1:
        raise GraphError(f"too many words: {' '.join(typed)}; write it as in: {example}")
    return (type_name(kinds[0]) if kinds else None), (texts[0] if texts else None)


def assignments(option: str, given: list[str] | None) -> dict[str, str]:
    """Return names and values of words ``name:=value``."""
    found: dict[str, str] = {}
    for text in given or []:
        name, sign, value = text.partition(":=")
        if not sign or not name:
            raise GraphError(f"{option} {text}: write name:=value")
        if name in found:
            raise GraphError(f"{option} {name} is given twice; keep one")
        found[name] = value
    return found


def value_of(text: str) -> Any:
    """Return a value as YAML reads it."""
    from palp_core.graph.description.yaml_tree import parse_scalar

    return parse_scalar(text)


_AGO = re.compile(r"(\d+(?:\.\d+)?)([smhd])")
_UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days"}
_OF_A_DAY = re.compile(r"T?\d\d:")
_DAY = timedelta(days=1)


def since(text: str) -> datetime:
    """Return the time that is meant: so long ago, the last such time of a day, or written out.

    >>> since("2026-11-22T12:00:00+00:00").isoformat()
    '2026-11-22T12:00:00+00:00'
    """
    now = datetime.fromtimestamp(unix_ns() / 1e9, UTC).astimezone()
    try:
        return _meant(text, now)
    except (ValueError, OverflowError):  # the second: further away than the calendar reaches
        raise PalpError(
            f"'{text}' is not a time; write 30s, 5m, 2h or 1d ago, 14:30 of today or else of yesterday, "
            "or 2026-01-31T14:30"
        ) from None


def _meant(text: str, now: datetime) -> datetime:
    if ago := _AGO.fullmatch(text):
        return now - timedelta(**{_UNITS[ago[2]]: float(ago[1])})
    if not _OF_A_DAY.match(text):
        return datetime.fromisoformat(text).astimezone()
    of_day = time.fromisoformat(text)
    today = datetime.combine(now.date(), of_day).astimezone()
    return today if today <= now else datetime.combine(now.date() - _DAY, of_day).astimezone()
