"""``palp bag convert``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import ExcludeRegexOption, RegexOption
from palp_core.cli.output import print_text
from palp_core.counted import counted
from palp_core.errors import BagError
from palp_core.graph.bag.convert import BagForm, convert, writing


class ForeignForm(StrEnum):
    """Whose recording is read."""

    ROS2 = "ros2"


def convert_bag(
    bag: Annotated[
        Path,
        typer.Argument(
            help="A bag's folder or one of its files; with --from: of another's recording.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--output", help="The new bag.", show_default=False)],
    *,
    to: Annotated[BagForm | None, typer.Option(help="What it becomes.", show_default=False)] = None,
    from_: Annotated[
        ForeignForm | None,
        typer.Option("--from", help="Make a palp bag of a rosbag2 (MCAP or SQLite).", show_default=False),
    ] = None,
    types: Annotated[
        str | None,
        typer.Option(
            metavar="MAP",
            help="With --to ros2: types and topics of a map (nodes.ros2_map: the rig's).",
        ),
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
        from palp_core.graph.bag.reader import topic_selection
        from palp_core.graph.bag.ros2.import_bag import import_bag

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
    from palp_core.graph.bag.ros2.export_bag import write
    from palp_core.graph.ros2.bag_map import outlets_of
    from palp_core.graph.ros2.message_types import known_types

    with writing(bag, out):
        return write(bag, out, outlets_of(types, bag), known_types())
