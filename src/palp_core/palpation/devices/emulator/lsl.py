"""An LSL outlet of the simulated muscles."""

from typing import Any

import numpy as np

from palp_core.palpation.devices.emg.lsl import load_lsl
from palp_core.palpation.devices.emulator.emg import EMG_HZ, Muscles
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import Faults

_CHUNK_NS = 10_000_000


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
