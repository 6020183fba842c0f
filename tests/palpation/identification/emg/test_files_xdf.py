"""XDF, what LabRecorder writes: columns, gaps, streams side by side, and what is refused in words."""

from __future__ import annotations

import contextlib
import gzip
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import EmgFile, read_emg
from palp_core.palpation.identification.emg.muscles import ImportOptions, choose_muscles
from tests.palpation.identification.emg.xdf_writer import XdfStream, chunk, count_of, xdf

RATE_HZ = 1000.0
N = 2000
EMG_UV = 100.0 * np.random.default_rng(0).normal(size=(N, 2))
TIMES_S = 7.0 + np.arange(N) / RATE_HZ


def emg(**more: Any) -> XdfStream:
    given: dict[str, Any] = {
        "name": "Noraxon",
        "kind": "EMG",
        "rate_hz": RATE_HZ,
        "samples": EMG_UV,
        "times_s": TIMES_S,
        "labels": ("FDS", "EDC"),
        "form": "double64",
    }
    return XdfStream(**(given | more))


MARKERS = XdfStream("Trials", "Markers", 0.0, ["begin", "end"], [7.1, 8.2], form="string")


def read(folder: Path, data: bytes, name: str = "one.xdf") -> EmgFile:
    (folder / name).write_bytes(data)
    return read_emg(folder / name)


def refused(folder: Path, data: bytes) -> str:
    with pytest.raises(PalpError) as caught:
        choose_muscles(read(folder, data), ImportOptions())
    assert "one.xdf" in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("offset_s", [0.0, 123.4])
def test_channels_are_columns_with_rate_and_unit(tmp_path: Path, offset_s: float) -> None:
    file = read(tmp_path, xdf(MARKERS, emg(), offset_s=offset_s))
    assert [(one.name, one.rate_hz, one.unit) for one in file.columns] == [
        ("FDS", RATE_HZ, "uV"),
        ("EDC", RATE_HZ, "uV"),
    ]
    assert np.array_equal([one.samples for one in file.columns], EMG_UV.T)
    assert file.notes == ()
    assert np.allclose(choose_muscles(file, ImportOptions()).samples, EMG_UV.T * 1e-6, rtol=1e-12)


def samples_uv(file: EmgFile) -> np.ndarray[Any, Any]:
    return 1e6 * choose_muscles(file, ImportOptions()).samples


def test_jitter_of_the_time_stamps_moves_no_sample(tmp_path: Path) -> None:
    jitter_s = 2e-3 * np.random.default_rng(1).random(N)
    file = read(tmp_path, xdf(emg(times_s=TIMES_S + jitter_s)))
    assert np.allclose(samples_uv(file), EMG_UV.T)


def part(there: Any, **more: Any) -> XdfStream:
    return emg(samples=EMG_UV[there], times_s=TIMES_S[there], **more)


@pytest.mark.parametrize(
    ("streams", "noted"),
    [
        ((part(np.r_[0:600, 1300:N]),), None),
        (
            (part(np.r_[0:600]), part(np.r_[1300:N])),
            "the outlet of stream 'Noraxon' restarted: one recording with a gap of 0.701 s at sample 600",
        ),
        ((part(np.r_[1300:N]), part(np.r_[0:600])), "restarted"),
    ],
)
def test_a_gap_is_lost_samples_at_their_place(
    tmp_path: Path, streams: tuple[XdfStream, ...], noted: str | None
) -> None:
    file = read(tmp_path, xdf(*streams))
    expected = EMG_UV.T.copy()
    expected[:, 600:1300] = np.nan
    assert np.allclose(samples_uv(file), expected, equal_nan=True)
    assert not noted or noted in file.notes[0]


LONG = 40
LONG_S = 7.0 + np.arange(LONG * N) / RATE_HZ
LONG_UV = np.tile(EMG_UV, (LONG, 1))
LATE_S = np.tile(np.repeat([0.0, 2e-3, 0.0, 9e-3, 1e-3, 0.0, 30e-3, 4e-3], 125), LONG * 2)  # by chunks


