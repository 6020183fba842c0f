"""A session with a person goes on where it was interrupted; operator and amplifier begin again."""

from __future__ import annotations

from pathlib import Path

import pytest

from nodes.human.session import HumanSession
from palp_core.errors import NodeError, PalpError
from palp_core.palpation.session.human.blinding import unseal
from palp_core.palpation.session.human.questions import QUESTION
from palp_core.palpation.session.human.record import HUMAN_TABLE, HumanRow, read_human, refuse_human
from tests.nodes.human.test_human_session import Lab
from tests.support.kept import Kept, go_on


def whole_trial(lab: Lab) -> None:
    lab.trial()
    if lab.prompt.text.startswith(QUESTION):
        assert lab.say("4").taken


def interrupted(out: Path, trials: int) -> bytes:
    """Make so many trials and most of another; return what was kept after the last whole one."""
    lab = Lab(out)
    kept = Kept(lab.bench, "/node/result")
    lab.calibrate()
    for _ in range(trials):
        whole_trial(lab)
        kept.turn()
    lab.trial()
    lab.bench.node.record.close()  # as the end of its process does
    return kept.node


def resumed(out: Path, kept: bytes) -> Lab:
    lab = Lab(out, active=False)
    lab.bench = go_on(HumanSession, lab.bench.executor.spec.params, kept)
    return lab


def shown(rows: list[HumanRow]) -> list[tuple[int, int, str, str, str]]:
    return [(one.row, one.trial, one.phase, one.phantom, one.emg) for one in rows]


@pytest.mark.parametrize("trials", [1, 2, 3, 4, 5])
def test_no_trial_is_lost_or_there_twice(trials: int, tmp_path: Path) -> None:
    whole = Lab(tmp_path / "whole")
    whole.calibrate()
    for _ in range(6):
        whole_trial(whole)
    out = tmp_path / "out"
    kept = interrupted(out, trials)
    before = {path: path.read_bytes() for path in (out / "emg").rglob("*.npz")}
    lab = resumed(out, kept)
    assert lab.bench.sent(HumanSession.cue)[0].phase == "pause"
    assert "Give phantom" in lab.prompt.text
    for _ in range(6 - trials):
        whole_trial(lab)
    assert "over" in lab.prompt.text
    assert shown(read_human(out)) == shown(read_human(tmp_path / "whole"))
    kept_aside = [path.relative_to(out / "interrupted/1") for path in (out / "interrupted").rglob("*.npz")]
    assert [path.parts[:2] for path in kept_aside] == [("emg", "S01")]
    assert (out / "interrupted/1" / kept_aside[0]).read_bytes() == before[out / kept_aside[0]]
    same = {path for path, data in before.items() if path.read_bytes() == data}
    assert before.keys() - same == {out / kept_aside[0]}
    assert {"rest.npz", "mvc.npz"} <= {path.name for path in same}


def test_what_lacks_trials_or_goes_on_already_is_not_gone_on_with(tmp_path: Path) -> None:
    out = tmp_path / "out"
    kept = interrupted(out, 2)
    lines = (out / HUMAN_TABLE).read_text().splitlines(keepends=True)
    (out / HUMAN_TABLE).write_text("".join(lines[:2]))
    with pytest.raises(NodeError, match="it has 1 trial, and the session had come to 2"):
        resumed(out, kept)
    (out / HUMAN_TABLE).write_text("".join(lines))
    lab = resumed(out, kept)
    with pytest.raises(NodeError, match="another session is writing"):
        resumed(out, kept)
    with pytest.raises(PalpError, match="unsealed when it is over"):
        unseal(out, "too early")
    lab.bench.node.record.close()
    with pytest.raises(PalpError, match="never overwritten"):
        refuse_human(out)
