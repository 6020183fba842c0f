"""What packages of others bring, by entry points: devices, readers of recordings, studies.

A package publishes in its ``pyproject.toml``; what it names is imported when it is used::

    [project.entry-points."palp.devices"]         # kind.name -> class
    "stage.newport" = "softlab.newport:NewportStage"

    [project.entry-points."palp.emg_readers"]     # suffix -> function of a path
    trc = "softlab.vicon:read_trc"

    [project.entry-points."palp.studies"]         # name -> function of a folder, as palp's own studies
    grip = "softlab.grip:run"

Tables of methods (``palp.methods``) and workspaces (``palp.workspaces``) have groups of their own.
Nodes, messages, policies and pages of ``palp view`` are named where they are used: ``package.module:Name``.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

DEVICES, EMG_READERS, STUDIES = "palp.devices", "palp.emg_readers", "palp.studies"


@cache
def entries() -> EntryPoints:
    """Return the entry points of all that is installed: to look through it takes a hundredth of a second."""
    from importlib.metadata import entry_points  # it brings email and zipfile, which no node needs

    return cast("EntryPoints", entry_points())  # of another class in Python 3.11, with the same select


def published(group: str) -> dict[str, str]:
    """Return what installed packages publish: ``module:attribute`` by name, sorted by name.

    Of two packages with the same name palp's own is taken, else that whose place sorts first.
    """
    points = entries().select(group=group)
    foreign_last = sorted(
        (not point.value.startswith("palp_core."), point.value, point.name) for point in points
    )
    return dict(sorted({name: place for _, place, name in reversed(foreign_last)}.items()))
