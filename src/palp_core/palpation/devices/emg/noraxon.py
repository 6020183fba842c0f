"""EMG from Noraxon's MR3, which hands out over HTTP what it measured since the last request."""

from __future__ import annotations

import http.client
import json
import threading
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from palp_core.errors import DeviceError
from palp_core.foreign import catch_foreign, describe_foreign
from palp_core.palpation.devices.emg.emg_source import EmgDriver
from palp_core.palpation.devices.health import Condition, HealthMonitor
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.link.host_time import HostTime
from palp_core.palpation.devices.link.reply_timeout import ReplyTimeout
from palp_core.palpation.devices.link.sample_line import SampleLine

_VOLT = {"uV": 1e-6, "µV": 1e-6, "mV": 1e-3, "V": 1.0}
_TRIES = 3
_CHUNK = 1 << 16
_DISCARD_S = 60.0  # for what was measured before
_LARGEST = 16 << 20  # of an answer: some minutes of every channel


@dataclass
class NoraxonEmg(EmgDriver):
    """Parameters and link. MR3 must be measuring, with HTTP Streaming switched on.

    The stream has no sequence number: loss shows as too few samples for the time that passed.

    Attributes:
        host: The computer that runs MR3.
        port: Its streaming port.
        rate_hz: Sampling rate; what MR3 says must agree.
        channels: Names of the flexor's and the extensor's channel.
        poll_hz: Rate of the requests.
        stale_s: Longest silence.
        timeout_s: Longest wait for an answer.
        units: Unit of the samples if MR3 names none.
        verified: Parameters checked on the device; ``*`` for all.
    """

    UNVERIFIED: ClassVar[dict[str, str]] = {
        "port": "a setting of MR3; 9220 in the maker's samples",
        "units": "not every version of MR3 is known to hand out microvolts",
    }

    LINK: ClassVar[str] = "Noraxon MR3: HTTP 9220"

    host: str
    port: int = 9220
    rate_hz: float = 1500.0
    channels: tuple[str, str] = ("FDS", "EDC")
    poll_hz: float = 50.0
    stale_s: float = 0.25
    timeout_s: float = 0.5
    units: str = "uV"
    verified: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_range("noraxon", "poll_hz", self.poll_hz, 1.0, 1000.0)
        if self.units not in _VOLT:
            raise DeviceError(f"noraxon: no unit '{self.units}'; known: {', '.join(_VOLT)}")
        self._receive("noraxon", self.rate_hz, self.stale_s)

    def _session(self, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> _NoraxonSession:
        return _NoraxonSession(self, line, monitor, host)


class _NoraxonSession:
    def __init__(self, source: NoraxonEmg, line: SampleLine, monitor: HealthMonitor, host: HostTime) -> None:
        self._source, self._line, self._monitor, self._host = source, line, monitor, host
        self._connection = http.client.HTTPConnection(source.host, source.port, timeout=source.timeout_s)
        self._garbled = 0
        try:
            self._headers()
            self._get("/disable/all")
            for channel in self._channels:
                self._get(f"/enable/{channel}")
            self._get("/samples", discard=True)  # the first reply holds what was measured before
        except BaseException:
            self._connection.close()
            raise

    def step(self, stop: threading.Event) -> None:
        stop.wait(1.0 / self._source.poll_hz)
        body = self._get("/samples")
        now_ns = self._host.now_ns()
        try:
            by_index = {c["index"]: c["samples"] for c in json.loads(body)["channels"]}
            columns = [np.asarray(by_index[i], dtype=np.float64) for i in self._channels]
            count = min(len(column) for column in columns)
            if any(len(column) != count for column in columns):
                raise ValueError("channels of different length")
            values = np.column_stack(columns) * np.array(self._volt)
            if not np.all(np.isfinite(values)):
                raise ValueError("samples that are not finite")
        except (ValueError, KeyError, TypeError) as error:
            self._line.mark_gap()
            self._garbled += 1
            if self._garbled >= _TRIES:
                raise DeviceError(
                    f"noraxon: {self._garbled} answers in a row without samples: {describe_foreign(error)}"
                ) from error
            self._monitor.report(Condition.GARBLED, now_ns, describe_foreign(error))
            return
        self._garbled = 0
        if count:
            self._line.append(values, now_ns)
            self._monitor.note_data(now_ns)

    def close(self) -> None:
        self._connection.close()

    def _headers(self) -> None:
        wanted = self._source.channels
        answer = self._get("/headers")
        with catch_foreign("noraxon: /headers makes no sense", DeviceError, "check the version of MR3"):
            headers: list[dict[str, Any]] = json.loads(answer)["headers"]
            known = {str(h["name"]): h for h in headers if h["type"] == "real.emg"}
            missing = [name for name in wanted if name not in known]
            if missing:
                raise DeviceError(
                    f"noraxon: no EMG channel {', '.join(missing)}; MR3 offers {', '.join(known) or 'none'}"
                )
            self._channels = [int(known[name]["index"]) for name in wanted]
            self._volt = [_VOLT[str(known[name].get("units", self._source.units))] for name in wanted]
            rates = {float(known[name]["samplerate"]) for name in wanted}
        if rates != {self._source.rate_hz}:
            raise DeviceError(
                f"noraxon: MR3 samples at {rates} Hz, not {self._source.rate_hz:g}; set rate_hz"
            )

    def _get(self, path: str, *, discard: bool = False) -> bytes:
        try:
            self._connection.request("GET", path)
            reply = self._connection.getresponse()
            body, timeout = b"", ReplyTimeout(_DISCARD_S if discard else self._source.timeout_s)
            while part := reply.read1(_CHUNK):
                body += part if not discard else b""
                if timeout.expired() or len(body) > _LARGEST:
                    raise http.client.HTTPException(f"the answer does not end: {len(body)} bytes so far")
            reply.read()  # raises where the answer was cut short
        except (OSError, http.client.HTTPException) as error:
            self._connection.close()
            raise DeviceError(
                f"noraxon: no answer from {self._source.host}:{self._source.port}: {describe_foreign(error)};"
                " is MR3 measuring, with HTTP Streaming on?"
            ) from error
        if reply.status != 200:
            raise DeviceError(f"noraxon: {path} answered {reply.status}; is HTTP Streaming on?")
        return body
