"""What each length of blocks costs here, and how long what a sweep says has to wait for its last block."""

import time
from collections.abc import Iterator

import numpy as np

from palp_core.graph.transport.codec_measures import block_of, loopback, ways
from palp_core.methods.measured import Measured, begins_after, cpu_s
from palp_core.palpation.devices.block_methods import SWEEP
from palp_core.palpation.devices.blocks import LENGTHS, WANTED, Length, late_blocks
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.perception.signal.sweep_cut import SweepCut

RATE_HZ = 1000.0
"""Of torque samples; published."""

_BEFORE_S = 0.1  # that the stream runs before a sweep


def longest_wait_s(block_samples: int, sweep_s: float, rate_hz: float = RATE_HZ) -> float:
    """Return the longest time from a sweep's last sample to the end of the block that brings it, in s.

    Args:
        block_samples: Samples of a block.
        sweep_s: How long a sweep is over the phantom.
        rate_hz: Of the samples.
    """
    phases = np.unique(np.linspace(0, block_samples - 1, min(block_samples, 1000)).astype(int))
    return max(_wait_s(block_samples, sweep_s, rate_hz, int(phase)) for phase in phases)


def _wait_s(block_samples: int, sweep_s: float, rate_hz: float, phase: int) -> float:
    """Return the wait of one sweep that begins so many samples into a block."""
    step_ns = 1e9 / rate_hz
    enter = round(_BEFORE_S * rate_hz) // block_samples * block_samples + block_samples + phase
    leave_ns = round((enter + round(sweep_s * rate_hz)) * step_ns)
    stream, first = SweepCut(), 0
    stream.hold()
    stream.bound(round(enter * step_ns), leave_ns)
    while not stream.complete:
        stream.add(round(first * step_ns), rate_hz, np.zeros(block_samples))
        first += block_samples
    return (stream.last_ns - leave_ns) / 1e9


@begins_after(0.1)
def measure_blocks(scene: Scene) -> Iterator[Measured]:
    """Give CPU time a sample of codec and sockets, and the longest wait for a sweep's last block.

    What a block is under way on the wall clock comes on top of the wait; with it, some are late.
    """
    sweep_s = scene.path.duration_s
    with loopback() as along:
        bring = ways(along)["one_frame"]
        for length in (*LENGTHS, SWEEP._replace(length_s=sweep_s)):
            count = length.samples(RATE_HZ)
            message = block_of(8 * count)
            yield Measured(
                task="block",
                method=length.name,
                setting=f"{count} samples",
                cost_s=cpu_s(lambda m=message: bring(m), clock=time.process_time_ns) / count,  # type: ignore[misc]
                error=longest_wait_s(count, sweep_s) + 1.0 / RATE_HZ,
                output=WANTED["torque"].output,
                against="the sample's own time",
                fails=_fails(length),
            )


def _fails(length: Length) -> str:
    return late_blocks("torque", length.length_s, wall_clock=True)
