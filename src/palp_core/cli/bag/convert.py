"""``palp bag convert``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

from palp_core.cli.options import ExcludeRegexOption, RegexOption, argument, option
from palp_core.cli.output import print_text
from palp_core.counted import counted
from palp_core.errors import BagError
from palp_core.graph.bag.convert import BagForm, convert, writing


class ForeignForm(StrEnum):
    """Whose recording is read."""

    ROS2 = "ros2"


def convert_bag(
    bag: Annotated[Path, argument("A bag's folder or file; with --from: a rosbag2.")],
    out: Annotated[Path, option("The new bag.", "-o", "--output", show_default=False)],
    *,
    to: Annotated[BagForm | None, option("What it becomes.", show_default=False)] = None,
    from_: Annotated[
        ForeignForm | None,
        option("Make a palp bag of a rosbag2 (MCAP or SQLite).", "--from", show_default=False),
    ] = None,
    types: Annotated[
        str | None, option("With --to ros2: a map (nodes.ros2_map: the rig's).", metavar="MAP")
    ] = None,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
) -> None:
    """Convert a bag to and from ROS 2, JSON or tables.

    What came --from ros2 goes back --to ros2 as the same bytes.
    """
    if (to is None) == (from_ is None):
        raise BagError("give either --to FORM or --from ros2")
    if types is not None and to is not BagForm.ROS2:
        raise BagError("--types is for --to ros2")
    if from_ is not None:
        from palp_core.graph.bag.ros2.import_bag import import_bag
        from palp_core.graph.bag.selection import topic_selection

        count = import_bag(bag, out, select=topic_selection((), regex, exclude_regex))
    elif regex or exclude_regex:
        raise BagError("--regex and --exclude-regex are for --from; `palp bag filter` makes the choice first")
    elif types is not None:
        count = _by_map(bag, out, types)
    else:
        assert to is not None
        count = convert(bag, out, to)
    print_text(counted(count, "message"))


def _by_map(bag: Path, out: Path, types: str) -> int:
    from palp_core.graph.bag.forms.ros2 import write
    from palp_core.graph.ros2.bag_map import outlets_of
    from palp_core.graph.ros2.message_types import known_types

    with writing(bag, out):
        return write(bag, out, outlets_of(types, bag), known_types())
