"""The faces of the library: their names are there, and nothing loads that is not used."""

from __future__ import annotations

from types import ModuleType

import pytest

import palp_core
import palp_core.palpation

FACES = pytest.mark.parametrize("face", [palp_core, palp_core.palpation], ids=lambda face: face.__name__)


@FACES
def test_everything_can_be_imported_at_once_and_is_listed(face: ModuleType) -> None:
    names: dict[str, object] = {}
    exec(f"from {face.__name__} import *", names)
    assert set(face.__all__) <= set(names)
    assert set(face.__all__) <= set(dir(face))


@FACES
def test_a_misspelt_name_gets_the_nearest(face: ModuleType) -> None:
    for name in face.__all__:
        with pytest.raises(AttributeError, match=f"no attribute '{name}x'; did you mean '"):
            getattr(face, f"{name}x")
    with pytest.raises(ImportError, match="cannot import name 'Nothing'"):
        exec(f"from {face.__name__} import Nothing")
