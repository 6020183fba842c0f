"""Choose topics: by name, by regular expression, all but some."""

import re
from collections.abc import Callable, Collection

from palp_core.errors import BagError


def topic_selection(
    topics: Collection[str] = (), regex: str | None = None, exclude_regex: str | None = None
) -> Callable[[str], bool]:
    """Return the function that says of a topic whether it is chosen.

    Args:
        topics: Names; none and no ``regex``: every topic.
        regex: Topics in which it is found are chosen as well.
        exclude_regex: Topics in which it is found are not.

    Raises:
        BagError: Not a regular expression.
    """
    names = set(topics)
    wanted, unwanted = _compiled(regex), _compiled(exclude_regex)

    def chosen(topic: str) -> bool:
        if unwanted is not None and unwanted.search(topic):
            return False
        if not names and wanted is None:
            return True
        return topic in names or (wanted is not None and wanted.search(topic) is not None)

    return chosen


def _compiled(text: str | None) -> re.Pattern[str] | None:
    try:
        return None if text is None else re.compile(text)
    except re.error as error:
        raise BagError(f"'{text}' is not a regular expression: {error}") from error
