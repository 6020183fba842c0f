"""A device's clock against the host's: offset, drift and what is left over.

A sample is received later than it was taken, never earlier, and by a delay that varies with buffers and
schedulers. So the model looks at the **earliest** arrival of each bucket of device time and lays a straight
line through those (least squares): host = offset + (1 + drift) device. This is the one-sided filter of
clock-skew estimation (Paxson, "On calibrating measurements of packet transit times", SIGMETRICS 1998) with
buckets in place of his de-noised segments. The smallest delay itself cannot be seen from one side and stays
in the offset.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import ClockFit, Int64Array
from palp_core.units import Float64Array

_NS = 1e9


@dataclass
class _Bucket:
    number: int
    device_s: float
    late_ns: int


class ClockModel:
    """Estimate host time from device time, one observation per arrival."""

    def __init__(self, bucket_s: float = 0.5, bucket_count: int = 120, drift_after_s: float = 5.0) -> None:
        check_range("clock model", "bucket_s", bucket_s, 1e-3, 3600.0)
        check_range("clock model", "bucket_count", bucket_count, 2, 1e6)
        check_range("clock model", "drift_after_s", drift_after_s, bucket_s, 1e9)
        self._bucket_s, self._drift_after_s = bucket_s, drift_after_s
        self._buckets: deque[_Bucket] = deque(maxlen=bucket_count)
        self._origin_ns = 0
        self._last_stamp_ns: int | None = None
        self._fit: ClockFit | None = None

    def observe(self, device_s: float, host_ns: int) -> None:
        """Take note that the sample of device time ``device_s`` had arrived at host time ``host_ns``."""
        if not self._buckets:
            self._origin_ns = host_ns - round(device_s * _NS)
        late_ns = host_ns - self._origin_ns - round(device_s * _NS)
        number = int(device_s // self._bucket_s)
        if self._buckets and self._buckets[-1].number == number:
            last = self._buckets[-1]
            if late_ns >= last.late_ns:
                return
            last.device_s, last.late_ns = device_s, late_ns
        else:
            self._buckets.append(_Bucket(number, device_s, late_ns))
        self._fit = None

    @property
    def fit(self) -> ClockFit:
        """The present estimate; all zero before the first observation."""
        if self._fit is None:
            self._fit = self._estimate()
        return self._fit

    def host_ns(self, device_s: Float64Array) -> Int64Array:
        """Return host times for device times, shape (n,); they never go back, even where the fit moves."""
        fit = self.fit
        stamps = fit.offset_ns + np.rint(device_s * ((1.0 + fit.drift) * _NS)).astype(np.int64)
        if stamps.size:
            if self._last_stamp_ns is not None:
                np.maximum(stamps, self._last_stamp_ns + 1, out=stamps)
                stamps = np.maximum.accumulate(stamps - np.arange(len(stamps))) + np.arange(len(stamps))
            self._last_stamp_ns = int(stamps[-1])
        return stamps

    def restart(self) -> None:
        """Forget the device's clock, as after it was switched off; stamps still do not go back."""
        self._buckets.clear()
        self._fit = None

    def _estimate(self) -> ClockFit:
        if not self._buckets:
            return ClockFit(0, 0.0, 0.0, 0.0)
        device_s = np.array([bucket.device_s for bucket in self._buckets])
        late_s = np.array([bucket.late_ns for bucket in self._buckets]) / _NS
        span_s = float(device_s[-1] - device_s[0])
        drift = 0.0
        if span_s >= self._drift_after_s:
            centred = device_s - device_s.mean()
            drift = float(centred @ late_s / (centred @ centred))
            offset_s = float(late_s.mean() - drift * device_s.mean())
        else:
            offset_s = float(late_s.min())
        residual_s = float(np.sqrt(np.mean((late_s - offset_s - drift * device_s) ** 2)))
        return ClockFit(self._origin_ns + round(offset_s * _NS), drift, residual_s, span_s)
