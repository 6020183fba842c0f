"""What packages of others bring, by entry points: devices, readers of recordings, studies.

A package publishes in its ``pyproject.toml``; what it names is imported when it is used::

    [project.entry-points."palp.devices"]         # kind.name -> class
    "stage.newport" = "softlab.newport:NewportStage"

    [project.entry-points."palp.emg_readers"]     # suffix -> function of a path
    trc = "softlab.vicon:read_trc"

    [project.entry-points."palp.studies"]         # name -> function of a folder, as palp's own studies
    grip = "softlab.grip:run"

Methods (``palp.methods``, ``palp.measures``) and workspaces (``palp.workspaces``) have groups of their own.
Nodes, messages, policies and pages of ``palp view`` are named where they are used: ``package.module:Name``.
"""

from functools import cache

DEVICES, EMG_READERS, STUDIES = "palp.devices", "palp.emg_readers", "palp.studies"


@cache
def published(group: str) -> dict[str, str]:
    """Return what installed packages publish: ``module:attribute`` by name, sorted by name.

    Of two packages with the same name, that whose place sorts first is taken: the same one every time.
    """
    from importlib.metadata import entry_points  # it brings email and zipfile, which no node needs

    points = sorted(entry_points(group=group), key=lambda point: (point.name, point.value), reverse=True)
    return dict(sorted({point.name: point.value for point in points}.items()))
