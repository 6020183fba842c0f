"""The files that are written, with names filled in; a file that is there stays as it is."""

import keyword
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from palp_core.errors import GraphError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_IMPORTS = re.compile(r"(?:^from (?:nodes|msgs|drivers|palp_core)\b.*\n)+", re.MULTILINE)
_SUFFIX = ".txt"  # so that no tool takes them for sources of palp's own


class Named(NamedTuple):
    """What is to be written, as a module and as a class.

    Attributes:
        module: As in ``grip_force``.
        class_name: As in ``GripForce``.
    """

    module: str
    class_name: str


def named(word: str) -> Named:
    """Return a name in both its forms.

    >>> named("grip_force"), named("GripForce")
    (Named(module='grip_force', class_name='GripForce'), Named(module='grip_force', class_name='GripForce'))
    """
    if not _NAME.fullmatch(word):
        raise GraphError(
            f"'{word}' is no name: begin with a letter, then letters, digits and _, as in grip_force"
        )
    module = _HUMP.sub("_", word).lower().strip("_")
    class_name = "".join(part[:1].upper() + part[1:] for part in module.split("_"))
    if keyword.iskeyword(module) or keyword.iskeyword(class_name):
        raise GraphError(f"'{word}' is a word of Python; take another name")
    return Named(module, class_name)


def texts(folder: str, values: Mapping[str, str]) -> dict[Path, str]:
    """Return the files of a folder of templates, by the path that each gets, with ``__KEY__`` filled in."""
    root = _root() / folder
    found = sorted(root.rglob(f"*{_SUFFIX}"))
    return {path.relative_to(root).with_suffix(""): _filled(path, values) for path in found}


def text(name: str, values: Mapping[str, str]) -> str:
    """Return a file of what ``palp new`` writes, with ``__KEY__`` filled in."""
    return _filled(_root() / "new" / f"{name}{_SUFFIX}", values)


def _root() -> Path:
    return Path(str(files("palp_core.cli.workspace"))) / "templates"


def _filled(path: Path, values: Mapping[str, str]) -> str:
    filled = path.read_text(encoding="utf-8")
    for key, value in values.items():
        filled = filled.replace(f"__{key}__", value)
    return _IMPORTS.sub(lambda block: "".join(sorted(block[0].splitlines(keepends=True))), filled)


def write_new(folder: Path, contents: Mapping[Path, str | bytes]) -> None:
    """Write files into a folder, all or none."""
    there = [str(path) for path in contents if (folder / path).exists()]
    if there:
        raise GraphError(
            f"{', '.join(there)} in {folder}: already there, and left as it is; take another name"
        )
    for path, content in contents.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with (folder / path).open("xb") as file:
            file.write(content if isinstance(content, bytes) else content.encode())
