"""A map file over a bag: its topics as those of ROS 2's types that ``to_ros2`` names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palp_core.graph.bag.forms.ros2 import Outlet, OutletsOf
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.ros2.definitions import standard
from palp_core.graph.messages.schema_reader import fields_of
from palp_core.graph.messages.topic import Topic
from palp_core.graph.problems import Problems, hint
from palp_core.graph.ros2.crossing import crossing_to_ros2
from palp_core.graph.ros2.field_map import Times
from palp_core.graph.ros2.map_file import MapEntry, MapFile, read_map


def outlets_of(file: Path, bag: str | Path, *, lenient: bool = False) -> OutletsOf:
    """Return what a map makes of a bag's topics.

    Args:
        file: The map.
        bag: The bag.
        lenient: Topics that the bag does not have are left out: a rig's own map names all of them.

    Raises:
        GraphProblems: The map has mistakes, or names topics that the bag does not have.
        BagError: rosbags is not installed, or there is no such bag.
    """
    problems = Problems()
    described = read_map(file, problems)
    with Bag(bag) as opened:
        topics = {name: topic for name, topic in opened.topics().items() if fields_of(topic.json_schema)}
    ways = [way for way in described.to_ros2 if way.palp in topics]
    if not lenient or not ways:
        for way in described.to_ros2:
            if way.palp not in topics:
                problems.add(way.palp_mark, f"no topic '{way.palp}' is in {bag}{hint(way.palp, topics)}")
    made = {
        name: _outlets(described, [w for w in ways if w.palp == name], topics[name], problems)
        for name in topics
    }
    problems.raise_any()
    return lambda topic: made.get(topic.name, [])


def _outlets(described: MapFile, ways: Sequence[MapEntry], topic: Topic, problems: Problems) -> list[Outlet]:
    """Return what becomes of one topic."""
    definitions = standard()
    found = []
    for way in ways:
        crossing = crossing_to_ros2(
            way, topic.json_schema, definitions, described.interfaces, Times(), problems
        )
        if crossing is not None:
            found.append(Outlet(way.ros, crossing.type, crossing.convert))
    return found
