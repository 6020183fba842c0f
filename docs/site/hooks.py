"""Hooks of MkDocs: add the pages that are made from the code, and Mermaid."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from mkdocs.structure.files import File, Files  # noqa: E402

from docs.site.made_pages import DOCS, MADE, whole_page  # noqa: E402


def on_config(config: Any) -> Any:
    """Give each page that the contents do not name a place among the how-to pages, rather than none."""
    pages = {str(file.relative_to(DOCS)) for file in DOCS.rglob("*.md")}
    (how_to,) = [part["How-to"] for part in config.nav if "How-to" in part]
    how_to += sorted(pages - named_in(config.nav))
    return config


def named_in(nav: Any) -> set[str]:
    """Return the pages that contents name."""
    if isinstance(nav, str):
        return {nav}
    parts = nav.values() if isinstance(nav, dict) else nav
    return {page for part in parts for page in named_in(part)}


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made, the schemas of files and the diagrams' library."""
    for place in MADE:
        files.remove(files.src_uris[place])  # of a checkout: the page's beginning
        files.append(File.generated(config, place, content=whole_page(place)))
    for schema in sorted((ROOT / "launch").glob("*.schema.json")):
        files.append(File.generated(config, f"reference/{schema.name}", abs_src_path=str(schema)))
    for script in sorted(mermaid_folder().glob("*.js")):
        files.append(File.generated(config, f"site/mermaid/{script.name}", abs_src_path=str(script)))
    return files


def mermaid_folder() -> Path:
    """Return where NiceGUI, which ``palp view`` is made with, keeps Mermaid.

    Raises:
        FileNotFoundError: It is not installed, or has it elsewhere.
    """
    found = importlib.util.find_spec("nicegui")
    if found is None or found.origin is None:
        raise FileNotFoundError("the diagrams need NiceGUI's copy of Mermaid: pip install '.[docs]'")
    folder = Path(found.origin).parent / "elements" / "mermaid" / "dist"
    if not (folder / "index.js").is_file():
        raise FileNotFoundError(
            f"{folder} has no Mermaid; install the version of NiceGUI that the extra names"
        )
    return folder
