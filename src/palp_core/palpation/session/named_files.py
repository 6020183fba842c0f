"""Reads the files that parameters name, before anything starts."""

from collections.abc import Callable

from palp_core.graph.node.node import Mistakes
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.perception.belief.rig_noise import read_noise
from palp_core.palpation.world.model import read_world

_READERS: dict[str, Callable[[str], object]] = {
    "scene": read_scene,
    "phantoms": load_phantoms,
    "noise": read_noise,
    "world": read_world,
}


def find_file_mistakes(params: object, mistakes: Mistakes) -> None:
    """Add what is wrong with the files of ``scene``, ``phantoms``, ``noise`` and ``world``."""
    for name, read in _READERS.items():
        if path := getattr(params, name, ""):
            with mistakes.of(name):
                read(path)
