"""A map over a bag: its topics as those of ROS 2 that the map's functions make of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.ros2.export_bag import Outlet, OutletsOf
from palp_core.graph.messages.topic import Topic
from palp_core.graph.problems import Problems, hint
from palp_core.graph.ros2.maps import Entry, Times, read_map
from palp_core.graph.ros2.plan import check_type


def outlets_of(name: str, bag: str | Path) -> OutletsOf:
    """Return what a map makes of a bag's topics; those that it does not name are left out."""
    entries = [entry for entry in read_map(name) if entry.kind == "to_ros2"]
    with Bag(bag) as opened:
        topics = opened.topics()
    problems, found = Problems(), dict[str, list[Outlet]]()
    for entry in entries:
        if entry.palp not in topics:
            continue
        try:
            check_type(entry.palp, entry.messages[0], topics[entry.palp].type_hash)
        except GraphError as error:
            problems.add(entry.mark, str(error))
        found.setdefault(entry.palp, []).append(Outlet(entry.ros, entry.ros_type, partial(_converted, entry)))
    problems.raise_any()
    if not found:
        wanted = entries[0].palp if entries else ""
        raise GraphError(f"{name}: no topic '{wanted}' is in {bag}{hint(wanted, topics)}")

    def outlets(topic: Topic) -> list[Outlet]:
        return found.get(topic.name, [])

    return outlets


def _converted(entry: Entry, payload: bytes, log_ns: int) -> list[tuple[int, Any]]:
    with entry.catch():
        return list(entry.to_ros2(payload, Times(log_ns)))
