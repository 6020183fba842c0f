"""Codecs as the register has them: each brings what was sent, and the code parts them where it says."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from palp_core.graph.messages.codecs import SIZES, encode_json
from palp_core.graph.messages.fragments import CUT_FROM, cut
from palp_core.graph.transport.codec_measures import (
    Loopback,
    SampleBlock,
    block_of,
    loopback,
    measure_codecs,
    ways,
)
from palp_core.methods import choose, find, names
from palp_core.methods.machine import slowness
from palp_core.methods.measured import Measured, cpu_s


@pytest.fixture(scope="module")
def along() -> Iterator[Loopback]:
    with loopback() as made:
        yield made


@pytest.mark.parametrize("size", [8, 400, CUT_FROM - 8, CUT_FROM])
def test_each_codec_brings_every_number_as_it_was_sent(along: Loopback, size: int) -> None:
    message = block_of(size)
    assert set(ways(along)) == set(names("codec"))
    for name, bring in ways(along).items():
        values, bytes_count = bring(message)
        assert values.tobytes() == message.torque_n_m.tobytes(), name
        assert bytes_count > size


@pytest.mark.parametrize("size", [8, 400, 1 << 16, CUT_FROM - 8, CUT_FROM, CUT_FROM + 8, 1 << 20])
def test_a_message_is_cut_where_the_register_chooses_pieces(size: int) -> None:
    chosen = choose("codec", "value", 0.0, {"array_bytes": float(size)}).name
    assert chosen == ("one_frame" if cut(block_of(size)) is None else "pieces")


def test_text_refuses_what_it_cannot_say() -> None:
    torque_n_m = np.array([0.0, np.nan])
    broken = SampleBlock(
        stamp_ns=0, start_ns=0, rate_hz=1.0, over_phantom=True, saturated_count=0, torque_n_m=torque_n_m
    )
    with pytest.raises(ValueError, match="JSON"):
        encode_json(broken)


@pytest.mark.nightly
def test_all_are_measured_within_five_seconds_of_cpu_and_their_stated_cost() -> None:
    begun_ns = time.process_time_ns()
    found = list(measure_codecs(None))
    assert time.process_time_ns() - begun_ns < 5e9
    assert {(one.method, one.setting) for one in found} == {
        (name, setting)
        for name in names("codec")
        for setting in ("array of 400 B", "array of 64 KiB", "array of 1 MiB")
    }
    for size, one in zip(np.repeat(SIZES, len(names("codec"))), found, strict=True):
        _check(one, float(size))


def _check(one: Measured, size: float) -> None:
    most_s = find("codec", one.method).bound("cpu_s", {"array_bytes": size})
    assert (most_s is None) == bool(one.fails), one
    if most_s is not None:
        assert one.cost_s <= most_s * max(1.0, slowness()), one


def test_what_is_measured_first_comes_first(along: Loopback, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palp_core.graph.transport.codec_measures.cpu_s", lambda *_, **__: 1.0)
    first = next(measure_codecs(None))
    assert (first.method, first.setting, first.condition, first.fails) == (
        "msgpack", "array of 400 B", "", "",
    )  # fmt: skip
    assert cpu_s(lambda: None, least_s=1e-6, rounds=1, clock=time.process_time_ns) > 0.0
