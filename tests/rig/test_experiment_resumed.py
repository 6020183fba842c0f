"""The experiment goes on with devices that have begun anew: no trial is lost, and none is there twice."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from msgs.experiment import Mount, Trial
from nodes.experiment import Experiment
from palp_core import Bench
from palp_core.errors import NodeError
from palp_core.palpation.session.trials_csv import Row, read_rows, read_sweep
from tests.nodes.test_experiment import Rig, params_in, run
from tests.palpation.session.test_trials_csv import full_after
from tests.support.kept import Kept, go_on


def interrupted(out: Path, steps: int, **params: object) -> tuple[Bench[Experiment], bytes]:
    """Run so many requests; return the experiment, and what was kept of it as the last trial began."""
    bench = Bench(Experiment, params_in(out, **params))
    kept, rig = Kept(bench, "/node/trial"), Rig(bench)
    for _ in range(steps):
        rig.run(1)
        kept.turn()
    bench.node.record.close()  # as the end of its process does
    return bench, kept.node


def resumed(out: Path, kept: bytes, **params: object) -> Rig:
    return Rig(go_on(Experiment, params_in(out, **params), kept))


def trials_of(rows: list[Row]) -> dict[int, tuple[str, str, int]]:
    """Return phase, phantom and number of palpations of each trial."""
    counts = Counter(row.trial for row in rows)
    return {row.trial: (row.phase, row.phantom, counts[row.trial]) for row in rows}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Row]]:
    """What a session keeps that is not interrupted, by when the ring is re-homed."""
    folders = {mode: tmp_path_factory.mktemp(mode) for mode in ("trial", "never")}
    return {mode: read_rows(run(out, rehome=mode).bench.node.record.folder) for mode, out in folders.items()}


@pytest.mark.parametrize("mode", ["trial", "never"])
@pytest.mark.parametrize("steps", [3, 4, 5, 6, 7, 60, 121, 128, 131, 136])
def test_no_trial_is_lost_or_there_twice(
    steps: int, mode: str, whole: dict[str, list[Row]], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    _, kept = interrupted(out, steps, rehome=mode)
    before = read_rows(out)
    rig = resumed(out, kept, rehome=mode)
    rig.run()
    assert rig.bench.executor.exit_code == 0
    rows = read_rows(out)
    assert trials_of(rows) == trials_of(whole[mode])
    assert [row.row for row in rows] == list(range(len(rows)))
    assert all(len(read_sweep(out, row.row)[0]) for row in rows)
    assert sum(row.verdict not in ("", "continue") for row in rows) == 6
    cut = read_rows(out / "interrupted" / "1") if (out / "interrupted").exists() else []
    assert [row for row in before if row not in cut] == rows[: len(before) - len(cut)]
    assert len({row.trial for row in cut}) <= 1  # the one that had begun last


def test_the_phantom_is_put_on_again_and_the_trial_begun_again(tmp_path: Path) -> None:
    first, kept = interrupted(tmp_path, 128)
    state = first.node.state
    assert state.phase == "estimation"
    rig = resumed(tmp_path, kept)
    rig.run(3)
    mount, home, trial = rig.asked
    assert isinstance(mount, Mount)
    assert (mount.code, mount.remount) == (state.code, state.remount + 1)
    assert getattr(home, "rehome", False)
    assert isinstance(trial, Trial)
    assert (trial.trial, trial.phase) == (state.trial, "estimation")


def test_what_measures_a_rig_that_is_not_touched_cannot_go_on(tmp_path: Path) -> None:
    _, kept = interrupted(tmp_path, 6, plan="repeatability", trials=0, training=1)
    table = (tmp_path / "trials.csv").read_bytes()
    with pytest.raises(NodeError, match="devices that have started again; start it again, too"):
        resumed(tmp_path, kept, plan="repeatability", trials=0, training=1)
    assert (tmp_path / "trials.csv").read_bytes() == table


def test_a_table_that_lacks_palpations_is_refused(tmp_path: Path) -> None:
    _, kept = interrupted(tmp_path, 60)
    table = tmp_path / "trials.csv"
    lines = table.read_bytes().splitlines(keepends=True)
    table.write_bytes(b"".join(lines[:5]))
    with pytest.raises(NodeError, match=r"it has 4 palpations, and the session had come to \d+; restore"):
        resumed(tmp_path, kept)
    assert table.read_bytes() == b"".join(lines[:5])
    table.write_bytes(b"".join(lines))
    rig = resumed(tmp_path, kept)  # the refusal has cost nothing
    rig.run()
    assert rig.bench.executor.exit_code == 0


def test_what_cannot_be_written_stops_the_session_and_costs_nothing(
    whole: dict[str, list[Row]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    _, kept = interrupted(out, 60)
    rig = resumed(out, kept)
    count = len(read_rows(out))
    room = 3 * max(map(len, (out / "trials.csv").read_bytes().splitlines()))
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full_after(room))
        with pytest.raises(NodeError, match="No space left on device; the") as told:
            rig.run()
    rows = read_rows(out)
    assert len(rows) > count
    assert f"palpation {len(rows) + 1} cannot be written to '{out}'" in str(told.value)
    assert f"the {len(rows)} palpations before are kept there" in str(told.value)
    assert all(len(read_sweep(out, row.row)[0]) for row in rows)
    rig.bench.node.record.close()
    resumed(out, kept).run()
    assert trials_of(read_rows(out)) == trials_of(whole["trial"])
