"""A lab's own package, as an install would leave it: modules on the path, and metadata."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from palp_core.graph.workspaces import underlays
from palp_core.published import entries


def install(site: Path, name: str, files: Mapping[str, str], points: Mapping[str, Mapping[str, str]]) -> None:
    """Write a distribution into a folder of modules.

    Args:
        site: The folder.
        name: Of the distribution.
        files: Text by path below the folder.
        points: Its entry points: value by name, by group.
    """
    for path, text in files.items():
        (site / path).parent.mkdir(parents=True, exist_ok=True)
        (site / path).write_text(text, encoding="utf-8")
    metadata = site / f"{name}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", "utf-8")
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in of.items()) for group, of in points.items()]
    (metadata / "entry_points.txt").write_text("\n".join(lines), "utf-8")


@contextmanager
def forgetting() -> Iterator[pytest.MonkeyPatch]:
    """Undo what a test does to the path, and forget the modules of workspaces that it has imported."""
    finders, path = list(sys.meta_path), list(sys.path)
    kept = {name: module for name, module in sys.modules.items() if _is_of_workspace(name)}
    for name in kept:
        del sys.modules[name]
    _forget()
    try:
        with pytest.MonkeyPatch.context() as patch:
            yield patch
    finally:
        for name in [name for name in sys.modules if _is_of_workspace(name)]:
            del sys.modules[name]
        sys.modules.update(kept)
        sys.meta_path[:], sys.path[:] = finders, path
        _forget()


def _forget() -> None:
    underlays.underlays.cache_clear()
    entries.cache_clear()


def _is_of_workspace(name: str) -> bool:
    return name.partition(".")[0] in {"nodes", "msgs", "softlab", "gripper_lab"} or name.startswith(
        "palp_core.workspace"
    )
