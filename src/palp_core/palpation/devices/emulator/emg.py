"""An EMG amplifier of the simulated muscles: Noraxon's pages."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np

from palp_core.palpation.devices.emulator.world import World
from palp_core.palpation.devices.protocols import EmgSamples
from palp_core.palpation.devices.sim.emg import SimEmgState

_AHEAD_NS = 200_000_000


class Muscles:
    """The simulated subject, sampled at a rate by a clock of the device's own.

    Args:
        world: The rig.
        rate_hz: Samples per second of the device's clock.
        clock_ppm: How much faster than the host's that clock runs, in millionths.
    """

    def __init__(self, world: World, rate_hz: float, clock_ppm: float = 0.0) -> None:
        self._speed = 1.0 + clock_ppm * 1e-6
        self._begin_ns: int | None = None
        self.source = replace(world.emg, rate_hz=rate_hz)
        self._state = SimEmgState()
        self._rng = np.random.default_rng((world.settings.seed, 2))
        self._drawn_ns = -1
        self._ahead = EmgSamples(np.empty(0, np.int64), np.empty(0), np.empty(0))

    def since(self, now_ns: int) -> EmgSamples:
        """Return the samples since the last call, at times of the device's clock.

        They are drawn ahead, which leaves them as they are: a filter costs as much for a hundred as for one.
        """
        begin_ns = self._begin_ns = now_ns if self._begin_ns is None else self._begin_ns
        device_ns = begin_ns + round((now_ns - begin_ns) * self._speed)
        self.source.open(device_ns, self._state, self._rng)
        if self._drawn_ns < device_ns:
            self._drawn_ns = device_ns + _AHEAD_NS
            self._ahead = _joined(self._ahead, self.source.drain(self._drawn_ns, self._state, self._rng))
        due = int(np.searchsorted(self._ahead.times_ns, device_ns, side="right"))
        told, self._ahead = _part(self._ahead, slice(due)), _part(self._ahead, slice(due, None))
        return told


def _joined(first: EmgSamples, second: EmgSamples) -> EmgSamples:
    return EmgSamples(
        np.concatenate([first.times_ns, second.times_ns]),
        np.concatenate([first.fds_v, second.fds_v]),
        np.concatenate([first.edc_v, second.edc_v]),
        np.concatenate([first.index, second.index]),
        np.concatenate([first.gap, second.gap]),
    )


def _part(block: EmgSamples, part: slice) -> EmgSamples:
    return EmgSamples(
        block.times_ns[part], block.fds_v[part], block.edc_v[part], block.index[part], block.gap[part]
    )


class Noraxon:
    """MR3's HTTP streaming: what was measured since the last poll, in microvolts."""

    def __init__(self, world: World, rate_hz: float = 1500.0, clock_ppm: float = 0.0) -> None:
        self._rate_hz = rate_hz
        self._muscles = Muscles(world, rate_hz, clock_ppm)
        self._enabled = [True, True]

    def page(self, path: str, now_ns: int) -> bytes | None:
        """Return the body of a page."""
        if path == "/headers":
            headers = [
                {"name": n, "type": "real.emg", "samplerate": self._rate_hz, "units": "uV", "index": i}
                for i, n in enumerate(("FDS", "EDC"))
            ]
            return json.dumps({"headers": headers}).encode("ascii")
        if path == "/disable/all":
            self._enabled = [False, False]
            return b""
        if (match := re.fullmatch(r"/enable/([01])", path)) is not None:
            self._enabled[int(match[1])] = True
            return b""
        if path == "/samples":
            return self._samples(now_ns)
        return None

    def _samples(self, now_ns: int) -> bytes:
        block = self._muscles.since(now_ns)
        channels: list[dict[str, Any]] = [
            {"index": i, "samples": np.round(volts * 1e6, 3).tolist()}
            for i, volts in enumerate((block.fds_v, block.edc_v))
            if self._enabled[i]
        ]
        return json.dumps({"channels": channels}).encode("ascii")
