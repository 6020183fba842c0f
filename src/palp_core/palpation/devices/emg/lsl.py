"""EMG from any program that offers it in the laboratory streaming layer (LSL)."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from palp_core.errors import DeviceError
from palp_core.extras import install_line
from palp_core.foreign import catch_foreign
from palp_core.palpation.devices.emg.emg_source import EmgDriver
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.sample_line import SampleLine

_VOLT = {"microvolts": 1e-6, "uV": 1e-6, "millivolts": 1e-3, "mV": 1e-3, "volts": 1.0, "V": 1.0, "": 1e-6}
_PULL_S = 0.1


@dataclass
class LslEmg(EmgDriver):
    """Parameters and inlet. Needs pylsl, of the extra ``lsl``.

    Samples carry the sender's time: a step of more than ``gap_s`` beyond the nominal is a gap.

    Attributes:
        stream: Its name.
        rate_hz: Its nominal rate; what the stream says must agree.
        channels: Places of flexor and extensor among its channels.
        stale_s: Longest silence.
        find_s: Longest search for the stream.
        gap_s: Larger than the jitter of a sender that stamps when it sends (assumed).
    """

    LINK: ClassVar[str] = f"Lab Streaming Layer: an inlet of type EMG ({install_line('emg')})"

    stream: str
    rate_hz: float = 1500.0
    channels: tuple[int, int] = (0, 1)
    stale_s: float = 0.25
    find_s: float = 5.0
    gap_s: float = 0.02

    def __post_init__(self) -> None:
        check_range("lsl", "find_s", self.find_s, 0.1, 600.0)
        check_range("lsl", "gap_s", self.gap_s, 1e-4, 10.0)
        self._receive("lsl", self.rate_hz, self.stale_s)

    def _session(self, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> _LslSession:
        return _LslSession(self, line, monitor, host)


class _LslSession:
    def __init__(self, source: LslEmg, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> None:
        lsl = load_lsl("lsl")
        self._source, self._line, self._monitor, self._host = source, line, monitor, host
        found = lsl.resolve_byprop("name", source.stream, 1, source.find_s)
        if not found:
            raise DeviceError(
                f"lsl: no stream '{source.stream}' within {source.find_s:g} s; is its program running?"
            )
        if found[0].nominal_srate() != source.rate_hz or found[0].channel_count() <= max(source.channels):
            raise DeviceError(
                f"lsl: '{source.stream}': {found[0].channel_count()} channels, {found[0].nominal_srate()} Hz;"
                f" asked for channels {source.channels} at {source.rate_hz:g} Hz"
            )
        with catch_foreign(f"lsl: '{source.stream}' was found but does not open", DeviceError):
            self._inlet = lsl.StreamInlet(found[0], max_buflen=60, recover=False)
            self._volt = self._units()
            self._inlet.open_stream(timeout=source.find_s)
        self._next_s: float | None = None
        self._index = 0

    def step(self, stop: threading.Event) -> None:
        try:
            samples, stamps = self._inlet.pull_chunk(timeout=_PULL_S, max_samples=256)
        except RuntimeError as error:
            raise DeviceError(f"lsl: stream '{self._source.stream}' ended: {error}") from error
        if not len(stamps):
            return
        now_ns = self._host.now_ns()
        values = np.asarray(samples, dtype=np.float64)[:, list(self._source.channels)] * self._volt
        if not np.all(np.isfinite(values)):
            self._line.mark_gap()
            self._monitor.report(Condition.GARBLED, now_ns, "samples that are not finite")
            return
        period_s = 1.0 / self._source.rate_hz
        if self._next_s is None:
            self._index = self._line.restart_numbering(len(stamps), now_ns)
        for begin, end, missing in _runs(np.asarray(stamps), self._next_s, period_s, self._source.gap_s):
            self._index += missing
            self._line.append(values[begin:end], now_ns, self._index)
            self._index += end - begin
        self._next_s = float(stamps[-1]) + period_s
        self._monitor.note_data(now_ns)

    def close(self) -> None:
        self._inlet.close_stream()

    def _units(self) -> np.ndarray:
        """Return what a unit of each channel is worth in V; microvolts where the stream does not say."""
        channel = self._inlet.info(timeout=self._source.find_s).desc().child("channels").child("channel")
        units: list[str] = []
        while not channel.empty():
            units.append(channel.child_value("unit"))
            channel = channel.next_sibling("channel")
        names = [units[i] if i < len(units) else "" for i in self._source.channels]
        unknown = [name for name in names if name not in _VOLT]
        if unknown:
            raise DeviceError(f"lsl: no unit '{unknown[0]}'; known: {', '.join(filter(None, _VOLT))}")
        return np.array([_VOLT[name] for name in names])


def load_lsl(place: str) -> Any:
    """Return the module pylsl; its C library logs nothing unless a file of the user's configures it.

    Raises:
        DeviceError: It is not installed, or has no C library.
    """
    with catch_foreign(f"{place}: pylsl cannot be used", DeviceError, install_line("emg")):
        lsl: Any = import_module("pylsl")
    files = (Path(), Path.home() / "lsl_api", Path("/etc/lsl_api"))
    if "LSLAPICFG" not in os.environ and not any((folder / "lsl_api.cfg").exists() for folder in files):
        with suppress(AttributeError, NotImplementedError):  # of an earlier version
            lsl.set_config_content("[log]\nlevel = -3\n")  # errors, no news
    return lsl


def _runs(
    stamps: np.ndarray, expected_s: float | None, period_s: float, gap_s: float
) -> list[tuple[int, int, int]]:
    """Split a chunk at its gaps: begin and end of each run, and how many samples are missing before it."""
    before = np.concatenate([[stamps[0] if expected_s is None else expected_s], stamps[:-1] + period_s])
    missing = np.where(stamps - before > gap_s, np.rint((stamps - before) / period_s), 0.0).astype(int)
    starts: list[int] = [0, *(i for i in np.flatnonzero(missing).tolist() if i > 0)]
    ends = [*starts[1:], len(stamps)]
    return [(int(a), int(b), int(missing[a])) for a, b in zip(starts, ends, strict=True)]
