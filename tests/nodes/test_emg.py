"""EMG: rest, maximum contraction, rest, palpation, silence; and co-contraction from it, block by block."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from msgs.emg import CoContraction, EmgBlock
from msgs.human import MuscleCue
from nodes import emg
from nodes.cocontraction import Cocontraction, CoContractionParams
from nodes.emg import Emg
from palp_core import Bench
from palp_core.errors import DeviceError, NodeError
from palp_core.graph.node.lifecycle import Transition
from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.health import Condition, DeviceHealth
from palp_core.palpation.devices.protocols import EmgSamples as Samples
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse
from palp_core.units import Float64Array
from tests.support.rig_messages import emg_block

BEFORE_S = 9.0  # rest, MVC, rest


def recorded(**params: object) -> list[EmgBlock]:
    bench = Bench(Emg, params)
    bench.advance(BEFORE_S + 1.5)
    return bench.sent(Emg.block)


@functools.cache
def undisturbed() -> tuple[Float64Array, Float64Array]:
    return joined(recorded(palpation_s=1.0))


def joined(blocks: list[EmgBlock]) -> tuple[Float64Array, Float64Array]:
    return np.concatenate([b.fds_v for b in blocks]), np.concatenate([b.edc_v for b in blocks])


def test_after_the_palpation_nothing_is_due() -> None:
    bench = Bench(Emg, {"palpation_s": 2.0})
    bench.advance(BEFORE_S + 2.0)
    count = len(bench.sent(Emg.block))
    assert bench.executor.next_due_ns() is None
    bench.advance(30.0)
    assert len(bench.sent(Emg.block)) == count


@pytest.mark.parametrize(("block_samples", "palpation_s"), [(31, 0.0), (900, 0.99)])
def test_neither_the_blocks_nor_the_end_of_the_palpation_change_or_lose_a_sample(
    block_samples: int, palpation_s: float
) -> None:
    fds_v, edc_v = joined(recorded(block_samples=block_samples, palpation_s=palpation_s))
    assert len(fds_v) == np.floor((BEFORE_S + palpation_s) * 1500.0 + 1e-6) + 1
    np.testing.assert_allclose(fds_v, undisturbed()[0][: len(fds_v)], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(edc_v, undisturbed()[1][: len(edc_v)], rtol=0.0, atol=1e-15)


class ScriptedSource:
    """A real source as the node sees it: two samples a drain, a gap before the second drain's."""

    state_type = EmgSourceState

    def __init__(self) -> None:
        self.condition, self.drained = Condition.OK, 0
        self.waiting: list[Samples] = []

    def open(self, *_: object) -> None:
        pass

    def close(self) -> None:
        pass

    def health(self, now_ns: int) -> DeviceHealth:
        return DeviceHealth(self.condition, now_ns, "" if self.condition is Condition.OK else "a cause")

    def drain(self, now_ns: int, state: object, rng: object) -> Samples:
        self.drained += 1
        if self.waiting:
            return self.waiting.pop(0)
        gap = np.array([self.drained == 2, False])
        return Samples(np.array([now_ns, now_ns + 1]), np.zeros(2), np.zeros(2), np.arange(2), gap)


@pytest.fixture
def source(monkeypatch: pytest.MonkeyPatch) -> ScriptedSource:
    scripted = ScriptedSource()
    monkeypatch.setattr(emg, "open_device", lambda *_, **__: scripted)
    return scripted


def test_a_real_source_has_a_report_of_its_state_and_its_gaps(source: ScriptedSource) -> None:
    bench = Bench(Emg, {"device": "noraxon"})
    bench.advance(0.16)
    source.condition = Condition.LINK_LOST
    bench.advance(0.05)
    reports = bench.sent(Emg.report)
    assert [report.gap_count for report in reports] == [0, 1, 0, 0][: len(reports)]
    assert {report.sample_count for report in reports} == {2}
    assert (reports[0].condition, reports[0].text) == ("ok", "")
    assert (reports[-1].condition, reports[-1].text) == ("link lost", "a cause")


