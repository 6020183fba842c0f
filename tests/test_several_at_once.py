"""Files that several commands may make: of eight processes at once none spoils what another writes."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.cli.session.sheet import new as new_sheet
from palp_core.cli.workspace.new import write_new
from palp_core.errors import PalpError
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.discovery.run_directory import RunDirectory
from palp_core.graph.network.keys import KeyFolder
from palp_core.palpation.mechanics.contact.cache import cached
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import own_codes, seal
from palp_core.palpation.session.audit import decide, decisions
from palp_core.palpation.session.session_folder import link_latest
from palp_core.whole_file import write_whole

PROCESSES, ROUNDS = 8, 3


def audit(folder: Path, number: int) -> None:
    decide(folder, ("estimation", number), "exclude", "why")


def keys(folder: Path, number: int) -> None:
    KeyFolder(folder / "keys").generate(f"host{number % 2}")


def allowed(folder: Path, number: int) -> None:
    KeyFolder(folder / "keys").allow(f"{number}".rjust(40, "a"), "friend")


def key(folder: Path, number: int) -> str:
    return ",".join(sorted(seal(folder / "key", load_phantoms(""))))


def sheet(folder: Path, number: int) -> None:
    new_sheet(folder / "session.yaml")


def sources(folder: Path, number: int) -> None:
    write_new(folder, {Path("nodes/a.py"): f"{number}" * 1000, Path("tests/test_a.py"): f"{number}" * 1000})


def bag(folder: Path, number: int) -> None:
    BagWriter(folder / "bag").close()


def runs(folder: Path, number: int) -> str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        run = RunDirectory("graph")
    run.release()
    return run.path.name


def entry(folder: Path, number: int) -> str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PALP_CACHE", str(folder))
        found = cached("kind", {"a": 1}, lambda: {"number": np.full(1000, number)})
    return ",".join(map(str, np.unique(found["number"])))


def whole(folder: Path, number: int) -> None:
    write_whole(folder / "page.html", f"{number}" * 100_000)


def latest(folder: Path, number: int) -> None:
    run = folder / "2026-01-01_00-00-00"
    run.mkdir(exist_ok=True)
    link_latest(run)


def all_decisions(folder: Path, found: list[str]) -> bool:
    return sorted(one.trial for one in decisions(folder)) == list(range(PROCESSES))


def one_pair(folder: Path, found: list[str]) -> bool:
    own = KeyFolder(folder / "keys").own()
    return (
        own is not None
        and own.public in (folder / f"keys/{own.name}.public").read_text()
        and one(folder, found)
    )


def one_friend(folder: Path, found: list[str]) -> bool:
    return len(KeyFolder(folder / "keys").allowed()) == 1 and one(folder, found)


def one_key(folder: Path, found: list[str]) -> bool:
    return set(found) == {",".join(sorted(own_codes(folder / "key")))}


def one(folder: Path, found: list[str]) -> bool:
    return Counter(words.startswith("refused") for words in found) == {False: 1, True: PROCESSES - 1}


def one_source(folder: Path, found: list[str]) -> bool:
    return len({(folder / name).read_text() for name in ("nodes/a.py", "tests/test_a.py")}) == 1 and one(
        folder, found
    )


def all_different(folder: Path, found: list[str]) -> bool:
    return len(set(found)) == PROCESSES


def all_the_same(folder: Path, found: list[str]) -> bool:
    return len(set(found)) == 1


def a_whole_page(folder: Path, found: list[str]) -> bool:
    text = (folder / "page.html").read_text()
    return len(text) == 100_000 and len(set(text)) == 1 and [*folder.glob(".*.part")] == []


def a_link(folder: Path, found: list[str]) -> bool:
    return (folder / "latest").readlink() == Path("2026-01-01_00-00-00")


MAKERS: list[tuple[Callable[[Path, int], Any], Callable[[Path, list[str]], bool]]] = [
    (audit, all_decisions),
    (keys, one_pair),
    (allowed, one_friend),
    (key, one_key),
    (sheet, one),
    (sources, one_source),
    (bag, one),
    (runs, all_different),
    (entry, all_the_same),
    (whole, a_whole_page),
    (latest, a_link),
]


@pytest.mark.parametrize(("make", "holds"), [pytest.param(*row, id=row[0].__name__) for row in MAKERS])
def test_of_eight_processes_at_once_none_spoils_what_another_writes(
    make: Callable[[Path, int], Any], holds: Callable[[Path, list[str]], bool], tmp_path: Path
) -> None:
    forks = multiprocessing.get_context("fork")
    for number in range(ROUNDS):
        folder = tmp_path / str(number)
        folder.mkdir()
        begin, results = forks.Barrier(PROCESSES), forks.SimpleQueue()

        def work(place: int, folder: Path = folder, begin: Any = begin, results: Any = results) -> None:
            begin.wait()
            try:
                results.put(make(folder, place) or "made")
            except (PalpError, FileExistsError) as error:
                results.put(f"refused: {error}")
            except Exception as error:  # noqa: BLE001 - a process that fails is waited for no longer
                results.put(repr(error))

        processes = [forks.Process(target=work, args=(place,)) for place in range(PROCESSES)]
        for process in processes:
            process.start()
        found = [results.get() for _ in processes]
        for process in processes:
            process.join()
        assert holds(folder, found), found
