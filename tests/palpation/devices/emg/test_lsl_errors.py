"""Whatever pylsl raises is the device's error, with the stream's name."""

from __future__ import annotations

import sys
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emg.emg_source import EmgSourceState
from palp_core.palpation.devices.emg.lsl import LslEmg


class GoneInlet:
    """The inlet of a stream that was withdrawn right after it was found."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def info(self, timeout: float) -> Any:
        raise RuntimeError("the operation failed due to a timeout.")


def test_a_stream_that_goes_while_it_is_opened_is_a_device_error(monkeypatch: pytest.MonkeyPatch) -> None:
    found = SimpleNamespace(nominal_srate=lambda: 1500.0, channel_count=lambda: 2)
    fake = SimpleNamespace(resolve_byprop=lambda *_: [found], StreamInlet=GoneInlet)
    monkeypatch.setitem(sys.modules, "pylsl", fake)
    source = LslEmg("band")
    with pytest.raises(DeviceError, match="'band' was found but does not open"):
        source.open(time.monotonic_ns(), EmgSourceState(), np.random.default_rng(0))
