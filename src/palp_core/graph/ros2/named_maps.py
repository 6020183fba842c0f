"""Maps that come with an installed package, by name: entry points of the group ``palp.ros2_maps``."""

from pathlib import Path

from palp_core.errors import GraphError
from palp_core.foreign import import_foreign
from palp_core.graph.problems import hint
from palp_core.published import published

GROUP = "palp.ros2_maps"
"""Each leads to a file in its package: ``std = "my_package.folder:maps.yaml"``."""


def find_map(word: str) -> tuple[Path, bool]:
    """Return the file of a map, and whether it is one by name.

    Args:
        word: A file, or the name of a map that comes with a package.

    Raises:
        GraphError: It is neither.
    """
    if Path(word).is_file() or "/" in word or word.endswith((".yaml", ".yml")):
        return Path(word), False
    maps = published(GROUP)
    if word not in maps:
        raise GraphError(f"no map '{word}'{hint(word, maps)}; or give a file, as in map.yaml")
    package, _, file = maps[word].partition(":")
    return Path(str(import_foreign(package, f"map '{word}'", GraphError).__file__)).parent / file, True
