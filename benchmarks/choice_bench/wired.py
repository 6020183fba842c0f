"""Tasks ``block``, ``codec`` and ``delivery``: real sockets and graphs, random rates, arrays and readers."""

from __future__ import annotations

import os
from collections.abc import Callable

import msgspec
import numpy as np

from benchmarks.choice_bench.contest import Case, Reading, log_between
from palp_core.graph.launch.delivery_measures import COUNT, RATE_HZ, run
from palp_core.graph.messages.codecs import LARGEST_BYTES
from palp_core.graph.messages.fragments import CUT_FROM
from palp_core.graph.transport.codec_measures import block_of, loopback, ways
from palp_core.methods import find
from palp_core.palpation.devices.block_methods import SWEEP
from palp_core.palpation.devices.blocks import LENGTHS
from palp_core.palpation.perception.signal.sweep_cut import SweepCut

_SWEEP_S, _SWEEPS = 0.3, 100
_LENGTHS = {one.name: one for one in (*LENGTHS, SWEEP)}


def block(rng: np.random.Generator, _index: int) -> Case:
    """Draw a rate and how old a sample may be, in simulated time: the wall clock's share is the machine's."""
    rate_hz = (
        log_between(rng, 5.0, 2e4) if rng.random() < 0.5 else float(rng.choice([200, 500, 1e3, 1500, 2e3]))
    )

    phases = int(rng.integers(1 << 31))

    def measure(name: str, _round: int) -> Reading:
        samples = _LENGTHS[name].samples(rate_hz)
        span_ns = samples * 1e9 / rate_hz
        chance = np.random.default_rng(phases)
        ends_ns = [1e9 + _SWEEP_S * 1e9 + float(one) * span_ns for one in chance.random(_SWEEPS)]
        return Reading(max(_wait_s(samples, rate_hz, round(one)) for one in ends_ns))

    quantities = {"sample_hz": rate_hz, "wall_clock": 0.0, "sweep_s": _SWEEP_S}
    return Case("block", "age_s", log_between(rng, 5e-4, 0.2), quantities, measure, f"{rate_hz:.6g} Hz")


def _wait_s(samples: int, rate_hz: float, leave_ns: int) -> float:
    """Return how long a sweep waits that ends then, for the block that brings its last sample."""
    stream, span_ns = SweepCut(), samples * 1e9 / rate_hz
    stream.hold()
    stream.bound(leave_ns - round(_SWEEP_S * 1e9), leave_ns)
    number = int(leave_ns / span_ns) - 1
    while not stream.complete:
        stream.add(round(number * span_ns), rate_hz, np.zeros(samples))
        number += 1
    return (stream.last_ns - leave_ns) / 1e9


def codec(rng: np.random.Generator, _index: int) -> Case:
    """Draw an array up to 8 MiB; what arrives must be what was sent."""
    size = 8 * round(log_between(rng, 8, 8 << 20) / 8)
    if rng.random() < 0.2:
        size = CUT_FROM + 8 * int(rng.integers(-2, 3))
    declared = float(size if rng.random() < 0.9 else log_between(rng, LARGEST_BYTES, 1e12))
    values = np.ldexp(rng.standard_normal(size // 8), int(rng.integers(-1000, 0)))
    message = msgspec.structs.replace(block_of(size), torque_n_m=values)

    def measure(name: str, _round: int) -> Reading:
        if declared != size:
            return Reading(np.inf)  # no such array fits into this machine
        with loopback() as along:
            came, _ = ways(along)[name](message)
        return Reading(float(np.asarray(came).tobytes() != values.tobytes()))

    return Case("codec", "value", 0.0, {"array_bytes": declared}, measure, f"array of {declared:.6g} bytes")


def delivery(rng: np.random.Generator, _index: int) -> Case:
    """Draw a clock, one process or several, and a reader that keeps up or does not; nothing may be lost."""
    wall = bool(rng.random() < 0.5)
    several = wall or bool(rng.random() < 0.5)
    load = float(rng.uniform(0.0, 0.6) if rng.random() < 0.6 else rng.uniform(1.2, 2.0)) if wall else 0.0
    tolerance = 0.0 if rng.random() < 0.8 else 1.0

    def measure(name: str, _round: int) -> Reading:
        if wall != bool(find("delivery", name).valid["wall_clock"][0]) or (name == "composed" and several):
            return Reading(np.inf)  # a device has its own clock and process
        reliability = "best_effort" if name == "best_effort" else "reliable"
        readers = {"reader": (reliability, load / RATE_HZ)}
        found, _ = run(readers, clock="wall" if wall else "sim", compose=name == "composed")
        return Reading(1.0 - len(found["reader"]["ages_s"]) / COUNT)

    quantities = {
        "wall_clock": float(wall), "process_count": 3.0 if several else 1.0, "reader_load": load,
        "reader_s": load / RATE_HZ, "backlog": max(load - 1.0, 0.0) * COUNT, "depth": 10.0,
    }  # fmt: skip
    words = f"{'wall clock' if wall else 'simulated'}, reader's load {load:.2g}, {os.cpu_count()} cores"
    return Case("delivery", "lost", tolerance, quantities, measure, words)


CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {
    "block": block,
    "codec": codec,
    "delivery": delivery,
}
