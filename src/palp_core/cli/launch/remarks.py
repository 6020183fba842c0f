"""What a checked launch file asks for in vain, and which modules it takes in place of installed ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from palp_core.cli.output import note

if TYPE_CHECKING:
    from palp_core.graph.description.checked import CheckedGraph


def note_without_effect(file: Path, checked: CheckedGraph) -> None:
    from palp_core.graph.description.checked import unpublished_words, without_effect

    for text in filter(None, (without_effect(checked), unpublished_words(checked.unpublished))):
        note(f"{file}: note: {text}")


def note_remarks(file: Path, checked: CheckedGraph) -> None:
    from palp_core.graph.workspaces.modules import hidden_modules

    note_without_effect(file, checked)
    for module, own, installed, name in hidden_modules(checked.workspace):
        note(f"{file}: note: {module} is {own}, in place of that of '{name}', {installed}")
