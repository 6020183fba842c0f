"""The node that leads a person: what it asks, takes for an answer and keeps, and how it resumes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msgs.operator import AnswerReply, AnswerRequest, Prompt
from nodes.human.params import HumanParams
from nodes.human.session import HumanSession
from palp_core import Bench
from palp_core.errors import NodeError, PalpError
from palp_core.palpation.session.human.blinding import unseal
from palp_core.palpation.session.human.questions import AGAIN, IDENTITY, QUESTION
from palp_core.palpation.session.human.record import HUMAN_TABLE, HumanRow, read_human, refuse_human
from tests.support.kept import Kept, go_on, replace
from tests.support.rig_messages import emg_block

RATE_HZ, BLOCK_S = 1500.0, 0.1
STRENGTH_V = {"rest": 1e-6, "mvc": 300e-6, "palpation": 100e-6, "pause": 1e-6}


class Lab:
    """A session on a bench with an amplifier and an operator, both in the test's hands."""

    def __init__(self, out: Path, *, active: bool = True, **params: Any) -> None:
        self.out = out
        self.rng = np.random.default_rng(1)
        given = {
            "out": str(out),
            "order": "counterbalanced",
            "repeats": 1,
            "rest_s": 0.0,
            "mvc_s": 1.0,
            "quiet_s": 1.0,
        }
        who = {"subject": "S01", "consent": "C-1"}
        self.bench = Bench(HumanSession, given | who | params, active=active)
        self.gain = 1.0

    @property
    def prompt(self) -> Prompt:
        return self.bench.sent(HumanSession.prompt)[-1]

    def say(self, text: str = "", number: int | None = None) -> AnswerReply:
        asked = self.prompt.number if number is None else number
        return self.bench.call(HumanSession.answer, AnswerRequest(number=asked, text=text, by="terminal"))

    def go(self, seconds: float) -> None:
        """Let time pass, with EMG of whatever is cued."""
        for _ in range(round(seconds / BLOCK_S)):
            start_ns, phase = self.bench.clock.now_ns(), self.bench.sent(HumanSession.cue)[-1].phase
            count = round(BLOCK_S * RATE_HZ)
            volts = self.gain * STRENGTH_V[phase] * self.rng.standard_normal((2, count))
            if self.gain > 1.0 and phase == "mvc":
                volts = np.clip(volts, -400e-6, 400e-6)
            self.bench.advance(BLOCK_S)
            self.bench.feed(HumanSession.emg, emg_block(start_ns, phase, *volts))

    def calibrate(self) -> None:
        for _ in ("rest", "mvc"):
            assert self.say().taken
            self.go(1.3)

    def trial(self, seconds: float = 1.0, ending: str = "") -> None:
        assert self.say().taken
        self.go(seconds)
        assert self.say(ending).taken
        self.go(0.3)


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path / "out")