def test_a_source_that_cannot_be_opened_is_not_drained(
    source: ScriptedSource, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:

    def refuse(*_: object) -> None:
        raise DeviceError("no such stream")

    monkeypatch.setattr(source, "open", refuse)
    with pytest.raises(NodeError, match="no such stream"):
        Bench(Emg, {"device": "noraxon"})
    assert source.drained == 0
    assert "a hook failed" not in caplog.text


def test_a_simulated_source_has_no_report() -> None:
    bench = Bench(Emg, {"palpation_s": 1.0})
    bench.advance(1.0)
    assert bench.sent(Emg.report) == []


def test_every_sample_across_a_fault_is_passed_on_at_its_time(source: ScriptedSource) -> None:
    bench = Bench(Emg, {"device": "noraxon", "rate_hz": 1000.0, "block_samples": 50})
    times_ns = np.array([10, 11, 12, 40, 41]) * 1_000_000  # what was lost between 12 and 40 is flagged
    gap = np.array([False, False, False, True, False])
    values = np.arange(5.0)
    source.waiting = [Samples(times_ns, values, -values, np.array([0, 1, 2, 30, 31]), gap)]
    bench.advance(0.05)
    blocks = bench.sent(Emg.block)[:2]
    assert [block.start_ns for block in blocks] == [10_000_000, 40_000_000]
    assert [block.fds_v.tolist() for block in blocks] == [[0.0, 1.0, 2.0], [3.0, 4.0]]
    assert [block.edc_v.tolist() for block in blocks] == [[0.0, -1.0, -2.0], [-3.0, -4.0]]


def test_what_has_come_since_the_last_tick_is_passed_on_at_the_end(source: ScriptedSource) -> None:
    bench = Bench(Emg, {"device": "noraxon"})
    bench.advance(0.06)
    before = len(bench.sent(Emg.block))
    bench.executor.transition(Transition.DEACTIVATE)
    assert len(bench.sent(Emg.block)) > before


def test_what_is_cued_is_done_and_every_sample_has_the_phase_of_its_time() -> None:
    bench = Bench(Emg, {"device": emg.SUBJECT, "cued": True})

    def cue(phase: str, seconds: float, phantom: str = "") -> None:
        bench.feed(Emg.cue, MuscleCue(stamp_ns=bench.clock.now_ns(), phase=phase, phantom=phantom))
        bench.advance(seconds)

    bench.advance(0.52)
    for phase, seconds in (("rest", 1.03), ("mvc", 1.0), ("pause", 0.51), ("palpation", 2.0), ("pause", 0.2)):
        cue(phase, seconds, "A")
    bench.advance(0.1)
    blocks = bench.sent(Emg.block)
    assert blocks[0].phase == "pause"
    counts = {
        phase: sum(len(b.fds_v) for b in blocks if b.phase == phase) for phase in ("rest", "mvc", "palpation")
    }
    assert counts == {"rest": 1545, "mvc": 1500, "palpation": 3000}
    strength = {phase: float(np.std(joined([b for b in blocks if b.phase == phase])[0])) for phase in counts}
    assert strength["mvc"] > 1.5 * strength["palpation"] > 10.0 * strength["rest"]
    starts = [round(b.start_ns * 1.5e-6) for b in blocks]
    assert starts[1:] == [start + len(b.fds_v) for start, b in zip(starts, blocks, strict=True)][:-1]


def test_an_amplifier_whose_samples_come_late_has_them_in_the_phase_of_their_time(
    source: ScriptedSource,
) -> None:
    bench = Bench(Emg, {"device": "noraxon", "rate_hz": 1000.0, "block_samples": 50, "cued": True})
    bench.feed(Emg.cue, MuscleCue(stamp_ns=20_000_000, phase="mvc"))
    times_ns = np.arange(1, 41) * 1_000_000  # half of them from before the cue
    source.waiting = [Samples(times_ns, np.zeros(40), np.zeros(40), np.arange(40), np.zeros(40, dtype=bool))]
    before = len(bench.sent(Emg.block))
    bench.advance(0.05)
    late = bench.sent(Emg.block)[before:][:2]
    assert [(block.phase, len(block.fds_v)) for block in late] == [("pause", 20), ("mvc", 20)]


Whole = tuple[list[CoContraction], list[int]]


@pytest.fixture(scope="module")
def recording() -> list[EmgBlock]:
    """Rest, MVC, rest and 20 s of palpation."""
    bench = Bench(Emg, seed=4)
    bench.advance(29.0)
    return bench.sent(Emg.block)


def followed(blocks: list[EmgBlock], **params: object) -> Whole:
    """Return what is published of a recording, and the level of every peak."""
    bench = Bench(Cocontraction, params)
    levels, before = [], 0
    for block in blocks:
        bench.feed(Cocontraction.emg, block)
        state = bench.node.state
        levels += [state.level] * (state.peak_count - before)
        before = state.peak_count
    return bench.sent(Cocontraction.cocontraction), levels


def processed(blocks: list[EmgBlock], **params: object) -> list[CoContraction]:
    return followed(blocks, **params)[0]


@pytest.fixture(scope="module")
def whole(recording: list[EmgBlock]) -> Whole:
    """What is published of the whole recording."""
    return followed(recording)


def test_the_command_makes_the_same_of_a_recording_as_the_node(
    recording: list[EmgBlock], whole: Whole
) -> None:
    """But for the first window, for the node's filter knows what was before the palpation."""
    parts = {
        phase: np.concatenate([[b.fds_v, b.edc_v] for b in recording if b.phase == phase], axis=1)
        for phase in ("rest", "mvc", "palpation")
    }
    found = analyse(parts["palpation"], parts["mvc"], EmgSettings(), rest=parts["rest"])
    stream, levels = whole
    assert found.reference == pytest.approx(stream[0].reference_v, rel=0.01)
    given = np.concatenate([c.value for c in stream])
    np.testing.assert_allclose(found.cocontraction[600:], given[600:], rtol=0.01, atol=1e-12)
    assert found.levels.index.tolist()[: len(levels)] == levels


def test_levels_are_read_as_printed_where_that_is_asked_for(recording: list[EmgBlock]) -> None:
    some = [b for b in recording if b.start_ns < 12e9]
    printed = processed(some, mvc_rule="sum_of_maxima", level_rule="peak")
    assert printed[0].reference_v > 1.05 * processed(some)[0].reference_v


def test_thresholds_that_do_not_fit_together_are_refused() -> None:
    assert (
        "off at 0.2 and on at 0.1"
        in Cocontraction.examine(CoContractionParams(on_share=0.1, off_share=0.2))["on_share"]
    )
    assert Cocontraction.examine(CoContractionParams()) == {}


def test_a_burst_counts_only_once_it_has_ended(recording: list[EmgBlock], whole: Whole) -> None:
    relaxing = [b for b in recording if b.start_ns < 20e9]
    idle = np.concatenate([b.fds_v for b in recording if b.phase == "rest"])[:75]
    for _ in range(20):
        relaxing.append(emg_block(relaxing[-1].start_ns + 50_000_000, "palpation", idle, idle))
    counts = [c.burst_count for c in processed(relaxing)]
    assert counts == [0] * counts.index(1) + [1] * counts.count(1)
    assert counts.index(1) * 0.05 > 11.0  # as long as the subject does not relax, it goes on
    first = whole[0][0]
    assert (first.burst_count, first.level_defined) == (0, False)


def test_nothing_is_reported_before_the_maximum_is_known(recording: list[EmgBlock]) -> None:
    assert processed([b for b in recording if b.phase == "rest"]) == []
    assert processed([b for b in recording if b.phase != "mvc"]) == []
