"""C3D, the format of motion capture: analog channels with rate and unit, and what is refused in words."""

from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.identification.emg.guess import guess, muscles

FRAMES, PER_FRAME = 100, 20
EMG_V = (1e-4 * np.random.default_rng(0).normal(size=(2, FRAMES * PER_FRAME))).astype(np.float32)


def c3d(
    path: Path,
    labels: tuple[str, ...] = ("FDS", "EDC"),
    units: tuple[str, ...] = ("V", "V"),
    markers: tuple[str, ...] = ("elbow",),
) -> Path:
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(markers)
    file["data"]["points"] = np.ones((4, len(markers), FRAMES))
    if labels:
        file["parameters"]["ANALOG"]["RATE"]["value"] = [100.0 * PER_FRAME]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = list(labels)
        file["parameters"]["ANALOG"]["UNITS"]["value"] = list(units)
        rows = [EMG_V[i % 2] for i in range(len(labels))]
        file["data"]["analogs"] = np.array(rows, dtype=np.float64)[None]
    file.write(str(path))
    return path


def refused(path: Path) -> str:
    with pytest.raises(PalpError) as caught:
        read_emg(path)
    assert path.name in str(caught.value)
    return str(caught.value)


def test_analog_channels_are_columns_with_rate_and_unit(tmp_path: Path) -> None:
    file = read_emg(c3d(tmp_path / "one.c3d"))
    assert [(one.name, one.rate_hz, one.unit) for one in file.columns] == [
        ("FDS", 2e3, "V"),
        ("EDC", 2e3, "V"),
    ]
    assert np.array_equal([one.samples for one in file.columns], EMG_V)
    assert np.array_equal(muscles(file, guess(file)), EMG_V)


def test_a_force_plate_is_left_out_and_said(tmp_path: Path) -> None:
    file = read_emg(c3d(tmp_path / "one.c3d", ("Fz1", "FDS", "EDC"), ("N", "V", "V")))
    assert [one.name for one in file.columns] == ["FDS", "EDC"]
    assert file.notes == ("left out, in units that are none of EMG: Fz1 (N)",)


def test_a_file_without_emg_says_what_it_has(tmp_path: Path) -> None:
    assert "has no EMG: no analog channel, only 2 markers" in refused(
        c3d(tmp_path / "a.c3d", (), (), markers=("elbow", "wrist"))
    )
    assert "has no EMG: its analog channels are Fz1 (N)" in refused(c3d(tmp_path / "b.c3d", ("Fz1",), ("N",)))


def test_a_cut_file_is_refused_in_words(tmp_path: Path) -> None:
    whole = c3d(tmp_path / "whole.c3d").read_bytes()
    path = tmp_path / "cut.c3d"
    for size in (0, 100, 511, 512, 700, len(whole) // 2, len(whole) - 1000):
        path.write_bytes(whole[:size])
        refused(path)
    assert "is cut off" in refused(path)


def test_a_damaged_byte_is_refused_or_changes_no_sample(tmp_path: Path) -> None:
    whole, path = c3d(tmp_path / "whole.c3d").read_bytes(), tmp_path / "bad.c3d"
    said = {
        0: "read the processor type",  # where the parameters are
        2: "is cut off",  # markers
        4: "is cut off",  # analog values a frame
        16: "is cut off",  # where the data are
        515: "read the processor type",
        520: "its parameters 0 and",  # the name of the group POINT
    }
    for place in (*said, 512, 600):
        data = bytearray(whole)
        data[place] ^= 0xFF
        path.write_bytes(data)
        if place in said:
            assert said[place] in refused(path)
        else:
            assert np.array_equal([one.samples for one in read_emg(path).columns], EMG_V)