@pytest.mark.parametrize("jitter_s", [0.0, LATE_S])
@pytest.mark.parametrize(
    ("step_s", "lost", "words"),
    [
        (0.0, 0, ""),
        (0.1, 100, "100 of 80100 samples count as lost, 100 after sample 49999"),
        (-0.3, 0, "the clock of stream 'Noraxon' goes back by 0.3 s at sample 50000"),
        (-5.0, 0, "the clock of stream 'Noraxon' goes back by 5 s at sample 50000"),
    ],
)
def test_a_step_of_the_clock_in_a_long_recording_is_noted_with_its_place(
    tmp_path: Path, step_s: float, lost: int, words: str, jitter_s: Any
) -> None:
    times_s = LONG_S + jitter_s + np.where(np.arange(LONG * N) < 50_000, 0.0, step_s)
    found = choose_muscles(
        read(tmp_path, xdf(emg(samples=LONG_UV, times_s=times_s), per_chunk=1000)), ImportOptions()
    )
    samples_uv = 1e6 * found.samples
    assert np.flatnonzero(np.isnan(samples_uv[0])).tolist() == list(range(50_000, 50_000 + lost))
    assert np.allclose(samples_uv[:, ~np.isnan(samples_uv[0])], LONG_UV.T)
    assert words in " ".join(found.notes)
    assert bool(found.notes) == bool(words)


def test_two_streams_of_one_rate_stand_side_by_side_by_their_times(tmp_path: Path) -> None:
    late = 250
    first = emg(samples=EMG_UV[:, :1], labels=("FDS",), name="left box")
    second = emg(samples=EMG_UV[late:, 1:], labels=("EDC",), name="right box", times_s=TIMES_S[late:])
    file = read(tmp_path, xdf(first, second))
    assert [one.name for one in file.columns] == ["left box: FDS", "right box: EDC"]
    fds, edc = samples_uv(file)
    assert np.allclose(fds, EMG_UV[:, 0])
    assert np.isnan(edc[:late]).all()
    assert np.allclose(edc[late:], EMG_UV[late:, 1])


def test_streams_of_one_name_at_the_same_time_are_chosen_by_index(tmp_path: Path) -> None:
    file = read(tmp_path, xdf(emg(), emg(samples=2.0 * EMG_UV)))
    with pytest.raises(PalpError, match="'Noraxon: FDS' is there twice"):
        choose_muscles(file, ImportOptions())
    found = choose_muscles(file, ImportOptions(fds="2", edc="1"))
    assert np.allclose(1e6 * found.samples, EMG_UV.T * [[2.0], [1.0]])


def test_a_packed_file_is_read_like_the_file(tmp_path: Path) -> None:
    file = read(tmp_path, gzip.compress(xdf(emg())), "one.xdfz")
    assert np.array_equal([one.samples for one in file.columns], EMG_UV.T)


def test_a_stream_without_labels_has_numbers_and_a_unit_of_its_own_word(tmp_path: Path) -> None:
    file = read(tmp_path, xdf(emg(labels=())))
    assert [(one.name, one.unit) for one in file.columns] == [("channel 1", ""), ("channel 2", "")]


def test_where_no_stream_is_of_type_emg_all_are_columns_and_that_is_noted(tmp_path: Path) -> None:
    slow = emg(
        name="Temperature", kind="Misc", rate_hz=10.0, times_s=7.0 + np.arange(N) / 10.0, labels=("a", "b")
    )
    file = read(tmp_path, xdf(emg(kind="EEG"), slow))
    assert [one.name for one in file.columns][1:3] == ["Noraxon: EDC", "Temperature: a"]
    assert np.allclose(samples_uv(file), EMG_UV.T)
    assert file.notes == ("no stream is of type EMG",)


