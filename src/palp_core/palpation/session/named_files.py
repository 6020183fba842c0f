"""What is wrong with the files that parameters name, said before anything starts."""

from palp_core.errors import MechanicsError, PerceptionError
from palp_core.palpation.mechanics.scene import phantom_file
from palp_core.palpation.perception.belief.rig_noise import read_noise
from palp_core.palpation.world.model import read_world


def file_mistakes(params: object) -> dict[str, str]:
    """Return what is wrong with the files of ``scene``, ``phantoms``, ``noise`` and ``world``."""
    found = phantom_file.file_mistakes(params)
    if path := getattr(params, "noise", ""):
        try:
            read_noise(path)
        except PerceptionError as error:
            found["noise"] = str(error)
    if world := getattr(params, "world", ""):
        try:
            read_world(world)
        except MechanicsError as error:
            found["world"] = str(error)
    return found
