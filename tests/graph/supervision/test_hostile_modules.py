"""What a module does to the process that imports it is said of its node, and the others are looked at."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.graph.description.node_class import NodeClassRequest
from palp_core.graph.supervision.fork_server import ForkServer
from tests.graph.description.test_hostile_files import ENDINGS, GUEST


@pytest.fixture(scope="module")
def server() -> Iterator[ForkServer]:
    made = ForkServer()
    yield made
    made.close()


@pytest.mark.parametrize("name", ENDINGS)
def test_a_module_that_ends_its_process_is_named_and_the_others_are_looked_at(
    server: ForkServer, tmp_path: Path, name: str
) -> None:
    folder, (statement, words) = tmp_path / "nodes", ENDINGS[name]
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "odd.py").write_text(f"{statement}\n{GUEST}")
    (folder / "fine.py").write_text(GUEST)
    runs = ("nodes.fine:Odd", "nodes.odd:Odd", "nodes.fine:Odd", "nodes.odd:Odd")
    found = server.inspect_classes([NodeClassRequest(run) for run in runs], tmp_path, tmp_path)
    assert [answer.run for answer in found] == list(runs)
    errors = [answer.error for answer in found]
    assert errors == [None, words.format(module=folder / "odd.py")] * 2
