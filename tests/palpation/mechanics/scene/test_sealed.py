"""Sealed phantoms: codes that cannot be drawn again, and a key that nothing opens by accident."""

from __future__ import annotations

import os
import random
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from palp_core.errors import MechanicsError
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import (
    is_sealed,
    own_codes,
    seal,
    sealed_phantoms,
)

PHANTOMS = {
    code: Phantom(bead=Bead(depth_m=d), modulus_pa=21e3) for code, d in (("A", 0.002137), ("B", 0.00419))
}


def test_a_key_reads_as_the_phantoms_under_their_new_codes(tmp_path: Path) -> None:
    key = tmp_path / "key"
    given = seal(key, PHANTOMS)
    found = sealed_phantoms(key)
    assert list(found) == sorted(given)
    assert {given[code]: phantom for code, phantom in found.items()} == PHANTOMS
    assert own_codes(key) == given
    assert not {*given} & {*PHANTOMS}
    assert key.stat().st_mode & 0o077 == 0


def test_nothing_in_the_key_can_be_read_by_eye(tmp_path: Path) -> None:
    key = tmp_path / "key"
    seal(key, PHANTOMS)
    assert is_sealed(key)
    for word in (b"0.002137", b"2.137", b"depth", b"bead"):
        assert word not in key.read_bytes().partition(b"\n")[2]


def test_a_pipe_in_the_place_of_phantoms_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    with pytest.raises(MechanicsError, match="cannot read the phantoms: it is a pipe, not a file"):
        load_phantoms(str(pipe))


def test_sealing_again_gives_the_codes_of_the_first_time(tmp_path: Path) -> None:
    first = seal(tmp_path / "key", PHANTOMS)
    assert seal(tmp_path / "key", PHANTOMS) == first
    with pytest.raises(MechanicsError, match="exists; a key is drawn once"):
        seal(tmp_path / "key", PHANTOMS, new=True)
    assert [path.name for path in tmp_path.iterdir()] == ["key"]


def test_the_place_of_a_phantom_among_the_codes_does_not_follow_a_seed(tmp_path: Path) -> None:
    places: Counter[int] = Counter()
    for number in range(100):
        random.seed(1)
        np.random.seed(1)  # noqa: NPY002 - a global seed must not be followed
        given = seal(tmp_path / f"key{number}", PHANTOMS)
        places[sorted(given, key=str).index(next(code for code, own in given.items() if own == "A"))] += 1
    assert 20 < places[0] < 80  # six standard deviations of a fair coin


def test_what_cannot_be_blinded_and_what_is_damaged_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MechanicsError, match="each at another depth"):
        seal(tmp_path / "key", {"A": PHANTOMS["A"], "B": PHANTOMS["A"]})
    with pytest.raises(MechanicsError, match="a bead"):
        seal(tmp_path / "key", {"A": PHANTOMS["A"], "bare": Phantom()})
    seal(tmp_path / "key", PHANTOMS)
    (tmp_path / "key").write_bytes((tmp_path / "key").read_bytes()[:-20])
    with pytest.raises(MechanicsError, match="the key is damaged"):
        sealed_phantoms(tmp_path / "key")
