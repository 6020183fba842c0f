"""A recording in an amplifier's place: each phase is played while it is asked for, and goes on later."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import DeviceError
from palp_core.palpation.identification.emg.playback import EmgPlayback, EmgPlaybackState

RATE_HZ = 1500.0


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Any]:
    """A recording of each phase, known by its strength, V."""
    rng = np.random.default_rng(1)
    found: dict[str, Any] = {}
    for name, strength_v, count in (("path", 1e-4, 3000), ("mvc", 3e-4, 1500), ("rest", 2e-6, 1500)):
        both = strength_v * rng.standard_normal((2, count))
        np.savez(tmp_path / f"{name}.npz", fds_v=both[0], edc_v=both[1], rate_hz=np.array(RATE_HZ))
        found[name] = str(tmp_path / f"{name}.npz")
    return found


def test_each_phase_is_played_while_it_is_asked_for(files: dict[str, Any]) -> None:
    device, state, rng = EmgPlayback(**files), EmgPlaybackState(), np.random.default_rng(0)
    device.open(0, state, rng)
    device.drain(0, state, rng)
    kept = {name: np.load(path)["fds_v"] for name, path in files.items()}
    rest = np.roll(kept["rest"], -1)  # its first sample was played before anything was asked for
    first, second = np.split(kept["path"], 2)
    asked = [
        ("rest", rest),
        ("mvc", kept["mvc"]),
        ("palpation", first),
        ("pause", rest),
        ("palpation", second),
    ]
    for number, (phase, wanted) in enumerate(asked, 1):
        device.cue(phase, "", state)
        np.testing.assert_array_equal(device.drain(number * 1_000_000_000, state, rng).fds_v, wanted)


def test_a_phase_that_is_nowhere_and_no_recording_at_all_are_refused(files: dict[str, Any]) -> None:
    with pytest.raises(DeviceError, match="has no phase 'mvc'"):
        EmgPlayback(path=files["path"], rest=files["rest"])
    with pytest.raises(DeviceError, match="no such file"):
        EmgPlayback(path="nowhere.csv")
    with pytest.raises(DeviceError, match="and not 2000 Hz"):
        EmgPlayback(**files, rate_hz=2000.0)
    with pytest.raises(DeviceError, match="give recording:=FILE"):
        EmgPlayback(path="").open(0, EmgPlaybackState(), np.random.default_rng(0))
