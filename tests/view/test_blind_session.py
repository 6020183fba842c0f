"""A real blinded session whose key lies elsewhere: what its folder and its bag tell before it is unsealed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import pytest

from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import seal
from palp_core.palpation.session.operating.unsealing import unseal
from palp_core.palpation.session.trials_csv import read_rows
from palp_core.view.source.sealed import sealed_within
from tests.support.palp import SIM, Palp
from tests.support.rig_session import ComposedGraph
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer, PageSocket

TELLING = (
    *(
        "torque_n_m",
        "peak_n_m",
        "depth_m",
        "estimate_m",
        "posterior",
        "confidence",
        "Right so far",
        "mm deep",
    ),
    *("trials.csv", "primitives.json", "run.json"),
)
"""Fields, panels and files that only a session in the open has on its pages."""


class Blinded:
    """A session, its bag in its folder, and its key somewhere else."""

    def __init__(self, folder: Path) -> None:
        self.out, self.bag, self.key = folder / "out", folder / "out" / "bag", folder / "key.sealed"
        seal(self.key, load_phantoms(""))
        given = {"policy": "fixed", "rings_mm": "8, 16", "training": 2, "trials": 1, "blind": True}
        with ComposedGraph(SIM, phantoms=self.key, out=self.out, record=folder / "bag", **given) as graph:
            assert graph.run().exit_code == 0
        shutil.move(folder / "bag", self.bag)

    def secrets(self) -> Iterator[str]:
        """What was felt, and what stands for depths and estimates, as text."""
        for row in read_rows(self.out):
            yield f"{row.peak_n_m:.6f}"
            yield f"{1e3 * row.peak_n_m:.3f}"
            if row.posterior:
                yield from (f"{one:.4f}" for one in row.posterior if 0.001 < one < 0.999)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Blinded:
    return Blinded(tmp_path_factory.mktemp("elsewhere"))


def test_of_its_folder_and_all_around_it_nothing_is_shown_before_it_is_unsealed(
    session: Blinded, tmp_path: Path
) -> None:
    out = Path(shutil.copytree(session.out, tmp_path / "study" / "S1" / "out"))
    assert not list(tmp_path.rglob("*.sealed"))
    for folder in (tmp_path, out.parent, out, out / "bag"):
        assert sealed_within(folder) == out
    unseal(out, "all is done", session.key)
    assert (sealed_within(out), sealed_within(tmp_path)) == (None, None)


def test_a_session_in_the_open_beside_it_is_shown_by_itself(session: Blinded, tmp_path: Path) -> None:
    shutil.copytree(session.out, tmp_path / "blinded")
    (tmp_path / "open").mkdir()
    (tmp_path / "open" / "run.json").write_text('{"params": {"phantom": {"blind": false}}}', encoding="utf-8")
    assert sealed_within(tmp_path / "open") is None
    assert sealed_within(tmp_path) == tmp_path / "blinded"


def test_a_table_that_was_copied_alone_is_shown_no_more_than_the_session(
    session: Blinded, tmp_path: Path
) -> None:
    """Codes for depths and estimates stand side by side in it: they tell what was right."""
    copied = tmp_path / "mine" / "S1.csv"
    copied.parent.mkdir()
    shutil.copy(session.out / "trials.csv", copied)
    assert (sealed_within(tmp_path), sealed_within(copied.parent)) == (copied.parent, copied.parent)


TABLES = {
    "depths": "trial,depth_m,estimate_m\n1,0.004,0.004\n",
    "nobody told": "trial,depth_m\n1,\n2,deep\n",
    "no such column": "trial,row\n1,100\n",
    "no table": "\0\0\n",
    "empty": "",
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_a_table_of_depths_or_of_anything_else_is_shown(text: str, tmp_path: Path) -> None:
    (tmp_path / "trials.csv").write_text(text, encoding="utf-8")
    assert sealed_within(tmp_path) is None


NOTES = {"no JSON": "{", "no run": "[1]", "no nodes": '{"params": 3}', "odd nodes": '{"params": {"a": 4}}'}


@pytest.mark.parametrize("text", NOTES.values(), ids=NOTES)
def test_what_is_no_note_of_a_run_hides_nothing_and_breaks_nothing(text: str, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(text, encoding="utf-8")
    assert sealed_within(tmp_path) is None


def test_a_pipe_in_place_of_the_note_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.json")
    (tmp_path / "report.html").touch()
    assert sealed_within(tmp_path) is None


def test_nothing_that_the_pages_of_its_bag_are_sent_tells_depth_or_accuracy(
    session: Blinded, shared_palp: Palp
) -> None:
    server = PageServer(address_of(shared_palp.start("view", session.bag, "--no-browser")))
    pages = ("/", "/topics", "/topic/phantom/contact", "/topic/estimator/belief", "/node/estimator")
    said = [server.ask(f"/{server.token}{path}").body.decode() for path in pages]
    with closing(PageSocket(server, "/own")) as page:
        page.says("The session is blinded")
        page.event(page.labelled("time in the bag"), "update:", 1e9)
        page.says("the session is over: 3 of 3 trials done")
        assert told([*said, *page.received], session) == []


def told(said: Sequence[str], session: Blinded) -> list[str]:
    """Return which secrets there are in what was sent."""
    return [secret for secret in (*TELLING, *session.secrets()) if any(secret in one for one in said)]
