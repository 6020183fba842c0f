"""Which phantom is which, sealed: new codes, and a key that is not read by accident.

Who simulates a person reads from the key what is palpated.
Codes and their order come from the machine's entropy, never from a run's seed: one who knows the seed, the
program and the phantoms can draw neither again. The file is no safe: it keeps from seeing, not from prying.
"""

import dataclasses
import hashlib
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.sealing import opened, sealed
from palp_core.whole_file import begins_with, read_whole, write_whole

SEAL = b"sealed by palp: which phantom is which; `palp session unseal` opens it\n"
_LETTERS, _DIGITS = "CDFGHJKLMNPRTVWXY", "234679"
_LARGEST_BYTES = 256 << 10


def is_sealed(path: str | Path) -> bool:
    """Return whether a file is a sealed one."""
    return begins_with(path, SEAL)


def require_sealable(phantoms: Mapping[str, Phantom]) -> None:
    """Refuse phantoms among which a code would say too much."""
    beads = [one.bead.depth_m for one in phantoms.values() if one.bead is not None]
    if len(set(beads)) < len(phantoms) or len(beads) < 2:
        raise MechanicsError(
            "phantoms: a blinded session needs two or more, all with a bead, each at another depth; "
            "correct the phantoms file"
        )


def seal(path: Path, phantoms: Mapping[str, Phantom], *, new: bool = False) -> dict[str, str]:
    """Draw new codes for phantoms and write who is who; an older file stays, and its codes hold.

    Returns:
        The phantom's own code by its new one: what to write on which sticker.
    """
    require_sealable(phantoms)
    codes: set[str] = set()
    while len(codes) < len(phantoms):
        codes.add(secrets.choice(_LETTERS) + secrets.choice(_DIGITS))
    order = sorted(codes)
    secrets.SystemRandom().shuffle(order)
    given = dict(zip(order, phantoms, strict=True))
    content = {
        "salt": secrets.token_hex(16),
        "phantoms": {code: dataclasses.asdict(phantoms[given[code]]) for code in sorted(codes)},
        "was": {code: given[code] for code in sorted(codes)},
    }
    data = sealed(SEAL, json.dumps(content).encode())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data, mode=0o600, new=True)
    except FileExistsError as error:
        if new:
            raise MechanicsError(f"{path} exists; a key is drawn once") from error
        return dict(_content(path)["was"])
    except OSError as error:
        raise MechanicsError(f"{path}: the key cannot be written: {error.strerror or error}") from error
    return given


def _content(path: str | Path) -> dict[str, Any]:
    try:
        data = read_whole(path, _LARGEST_BYTES)
        content: dict[str, Any] = json.loads(opened(SEAL, data))
    except OSError as error:
        raise MechanicsError(f"{path}: the key cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise MechanicsError(f"{path}: the key is damaged: {error}") from error
    return content


def sealed_phantoms(path: str | Path) -> dict[str, Phantom]:
    """Return the phantoms of a sealed file by their new codes: for who is touched, and who unseals."""
    found = _content(path)["phantoms"]
    return {code: Phantom(**(one | {"bead": Bead(**one["bead"])})) for code, one in found.items()}


def own_codes(path: str | Path) -> dict[str, str]:
    """Return the phantom's own code by its new one."""
    return dict(_content(path)["was"])


def digest_of(path: str | Path) -> str:
    """Return the SHA-256 of a key, in hexadecimal; as the key is salted, it reveals nothing."""
    try:
        return hashlib.sha256(read_whole(path, _LARGEST_BYTES)).hexdigest()
    except OSError as error:
        raise MechanicsError(f"{path}: the key cannot be read: {error.strerror or error}") from error
