"""Co-contraction from EMG: the same values as offline, and as many bursts as the muscles made."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from msgs.emg import CoContraction, EmgBlock
from nodes.cocontraction import Cocontraction
from nodes.emg import Emg
from palp_core import Bench
from palp_core.palpation.perception.emg.bursts import BurstFinder, BurstState
from palp_core.palpation.perception.emg.emg import EmgChain, cocontraction, find_offset, reference
from palp_core.palpation.perception.emg.levels import to_levels
from palp_core.palpation.perception.strategy.figure5 import matrices
from palp_core.units import Float64Array

RATE_HZ = 1500.0
WINDOW_S = 0.15


@pytest.fixture(scope="module")
def recording() -> list[EmgBlock]:
    """Rest, MVC, rest and 60 s of palpation."""
    bench = Bench(Emg, seed=4)
    bench.advance(70.0)
    return bench.sent(Emg.block)


def processed(blocks: list[EmgBlock], **params: float) -> list[CoContraction]:
    bench = Bench(Cocontraction, params)
    bench.feed(Cocontraction.emg, *blocks)
    return bench.sent(Cocontraction.cocontraction)


def offline(blocks: list[EmgBlock]) -> Float64Array:
    """Equations (1) to (3) on the whole recording at once."""
    raw = [np.concatenate([b.fds_v for b in blocks]), np.concatenate([b.edc_v for b in blocks])]
    rest = (blocks[0].fds_v, blocks[0].edc_v)
    chains = [EmgChain(find_offset(r), RATE_HZ, window_s=WINDOW_S) for r in rest]
    envelopes = np.array([chain.envelope(v) for chain, v in zip(chains, raw, strict=True)])
    phases = np.concatenate([np.full(len(b.fds_v), b.phase) for b in blocks])
    value = cocontraction(envelopes, reference(envelopes[:, phases == "mvc"]))
    return np.asarray(value[phases == "palpation"])


def test_the_stream_gives_the_offline_values(recording: list[EmgBlock]) -> None:
    value = np.concatenate([c.value for c in processed(recording)])
    np.testing.assert_allclose(value, offline(recording), rtol=1e-9)


def test_bursts_and_their_levels_are_those_of_the_whole_recording(recording: list[EmgBlock]) -> None:
    rule = BurstFinder(RATE_HZ, 0.05, 0.4)
    stream = processed(recording)
    _, whole = rule.step(BurstState(), np.concatenate([c.value for c in stream]))
    assert stream[-1].burst_count == len(whole)
    ends = np.cumsum([len(c.value) for c in stream])
    for message, end in zip(stream, ends.tolist(), strict=True):
        known = [burst.value for burst in whole if burst.known_at < end]
        assert message.burst_count == len(known)
        if known:
            assert message.level == to_levels(np.array(known)).index[-1]


def test_it_counts_about_as_many_bursts_as_the_muscles_made(recording: list[EmgBlock]) -> None:
    """The simulated subject holds each level for 1 s on average: 60 levels in 60 s."""
    assert 45 <= processed(recording)[-1].burst_count <= 75


def test_the_levels_are_as_frequent_as_in_the_chain(recording: list[EmgBlock]) -> None:
    stream = processed(recording)
    seen = [b.level for a, b in itertools.pairwise(stream) if b.burst_count > a.burst_count]
    values, vectors = np.linalg.eig(matrices().mean(axis=0))
    law = np.real(vectors[:, int(np.argmax(np.real(values)))])
    law = law / law.sum()
    assert set(seen) <= set(range(5))
    assert np.mean(seen) == pytest.approx(law @ np.arange(5), abs=0.6)


def test_a_burst_counts_only_once_it_has_ended(recording: list[EmgBlock]) -> None:
    counts = [c.burst_count for c in processed(recording)]
    assert counts == sorted(counts)
    first = processed(recording)[0]
    assert (first.burst_count, first.level_defined) == (0, False)


def test_nothing_is_told_before_the_maximum_is_known(recording: list[EmgBlock]) -> None:
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


def test_a_replacement_continues_byte_for_byte(recording, successor, frames_of) -> None:  # type: ignore[no-untyped-def]
    some = [b for b in recording if b.start_ns < 20e9]
    whole, first = Bench(Cocontraction), Bench(Cocontraction)
    for bench in (whole, first):
        bench.feed(Cocontraction.emg, *some[:250])
    second = successor(first)
    for bench in (whole, second):
        bench.feed(Cocontraction.emg, *some[250:])
    assert frames_of(first) + frames_of(second) == frames_of(whole)
