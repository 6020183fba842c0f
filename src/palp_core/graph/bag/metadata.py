"""``metadata.yaml`` of a bag folder, in the form that rosbag2 gave it (version 9)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import yaml

from palp_core.errors import BagError
from palp_core.graph.bag.mcap.records import MAGIC
from palp_core.graph.messages.topic import Topic
from palp_core.whole_file import read_whole, write_whole

FILE_NAME = "metadata.yaml"
ROOT = "rosbag2_bagfile_information"
_LARGEST_BYTES = 4 << 20
_ADVICE = (
    "give a bag's folder or an .mcap file; of a rosbag2 make one: palp bag convert BAG --from ros2 -o NEW"
)


class FilePart(msgspec.Struct, frozen=True):
    name: str
    start_ns: int
    end_ns: int
    message_count: int


def write_metadata(
    folder: Path,
    topics: Mapping[str, tuple[Topic, str, int]],
    files: Sequence[FilePart],
    custom: Mapping[str, str],
) -> None:
    filled = [part for part in files if part.message_count]
    start_ns = min((part.start_ns for part in filled), default=0)
    end_ns = max((part.end_ns for part in filled), default=0)
    information: dict[str, Any] = {
        "version": 9,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(count for _, _, count in topics.values()),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": topic.type,
                    "serialization_format": encoding,
                    "offered_qos_profiles": [],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": count,
            }
            for name, (topic, encoding, count) in sorted(topics.items())
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in files],
        "files": [
            {
                "path": part.name,
                "starting_time": {"nanoseconds_since_epoch": part.start_ns},
                "duration": {"nanoseconds": part.end_ns - part.start_ns},
                "message_count": part.message_count,
            }
            for part in files
        ],
        "custom_data": dict(custom) or None,
        "ros_distro": "",
    }
    text = yaml.safe_dump({ROOT: information}, sort_keys=False, allow_unicode=True)
    write_whole(folder / FILE_NAME, text, durable=True)


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag in order; a file is a bag of itself.

    What counts is what lies in the folder, so a bag without ``metadata.yaml`` (a crash) is whole as well; a
    file that ``metadata.yaml`` names and that is gone is an error.
    """
    if path.is_file():
        if path.suffix != ".mcap" and not _begins_as_mcap(path):
            raise BagError(f"{path}: not a bag; {_ADVICE}")
        return [path]
    if not path.is_dir():
        raise BagError(f"{path}: no such bag; give a bag's folder or an .mcap file")
    files = in_order(path)
    if not files:
        raise BagError(f"{path}: not a bag, no .mcap file is in it; {_ADVICE}")
    if missing := missing_files(path):
        raise BagError(f"{path}: {', '.join(missing)} is missing; read the other files one by one")
    return files


def missing_files(folder: Path) -> list[str]:
    """Return the names of a bag's files that ``metadata.yaml`` names and that are gone."""
    return sorted(named_files(folder).keys() - {file.name for file in in_order(folder)})


def _begins_as_mcap(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return True  # reading it raises the reason


def in_order(folder: Path) -> list[Path]:
    """Return the MCAP files of a folder by their numbers."""
    return sorted((path for path in folder.glob("*.mcap") if path.is_file()), key=_place)


def _place(file: Path) -> tuple[int, str]:
    number = file.stem.rpartition("_")[2]
    return (int(number) if number.isdecimal() else -1, file.name)


def named_files(folder: Path) -> dict[str, tuple[int, int] | None]:
    """Return first and last log time, ns, of each file that ``metadata.yaml`` names.

    None where it has no times; damaged or foreign, it names no file.
    """
    try:
        content = yaml.safe_load(read_whole(folder / FILE_NAME, _LARGEST_BYTES))[ROOT]
        spans = {}
        for one in content.get("files") or ():
            start_ns = int(one["starting_time"]["nanoseconds_since_epoch"])
            spans[Path(str(one["path"])).name] = start_ns, start_ns + int(one["duration"]["nanoseconds"])
        names = [Path(str(name)).name for name in content["relative_file_paths"]]
        return {name: spans.get(name) for name in names}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError):
        return {}
