"""EMG amplifiers of the simulated muscles: Noraxon's pages with a small HTTP server, and an LSL outlet."""

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from palp_core.palpation.devices.emg.lsl import load_lsl
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import Faults
from palp_core.palpation.devices.protocols import EmgSamples
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState

EMG_HZ = 1500.0
_CHUNK_NS = 10_000_000
_EVERY_LEVEL_ALIKE = ((0.2, 0.2, 0.2, 0.2, 0.2),) * 5


class Muscles:
    """The simulated subject."""

    def __init__(self, seed: int = 1) -> None:
        self.source = SimEmg(matrix=_EVERY_LEVEL_ALIKE, rate_hz=EMG_HZ)
        self._state, self._rng = SimEmgState(), np.random.default_rng((seed, 2))

    def since(self, now_ns: int) -> EmgSamples:
        """Return the samples since the last call."""
        self.source.open(now_ns, self._state, self._rng)
        return self.source.drain(now_ns, self._state, self._rng)


def load_filters() -> None:
    """Load what the first samples need: it takes longer than a driver waits for an answer."""
    Muscles().since(0)


class Noraxon:
    """MR3's HTTP streaming: what was measured since the last poll, in microvolts."""

    def __init__(self, seed: int = 1) -> None:
        self._muscles = Muscles(seed)
        self._enabled = [True, True]

    def page(self, path: str, now_ns: int) -> bytes | None:
        """Return the body of a page."""
        if path == "/headers":
            headers = [
                {"name": n, "type": "real.emg", "samplerate": EMG_HZ, "units": "uV", "index": i}
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


class Http:
    """Answer requests with the bytes that a page function returns; None is 404.

    Header and body leave in one write: in two, delayed acknowledgement holds the body back for 40 ms.
    """

    def __init__(self, page: Callable[[str, int], bytes | None], content_type: str) -> None:
        self._page, self._type = page, content_type
        self._rest = b""
        self.greeting, self.ready_ns = b"", 0

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Answer every complete request."""
        *requests, self._rest = (self._rest + data).split(b"\r\n\r\n")
        return b"".join(self._answer(request, now_ns) for request in requests)

    def _answer(self, request: bytes, now_ns: int) -> bytes:
        words = request.split(b"\r\n", 1)[0].decode("ascii", "replace").split()
        body = self._page(words[1], now_ns) if len(words) == 3 and words[0] == "GET" else None
        status = "200 OK" if body is not None else "404 Not Found"
        body = body if body is not None else b""
        head = f"HTTP/1.1 {status}\r\nContent-Type: {self._type}\r\nContent-Length: {len(body)}\r\n\r\n"
        return head.encode("ascii") + body


class LslOutlet:
    """Push chunks of 10 ms into the laboratory streaming layer."""

    def __init__(
        self,
        loop: EmulatorLoop,
        faults: Faults,
        name: str,
        seed: int = 1,
    ) -> None:
        self._lsl = load_lsl("emulator")
        self._loop, self._faults, self._name = loop, faults, name
        self._muscles = Muscles(seed=seed)
        self._outlet: Any = None
        self._run = 0
        self._clock_s = self._lsl.local_clock() - loop.now_ns() * 1e-9

    def plug(self) -> None:
        """Offer the stream."""
        lsl = self._lsl
        info = lsl.StreamInfo(self._name, "EMG", 2, EMG_HZ, lsl.cf_float32, f"palp-{self._name}")
        channels = info.desc().append_child("channels")
        for label in ("FDS", "EDC"):
            channel = channels.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", "microvolts")
        self._outlet = lsl.StreamOutlet(info, 0, 60)
        self._run += 1
        self._push(self._run)

    def unplug(self) -> None:
        """Withdraw the stream."""
        self._run += 1
        self._outlet = None

    def _push(self, run: int) -> None:
        if run != self._run:
            return
        now_ns = self._loop.now_ns()
        block = self._muscles.since(now_ns)
        values = np.column_stack([block.fds_v, block.edc_v]).astype(np.float32) * np.float32(1e6)
        kept, delay_ns = self._faults.spoil_reply(values.tobytes())
        values = np.frombuffer(kept, dtype=np.float32, count=len(kept) // 8 * 2).reshape(-1, 2)
        if len(values):
            stamp_s = self._clock_s + (int(block.times_ns[-1]) - delay_ns) * 1e-9
            self._outlet.push_chunk(values.tolist(), stamp_s)
        self._loop.at(now_ns + _CHUNK_NS, lambda: self._push(run))