def test_who_it_is_is_asked_and_a_name_is_refused_in_words_that_do_not_repeat_it(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out", subject="", consent="")
    assert lab.prompt.text == IDENTITY["consent"]
    assert not lab.say("").taken
    assert lab.say("C-17").taken
    assert lab.prompt.text == IDENTITY["subject"]
    refused = lab.say("Anna Mueller")
    assert not refused.taken
    assert "code" in refused.text
    assert "Anna" not in refused.text
    assert lab.say("S07").taken
    assert "muscles at rest" in lab.prompt.text
    assert "S07" in (lab.out / "identity.json").read_text()


def test_a_name_in_the_launch_file_is_refused_before_anything_starts() -> None:
    found = HumanSession.examine(HumanParams(subject="Anna", consent="C-1"))
    assert found.keys() == {"subject"}
    assert "looks like a name" in found["subject"]
    assert "Anna" not in found["subject"]


def test_a_whole_session_is_asked_answered_and_kept(lab: Lab) -> None:
    lab.calibrate()
    for _ in range(3):
        assert "tell the subject" in lab.prompt.text
        lab.trial()
    for _ in range(3):
        assert "blindfolded" in lab.prompt.text
        lab.trial()
        assert lab.prompt.text.startswith(QUESTION)
        assert lab.prompt.choices == ["2", "4", "8"]
        assert not lab.say("3").taken
        lab.go(0.5)
        assert lab.say("4 mm").taken
    assert lab.bench.sent(HumanSession.progress)[-1].score_defined is False
    rows = read_human(lab.out)
    assert [(one.phase, one.trial) for one in rows] == [
        (p, n) for p in ("training", "estimation") for n in (1, 2, 3)
    ]
    assert [one.estimate_m for one in rows] == [None] * 3 + [0.004] * 3
    assert [one.answer_s for one in rows][3:] == pytest.approx([0.7] * 3)  # 0.2 s of it while the lab rests
    assert [one.palpation_s for one in rows] == pytest.approx([1.0] * 6)
    assert {one.answered_by for one in rows} == {"terminal"}
    for one in rows:
        with np.load(lab.out / one.emg) as kept:
            assert kept["fds_v"].shape == (1500,)
            assert np.std(kept["edc_v"]) == pytest.approx(100e-6, rel=0.1)
    assert {path.name for path in (lab.out / "emg/S01").iterdir()} == {
        "rest.npz",
        "mvc.npz",
        "training",
        "estimation",
    }


def test_a_trial_ends_by_itself_after_its_limit_with_a_countdown(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out", limit_s=3.0)
    lab.calibrate()
    assert lab.say().taken
    begun = lab.prompt.number
    assert lab.prompt.ends_ns == lab.bench.clock.now_ns() + 3_000_000_000
    lab.go(3.5)
    (row,) = read_human(lab.out)
    assert row.ended_by == "limit"
    assert row.palpation_s == pytest.approx(3.0)
    left = [one.left_s for one in lab.bench.sent(HumanSession.countdown) if one.what == "palpation"]
    assert left == sorted(left, reverse=True)
    assert {round(one) for one in left} >= {1, 2, 3}
    assert not lab.say("", number=begun).taken  # an Enter that came too late ends nothing else


def test_a_clipped_contraction_is_repeated_and_not_used(lab: Lab) -> None:
    assert lab.say().taken
    lab.go(1.3)
    lab.gain = 3.0
    assert lab.say().taken
    lab.go(1.3)
    assert lab.bench.sent(HumanSession.bars)[-1].clipped
    assert "attempt 2" in lab.prompt.text
    assert not (lab.out / "emg/S01/mvc.npz").exists()
    lab.gain = 1.0
    assert lab.say().taken
    lab.go(1.3)
    assert (lab.out / "emg/S01/mvc.npz").exists()
    assert (lab.out / "emg_discarded/S01/mvc_1.npz").exists()
    bars = lab.bench.sent(HumanSession.bars)
    assert all(0.0 <= one.fds <= 1.0 for one in bars)
    assert not bars[-1].clipped


def test_a_weak_contraction_is_none(lab: Lab) -> None:
    assert lab.say().taken
    lab.go(1.3)
    lab.gain = 0.01
    assert lab.say().taken
    lab.go(1.3)
    assert "attempt 2" in lab.prompt.text


def test_a_spoilt_trial_is_kept_apart_and_done_again(lab: Lab) -> None:
    lab.calibrate()
    lab.trial(ending=AGAIN)
    assert "attempt 2" in lab.prompt.text
    lab.trial()
    spoilt, good = read_human(lab.out)
    assert (spoilt.ended_by, spoilt.attempt, good.ended_by, good.attempt) == ("repeat", 1, "subject", 2)
    assert spoilt.emg.startswith("emg_discarded/")
    assert (lab.out / good.emg).exists()


def test_an_amplifier_that_falls_silent_holds_nothing_up_and_is_reported(lab: Lab) -> None:
    lab.calibrate()
    assert lab.say().taken
    lab.go(1.0)
    assert lab.say().taken
    lab.bench.advance(2.5)  # no block from after the end ever comes
    assert len(read_human(lab.out)) == 1
    assert lab.say().taken
    lab.bench.advance(1.0)
    assert lab.say().taken
    lab.bench.advance(2.5)
    assert read_human(lab.out)[1].emg == ""


def test_without_emg_there_is_no_session(lab: Lab) -> None:
    assert lab.say().taken
    with pytest.raises(NodeError, match="is the amplifier measuring"):
        lab.bench.advance(4.0)


def test_a_replacement_goes_on_in_the_midst_of_a_trial(lab: Lab) -> None:
    lab.calibrate()
    lab.trial()
    assert lab.say().taken
    lab.go(0.5)
    second = replace(lab.bench)
    asked = lab.prompt.number
    second.advance_to(lab.bench.clock.now_ns())
    lab.bench = second
    assert second.call(HumanSession.answer, AnswerRequest(number=asked, by="page")).taken
    lab.bench.advance(2.5)
    rows = read_human(lab.out)
    assert len(rows) == 2
    assert rows[1].answered_by == "page"


def test_any_depth_may_be_reported_in_mm_and_the_nearest_counts(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out", answer="mm")
    lab.calibrate()
    for _ in range(3):
        lab.trial()
    lab.trial()
    assert lab.prompt.kind == "text"
    assert not lab.say("deep").taken
    assert not lab.say("31").taken
    assert lab.say("5,5").taken
    assert (read_human(lab.out)[-1].answer_mm, read_human(lab.out)[-1].estimate_m) == (5.5, 0.004)


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


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a session that was not interrupted."""
    lab = Lab(tmp_path_factory.mktemp("whole"))
    lab.calibrate()
    for _ in range(6):
        whole_trial(lab)
    return lab.out


@pytest.mark.parametrize("trials", [1, 3, 4])
def test_no_trial_is_lost_or_there_twice(trials: int, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    kept = interrupted(out, trials)
    before = {path: path.read_bytes() for path in (out / "emg").rglob("*.npz")}
    lab = resumed(out, kept)
    assert lab.bench.sent(HumanSession.cue)[0].phase == "pause"
    assert "Give phantom" in lab.prompt.text
    for _ in range(6 - trials):
        whole_trial(lab)
    assert "over" in lab.prompt.text
    assert shown(read_human(out)) == shown(read_human(whole))
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
