"""Co-contraction from EMG, block by block: what the command makes of the whole recording."""

from __future__ import annotations

import numpy as np
import pytest

from msgs.emg import CoContraction, EmgBlock
from nodes.cocontraction import Cocontraction, CoContractionParams
from nodes.emg import Emg
from palp_core import Bench
from palp_core.palpation.perception.emg.analysis import EmgSettings, analyse

RATE_HZ = 1500.0
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
        last = relaxing[-1]
        relaxing.append(
            EmgBlock(
                stamp_ns=last.stamp_ns + 50_000_000,
                start_ns=last.start_ns + 50_000_000,
                rate_hz=RATE_HZ,
                phase="palpation",
                fds_v=idle,
                edc_v=idle,
            )
        )
    counts = [c.burst_count for c in processed(relaxing)]
    assert counts == [0] * counts.index(1) + [1] * counts.count(1)
    assert counts.index(1) * 0.05 > 11.0  # as long as the subject does not relax, it goes on
    first = whole[0][0]
    assert (first.burst_count, first.level_defined) == (0, False)


def test_nothing_is_reported_before_the_maximum_is_known(recording: list[EmgBlock]) -> None:
    assert processed([b for b in recording if b.phase == "rest"]) == []
    assert processed([b for b in recording if b.phase != "mvc"]) == []


def test_the_offset_of_the_electrodes_does_not_matter(recording: list[EmgBlock]) -> None:
    def shift(block: EmgBlock) -> EmgBlock:
        return EmgBlock(
            stamp_ns=0,
            start_ns=block.start_ns,
            rate_hz=block.rate_hz,
            phase=block.phase,
            fds_v=block.fds_v + 0.01,
            edc_v=block.edc_v - 0.02,
        )

    some = [b for b in recording if b.start_ns < 15e9]
    shifted = processed([shift(b) for b in some])
    for a, b in zip(processed(some), shifted, strict=True):
        np.testing.assert_allclose(a.value, b.value, rtol=1e-6)
