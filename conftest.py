"""Which files of the source hold tests: those with an example in a docstring."""

from __future__ import annotations

from pathlib import Path

SOURCE = Path(__file__).parent / "src"


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Pass over a source file without an example: pytest would import it only to find that out."""
    if collection_path.suffix != ".py" or SOURCE not in collection_path.parents:
        return None
    return b">>>" not in collection_path.read_bytes() or None
