"""Words that verbs take, as ROS 2 users type them: a type and a message, if any, and ``name:=value``."""

from typing import Any

from palp_core.errors import GraphError


def type_name(text: str) -> str:
    """Return the name in a type as ROS 2 and palp write it.

    >>> type_name("msgs.contact:ContactSample"), type_name("msgs/msg/ContactSample")
    ('ContactSample', 'ContactSample')
    """
    return text.rpartition(":")[2].rpartition("/")[2]


def type_and_message(words: list[str], example: str) -> tuple[str | None, str | None]:
    """Tell the type from the message; a message is a YAML mapping and looks like none.

    >>> type_and_message(["Sample", "{index: 1}"], "")
    ('Sample', '{index: 1}')
    """
    kinds = [word for word in words if type_name(word).isidentifier()]
    texts = [word for word in words if word not in kinds]
    if len(kinds) > 1 or len(texts) > 1:
        raise GraphError(f"too many words: {' '.join(words)}; write it as in: {example}")
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
