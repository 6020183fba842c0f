"""What a module does to the process that imports it is said of its node, and the others are looked at."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.graph.description.node_class import NodeClassRequest
from palp_core.graph.supervision import class_inspection
from palp_core.graph.supervision.fork_server import ForkServer
from tests.graph.description.test_hostile_files import ENDINGS, GUEST
from tests.support.supervised import write_files

FINE = {"nodes/__init__.py": "", "nodes/fine.py": GUEST}


@pytest.fixture(scope="module")
def server() -> Iterator[ForkServer]:
    made = ForkServer()
    yield made
    made.close()


@pytest.mark.parametrize("name", ENDINGS)
def test_a_module_that_ends_its_process_is_named_and_the_others_are_looked_at(
    server: ForkServer, tmp_path: Path, name: str
) -> None:
    statement, words = ENDINGS[name]
    write_files(tmp_path, FINE | {"nodes/odd.py": f"{statement}\n{GUEST}"})
    runs = ("nodes.fine:Odd", "nodes.odd:Odd", "nodes.fine:Odd", "nodes.odd:Odd")
    found = server.inspect_classes([NodeClassRequest(run) for run in runs], tmp_path)
    assert [answer.run for answer in found] == list(runs)
    errors = [answer.error for answer in found]
    assert errors == [None, words.format(module=tmp_path / "nodes/odd.py")] * 2


LOOPS = {
    "works": ("x = 0\nwhile True: x += 1", "nodes/odd.py:2: "),
    "waits": ("import threading\nthreading.Event().wait()", "nodes/odd.py:2: "),
    "is stopped": (
        "import os, signal\nos.kill(os.getpid(), signal.SIGSTOP)\nwhile True: pass",
        "nodes/odd.py:",
    ),
    "looks for a module again and again": (
        "while True:\n  try: import nowhere\n  except ImportError: pass",
        "nodes/odd.py:",
    ),
    "is deaf": (
        "import faulthandler, signal\nfaulthandler.disable()\nsignal.signal(signal.SIGABRT, signal.SIG_IGN)\n"
        "while True: pass",
        "importing this",
    ),
    "has begun a line": ("print('at it: ', end='', flush=True)\nwhile True: pass", "nodes/odd.py:2: "),
    "has another sys.stderr": (
        "import io, os, sys\nsys.stderr = io.StringIO()\nos.dup2(os.open(os.devnull, os.O_WRONLY), 2)\n"
        "import shelve\nwhile True: pass",
        "importing this",
    ),
}
CHEAP = ("works", "is stopped", "has begun a line")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in CHEAP else pytest.mark.nightly) for name in LOOPS]
)
def test_a_module_whose_import_has_no_end_is_named_and_its_process_killed(
    server: ForkServer, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(class_inspection, "IMPORT_TIMEOUT_S", 1.0)
    statement, words = LOOPS[name]
    write_files(tmp_path, FINE | {"nodes/odd.py": f"{statement}\n{GUEST}"})
    requests = [NodeClassRequest("nodes.odd:Odd"), NodeClassRequest("nodes.fine:Odd")]
    found = server.inspect_classes(requests, tmp_path)
    first, second = (answer.error or "" for answer in found)
    assert first == second  # what is said of all that were not looked at is said once
    assert first.startswith(words)
    assert "importing this does not come to an end (nothing happened for 1 s)" in first
    assert server.inspect_classes(requests[1:], tmp_path)[0].error is None
