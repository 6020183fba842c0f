"""Open the driver on the made-up amplifier, tare it, load it, lose samples, silence it: python try_it.py."""

import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from amplifier import Amplifier

from palp_core.graph.clock import monotonic_ns
from palp_core.palpation.devices.protocols import TorqueSamples
from palp_core.palpation.devices.registry import open_device

if __name__ == "__main__":
    amplifier, rng, pause = Amplifier(), np.random.default_rng(1), threading.Event()
    sensor = open_device("torque", "load_cell:LoadCell", url=amplifier.url)
    state = sensor.state_type()

    def first(fits: Callable[[TorqueSamples], bool]) -> TorqueSamples:
        """Return the first block of those that come, one every 50 ms, that fits."""
        while True:
            pause.wait(0.05)
            block = sensor.drain(monotonic_ns(), state, rng)
            if len(block.index) and fits(block):
                return block

    def await_health(condition: str) -> None:
        """Wait until it does so, and say it."""
        while sensor.health(monotonic_ns()).condition.value != condition:
            pause.wait(0.01)
        print(f"health: {condition}")

    sensor.open(monotonic_ns(), state, rng)
    block = first(lambda _: state.sample_count > 500)
    print(f"500 samples and more, {block.torque_n_m.mean() * 1e3:.1f} N mm")
    sensor.tare(block, state)
    amplifier.counts += 2_000_000
    loaded = first(lambda block: block.torque_n_m.min() > 1e-3)
    print(f"tared, then loaded: {loaded.torque_n_m.mean() * 1e3:.1f} N mm")
    amplifier.skip = 50
    first(lambda block: bool(block.gap.any()))
    print("50 samples left out: a gap")
    amplifier.silent = True
    await_health("stale")
    amplifier.silent = False
    await_health("ok")
    sensor.close()
    amplifier.close()
