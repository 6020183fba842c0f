"""A digest says whether a method's code is what it was."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.methods import Method, find, methods
from palp_core.palpation.studies.tradeoff import source
from palp_core.palpation.studies.tradeoff.source import method_digest

ROOM = {
    "__init__.py": "",
    "law.py": "from a_room import part, part_bounds\n"
    "from a_room.hall.far import FAR\ndef law():\n    return part.HALF\n",
    "part.py": "HALF = 0.5\n",
    "part_bounds.py": "BOUNDS = 1\n",
    "other.py": "SOME = 1\n",
    "hall/__init__.py": "",
    "hall/far.py": "FAR = 1\n",
    "../a_law.py": "import a_part, json, numpy\ndef law():\n    return a_part.HALF\n",
    "../a_part.py": "HALF = 0.5\n",
}


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "a_room"
    for name, text in ROOM.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] in ("a_room", "a_law", "a_part")]:
        del sys.modules[name]
    forget()


def forget() -> None:
    for cached in (source._room, source._tree, source._imports, source._is_module, source._code):
        cached.cache_clear()


def digest(module: str = "a_room.law") -> str:
    forget()
    law = importlib.import_module(module).law
    return method_digest(Method("t", "law", law, 1.0, (), "", {}, "", ""))


@pytest.mark.parametrize(
    ("file", "text", "changes"),
    [
        ("law.py", ROOM["law.py"].replace("HALF", "HALF + 0"), True),
        ("part.py", "HALF = 0.25\n", True),
        ("part.py", '"""Words."""\n\n# more of them\nHALF   =  (0.5)\n', False),
        ("law.py", ROOM["law.py"].replace("law():\n", 'law():\n    """Words."""\n'), False),
        ("part_bounds.py", "BOUNDS = 2\n", False),
        ("other.py", "SOME = 2\n", False),
        ("hall/far.py", "FAR = 2\n", False),
    ],
)
def test_it_changes_with_the_code_of_its_room_and_not_with_words(
    file: str, text: str, changes: bool, room: Path
) -> None:
    before = digest()
    (room / file).write_text(text, encoding="utf-8")
    assert (digest() != before) is changes


def test_the_room_of_a_module_outside_any_package_is_its_folder(room: Path) -> None:
    before = digest("a_law")
    (room.parent / "a_part.py").write_text("HALF = 0.25\n", encoding="utf-8")
    assert digest("a_law") != before
    assert source._code.cache_info().misses == 2  # neither of numpy nor of Python's own library


def test_a_rung_has_what_it_imports_in_its_room_and_rungs_differ() -> None:
    digests = [method_digest(one) for one in methods("contact")]
    assert len(set(digests)) == len(digests)
    assert "palp_core.palpation.mechanics.contact.bead_term" in source._imports(find("contact", "l4").module)
