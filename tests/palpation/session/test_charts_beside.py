"""Charts that a second process draws: the same, whether it lives or dies, and it outlives nobody."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from palp_core.graph.supervision.fork_start import SHARES_CORES
from palp_core.palpation.reporting.charts import Chart, images
from palp_core.palpation.session import report, run_note
from palp_core.palpation.session.charts import of_session
from palp_core.palpation.session.charts.beside import WORTH_TRIALS, ChartsBeside, worth_it
from palp_core.palpation.session.charts.of_session import charts_of
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.result_json import build, write_result
from tests.support.sessions import describe, writer

TRIALS = [(0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]), (1, [[0.2, 0.6, 0.2]])]


@pytest.fixture
def beside() -> Iterator[ChartsBeside]:
    started = ChartsBeside()
    yield started
    started.close()


def test_every_other_chart_is_drawn_beside_and_is_the_same(tmp_path: Path, beside: ChartsBeside) -> None:
    out = writer(tmp_path)()
    run_note.note_end(describe(out))
    write_result(build(read_session(out), describe(out)), out)
    beside.begin(out)
    charts = charts_of(out)
    image, vector = images(charts[1])
    assert beside.finished()
    drawn = {path.name for path in (out / "charts").iterdir()}
    assert drawn == {f"{chart.name}.{kind}" for chart in charts[1::2] for kind in ("png", "svg", "csv")}
    assert (out / "charts" / f"{charts[1].name}.png").read_bytes() == image
    assert (out / "charts" / f"{charts[1].name}.svg").read_bytes() == vector


def test_what_is_not_drawn_beside_is_drawn_here_in_the_order_of_the_page(
    tmp_path: Path, beside: ChartsBeside, monkeypatch: pytest.MonkeyPatch
) -> None:
    charts = [Chart(name, name, "", 1.0, ("x",), ((1.0,),), lambda _: None) for name in ("a", "b", "c")]
    monkeypatch.setattr(of_session, "charts", lambda *_: charts)
    beside.close()
    out = writer(tmp_path)(trials=TRIALS)
    pictures = report._pictures(read_session(out), describe(out), {}, beside)
    assert [picture.name for picture in pictures] == ["a", "b", "c"]
    assert all((out / "charts" / name).exists() for picture in pictures for name in picture.files)


def test_it_dies_with_the_run_that_it_draws_for() -> None:
    code = (
        "from palp_core.palpation.session.charts.beside import ChartsBeside as C; c = C();"
        "print(c._process.pid, flush=True); input()"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert run.stdout is not None
    drawing = os.pidfd_open(int(run.stdout.readline()))
    run.kill()
    run.communicate()
    assert select.select([drawing], [], [], 20.0)[0]
    os.close(drawing)


def test_a_short_run_one_among_many_and_one_on_a_single_core_start_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.delenv(SHARES_CORES, raising=False)
    short = describe(tmp_path, composed=True)
    long = msgspec.structs.replace(short, args=short.args | {"trials": WORTH_TRIALS})
    assert worth_it(long)
    assert not worth_it(short)
    assert not worth_it(msgspec.structs.replace(long, composed=False))
    monkeypatch.setenv(SHARES_CORES, "1")
    assert not worth_it(long)
    monkeypatch.delenv(SHARES_CORES)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1})
    assert not worth_it(long)
