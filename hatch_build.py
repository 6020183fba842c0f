"""What a build adds: the rig as data of the wheel, and a README that holds on an index page."""

import re
import tomllib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

RIG = ("nodes", "msgs", "launch", "tests/golden/session.mcap")
"""What travels below ``palp_core/workspace``, so that no package is called ``nodes``; the recording is what
``launch/replay.yaml`` plays."""

_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]\[]*)\]\((?P<to>[^)\s]+)\)")
_FENCE = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)


def index_page(readme: str, pages: str, raw: str) -> str:
    """Return a README whose relative links hold away from the repository.

    Args:
        readme: Markdown.
        pages: Address under which the repository's files can be read; "" where there is none: a link then
            becomes its text, and a picture what stands in its place.
        raw: The same for the bytes of pictures.
    """

    def absolute(link: re.Match[str]) -> str:
        base = raw if link["picture"] else pages
        if "://" in link["to"] or link["to"].startswith(("mailto:", "#")):
            return link[0]
        if not base:
            return f"*{link['text']}*" if link["picture"] else link["text"]
        return f"{link['picture']}[{link['text']}]({base.rstrip('/')}/{link['to']})"

    parts = _FENCE.split(readme)
    return "".join(part if part.startswith("```") else _LINK.sub(absolute, part) for part in parts)


class ReadmeHook(MetadataHookInterface):
    """Puts the README into the metadata; ``[tool.palp.readme]`` says where its links lead."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set ``readme``."""
        root = Path(self.root)
        settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
        places = settings["tool"]["palp"]["readme"]
        text = index_page((root / "README.md").read_text(encoding="utf-8"), places["pages"], places["raw"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


class RigHook(BuildHookInterface[Any]):
    """Puts the rig into a wheel; an editable install uses it where it is."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the folders to include."""
        if version != "editable":
            build_data["force_include"].update({name: f"palp_core/workspace/{name}" for name in RIG})
