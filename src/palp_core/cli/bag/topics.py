"""Names of topics that a user gives beside bags: one that none of them has is a slip of the pen."""

from collections.abc import Collection
from pathlib import Path

from palp_core.errors import BagError


def check_topics(topics: Collection[str], *bags: Path) -> None:
    """Look whether every topic is in one of the bags; of a bag that was not finished nobody knows before."""
    from palp_core.graph.bag.reader import Bag
    from palp_core.graph.problems import hint

    known: set[str] = set()
    for bag in bags if topics else ():
        with Bag(bag) as opened:
            if not all(file.closed for file in opened.files):
                return
            known |= opened.topics().keys()
    for name in topics:
        if name not in known:
            raise BagError(f"{' and '.join(map(str, bags))}: no topic '{name}'{hint(name, known)}")