def test_what_follows_the_last_whole_chunk_is_left_out_and_noted(tmp_path: Path) -> None:
    whole = xdf(emg())
    data = whole[: len(whole) * 2 // 3]
    file = read(tmp_path, data)
    kept = file.columns[0].samples.size
    assert 0 < kept < N
    assert kept % 50 == 0
    assert np.array_equal(file.columns[0].samples, EMG_UV[:kept, 0])
    assert "cut or damaged after" in file.notes[0]


@pytest.mark.parametrize("count", [0, 49, 51, 4_000_000_000])
def test_a_chunk_that_has_another_number_of_samples_is_left_out(tmp_path: Path, count: int) -> None:
    whole = xdf(emg())
    at = whole.index(count_of(50), len(whole) // 2)
    found = choose_muscles(
        read(tmp_path, whole[:at] + count_of(count) + whole[at + len(count_of(count)) :]), ImportOptions()
    )
    assert np.isnan(found.samples).sum() == 2 * 50
    assert re.search(rf"1 damaged chunk left out, the first at byte {at - 11}", found.notes[0]), found.notes


def test_every_cut_is_a_note_or_an_error_in_words(tmp_path: Path) -> None:
    whole = xdf(MARKERS, emg(samples=EMG_UV[:300], times_s=TIMES_S[:300]))
    for size in [*range(0, 600, 7), *range(600, len(whole), 211)]:
        found = None
        with contextlib.suppress(PalpError):
            found = read(tmp_path, whole[:size])
        if found is not None:
            kept = found.columns[0].samples
            assert np.array_equal(kept, EMG_UV[: kept.size, 0])
            assert found.notes or kept.size % 50 == 0


@pytest.mark.parametrize(
    ("streams", "shown"),
    [
        ((MARKERS,), "has no stream of type EMG; it has: no stream of numbers"),
        ((), "has no stream of type EMG"),
        ((emg(kind="EEG", rate_hz=0.0),), "it has: 'Noraxon' (EEG, 2 channels, no rate)"),
        ((emg(rate_hz=0.0),), "is sampled irregularly"),
        (
            (emg(rate_hz=float("nan")),),
            "damaged header of stream 1: nominal_srate is 'nan'; record or copy it",
        ),
        ((emg(name=""),), "damaged header of stream 1: name is ''"),
        ((emg(labels=("<",)),), "damaged header of stream 1: not well-formed"),
        ((emg(samples=np.zeros((0, 0)), times_s=[]),), "damaged header of stream 1: channel_count is '0'"),
        ((emg(times_s=[], form="float16"),), "damaged header of stream 1: channel_format is 'float16'"),
        ((emg(), emg(), part(np.r_[0:9])), "'Noraxon: FDS' is there twice"),
        ((emg(labels=("FDS", "EDC", "ACC")),), "cannot find the column of the flexor"),
        ((emg(rate_hz=1500.0),), "the nominal rate of the stream gives 1500 Hz, but its time stamps 1000 Hz"),
        ((emg(samples=np.zeros((0, 2)), times_s=[]),), "has no sample"),
        (
            (
                emg(labels=("FDS", "x")),
                emg(name="B", rate_hz=500.0, times_s=7.0 + np.arange(N) / 500.0, labels=("y", "EDC")),
            ),
            "the nominal rate of the stream gives 1000 Hz, but the nominal rate of the stream 500 Hz",
        ),
    ],
)
def test_what_is_no_recording_of_emg_is_refused_in_words(
    tmp_path: Path, streams: tuple[XdfStream, ...], shown: str
) -> None:
    assert shown in refused(tmp_path, xdf(*streams))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"XDF",
        b"RIFF" + bytes(100),
        b"XDF:" + chunk(2, struct.pack("<I", 1) + b"<info><broken"),
        b"XDF:" + chunk(2, struct.pack("<I", 1) + b"<info><name>a</name></info>"),
        b"XDF:" + chunk(3, struct.pack("<I", 9) + b"\x01\x01"),
        b"XDF:\x09\x00",
        gzip.compress(xdf(emg()))[:300],
    ],
)
def test_what_is_damaged_is_refused_in_words(
    tmp_path: Path, data: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    refused(tmp_path, data)
    assert caplog.text == ""
