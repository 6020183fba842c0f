"""The type and the message that a verb takes as words, both optional, as ROS 2 users type them."""

from __future__ import annotations

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

    Raises:
        GraphError: Two of one kind.
    """
    kinds = [word for word in words if type_name(word).isidentifier()]
    texts = [word for word in words if word not in kinds]
    if len(kinds) > 1 or len(texts) > 1:
        raise GraphError(f"too many words: {' '.join(words)}; write it as in: {example}")
    return (type_name(kinds[0]) if kinds else None), (texts[0] if texts else None)
