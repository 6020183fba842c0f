"""Recordings of EMG: every format gives the same muscles, or an error that says where and what is missing."""

from __future__ import annotations

import csv
import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import edfio
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.identification.emg.muscles import ImportOptions, Muscles, read_muscles
from palp_core.palpation.identification.emg.timing import TimeFault, time_samples
from tests.palpation.identification.emg.xdf_writer import XdfStream, xdf

N = 400
EMG = 1e-4 * np.random.default_rng(0).normal(size=(2, N))
FDS, EDC = EMG
TIMES_S = np.arange(N) / 1000.0
GONE, LONG_GONE = np.r_[0:100, 150:N], np.r_[0:600, 1300:3200]


def read(path: Path, fs: float | None = None, **chosen: Any) -> Muscles:
    return read_muscles(path, ImportOptions(fs, **chosen))


def table(
    heading: str = "time_s,fds,edc", *columns: Any, delimiter: str = ",", quoting: Any = csv.QUOTE_MINIMAL
) -> str:
    """Return columns of numbers or texts below heading lines; without columns the time and both muscles."""
    text = io.StringIO()
    rows = csv.writer(text, delimiter=delimiter, quoting=quoting, lineterminator="\n")
    for row in zip(*(columns or (TIMES_S, *EMG)), strict=True):
        rows.writerow([cell if isinstance(cell, str) else f"{cell:.14g}" for cell in row])
    return (heading + "\n" if heading else "") + text.getvalue()


Write = Callable[[Path], None]


def npz(**arrays: Any) -> Write:
    return lambda path: np.savez(path, **arrays)


def edf(signals: np.ndarray = EMG, *, wide: bool = False, labels: str = "FDS EDC") -> bytes:
    """Return signals in V as an EDF or BDF file in uV, records of one second at 100 Hz."""
    kind = edfio.BdfSignal if wide else edfio.EdfSignal
    rows = [
        kind(1e6 * row, 100.0, label=label, physical_dimension="uV")
        for row, label in zip(signals, labels.split(), strict=True)
    ]
    return (edfio.Bdf if wide else edfio.Edf)(rows, data_record_duration=1.0).to_bytes()  # type: ignore[arg-type]


def lsl(samples: np.ndarray = EMG, times_s: np.ndarray = TIMES_S, **more: Any) -> XdfStream:
    given_: dict[str, Any] = {"name": "Noraxon", "kind": "EMG", "rate_hz": 1000.0, "labels": ("FDS", "EDC")}
    given_ |= {"samples": 1e6 * samples.T, "times_s": 7.0 + times_s, "form": "double64"}
    return XdfStream(**(given_ | more))


MARKERS = XdfStream("Trials", "Markers", 0.0, ["begin", "end"], [7.1, 7.2], form="string")
NOMINAL = "the nominal rate of the stream"
RECORDS = np.zeros(N, dtype=[("fds", float), ("edc", float)])
RECORDS["fds"], RECORDS["edc"] = EMG
TIME = "the time column 0 'time_s' [s]"
UNITLESS = ", in seconds as it states no unit,"
TEXTS: dict[str, tuple[str | bytes, dict[str, Any], str]] = {
    "seconds": (table(), {}, TIME),
    "milliseconds": (
        table("Time (ms),FDS (V),EDC (V)", 1e3 * TIMES_S, *EMG),
        {},
        "the time column 0 'Time' [ms]",
    ),
    "a time without a unit": (table("t,fds,edc"), {}, f"the time column 0 't'{UNITLESS}"),
    "blanks, no heading": (table("", *EMG, delimiter=" "), {"fs": 1000.0, "fds": "0", "edc": "1"}, "--fs"),
    "tabs, UTF-16": (table("time_s\tfds\tedc", delimiter="\t").encode("utf-16"), {}, TIME),
    "semicolons, a row of units, Latin-1, an empty last column": (
        "Versuch f\u00fcr S7\nZeit;Extensor;Flexor;\nms;mV;mV;\n".encode("latin-1")
        + table("", 1e3 * TIMES_S, *1e3 * EMG[::-1], [""] * N, delimiter=";").encode(),
        {},
        "the time column 0 'Zeit' [ms]",
    ),
    "quotes, a unit behind a comma": (
        table('"Time, ms","FDS, uV","EDC, uV"', 1e3 * TIMES_S, *1e6 * EMG, quoting=csv.QUOTE_ALL),
        {},
        "the time column 0 'Time' [ms]",
    ),
    "each muscle has its own time": (
        table("X[s],FDS [V],X[s],EDC [V],X[s],FDS: ACC [g]", TIMES_S, FDS, TIMES_S, EDC, 6.75 * TIMES_S, FDS),
        {},
        "the time column 0 'X' [s]",
    ),
    "two voltages": (table("time_s,FDS (mV),EDC (\u03bcV)", TIMES_S, 1e3 * FDS, 1e6 * EDC), {}, TIME),
    "a name twice, by index": (table("time_s,emg,emg"), {"fds": "1", "edc": "2"}, TIME),
    "free text on rates is not believed": ("# Line frequency 50 Hz\n# rate: 70\n" + table(), {}, TIME),
}
FILES: dict[str, tuple[Write | bytes, dict[str, Any], str]] = {
    "npz": (npz(fds=FDS, edc=EDC, fs=1000.0, frame_rate=100.0), {}, "key 'fs'"),
    "volts.npz": (npz(fds_v=FDS, edc_v=EDC, rate_hz=np.array([1000])), {}, "key 'rate_hz'"),
    "time.npz": (npz(time=TIMES_S, fds=FDS, edc=EDC, fs=1000.0), {}, f"the time column 0 'time'{UNITLESS}"),
    "rows.npz": (npz(emg=EMG, note="x", fs=1000.0), {"fds": "0", "edc": "1"}, "key 'fs'"),
    "columns.npz": (npz(emg=EMG.T, srate=1000.0), {"fds": "emg[0]", "edc": "emg[1]"}, "key 'srate'"),
    "records.npz": (npz(rec=RECORDS, sample_rate=1000.0), {}, "key 'sample_rate'"),
    "edf": (edf(), {}, "the header's record length"),
    "triggers.bdf": (
        edf(np.concatenate([EMG, EMG[:1]]), wide=True, labels="FDS EDC Status"),
        {},
        "the header's record length",
    ),
    "xdf": (xdf(MARKERS, lsl()), {}, NOMINAL),
    "clock.xdf": (xdf(MARKERS, lsl(), offset_s=123.4), {}, NOMINAL),
    "jitter.xdf": (xdf(lsl(times_s=TIMES_S + 2e-3 * np.random.default_rng(1).random(N))), {}, NOMINAL),
}


def made(folder: Path, name: str, content: str | bytes | Write) -> Path:
    """Write a file; its name says the format."""
    path = folder / f"a.{name.split('.')[-1]}"
    if callable(content):
        content(path)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("name", "content", "options", "rate_from"),
    [*(("csv", *row) for row in TEXTS.values()), *((name, *row) for name, row in FILES.items())],
    ids=[*TEXTS, *FILES],
)
def test_every_format_gives_the_same_muscles(
    tmp_path: Path, name: str, content: str | bytes | Write, options: dict[str, Any], rate_from: str
) -> None:
    found = read(made(tmp_path, name, content), **options)
    assert found.samples == pytest.approx(EMG, abs=2e-8)
    assert found.rate_hz == pytest.approx(100.0 if name[-3:] in ("edf", "bdf") else 1000.0)
    assert found.rate_from == rate_from


def packed_zeros(path: Path) -> None:
    """Write an archive that states more than it has."""
    np.savez(path, fds=FDS, edc=EDC, fs=1000.0)
    data = bytearray(path.read_bytes())
    place = data.index(b"PK\x01\x02") + 24  # in the directory at its end: the size of the first when unpacked
    data[place : place + 4] = (0xF0000000).to_bytes(4, "little")
    path.write_bytes(data)


def patched(data: bytes, at: int, field: bytes) -> bytes:
    return data[:at] + field + data[at + len(field) :]


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "a name twice": (table("time_s,emg,emg"), {}, r"'emg' is there twice.*1 'emg', 2 'emg'"),
    "a chosen name twice": (
        table("time_s,emg,emg"),
        {"fds": "emg", "edc": "2"},
        "several columns are named 'emg'; give --fds an index",
    ),
    "names that say nothing": (
        table("time_s,a,b"),
        {},
        r"which column is the flexor.*of 0 'time_s' \[s\], 1 'a', 2 'b'",
    ),
    "one name that says something": (table("time_s,fds,b"), {}, "which column is the extensor"),
    "no such column": (table(), {"fds": "z"}, "no column 'z'; give --fds an index of 0 'time_s'"),
    "no such index": (table(), {"fds": "7"}, "no column '7'"),
    "one column twice": (table(), {"fds": "1", "edc": "fds"}, "are the same column, 1 'fds'"),
    "the time as a muscle": (table(), {"fds": "0"}, r"column 0 'time_s' \[s\] is a time"),
    "free text about a rate": (
        "# rate: 1,000 Hz\n" + table("fds,edc", *EMG),
        {},
        "line 1 says '# rate: 1,000 Hz'; state it with --fs",
    ),
    "two rates": (table(), {"fs": 1500.0}, r"time column 0 'time_s' \[s\] gives 1000 Hz, but --fs 1500 Hz"),
    "a time that goes back": (
        table("time_s,fds,edc", np.r_[TIMES_S[:200], TIMES_S[:200]], *EMG),
        {},
        "line 202: the time in column 0 'time_s' .* goes back from 0.199 to 0;",
    ),
    "a time that repeats": (
        table("time_s,fds,edc", np.r_[TIMES_S[:200], TIMES_S[199:-1]], *EMG),
        {},
        "line 202: the time in column 0 'time_s' .* repeats 0.199;",
    ),
    "a time that stands": (
        table("time_s,fds,edc", 0.0 * TIMES_S, *EMG),
        {},
        "line 3: the time .* never moves",
    ),
    "a time that is missing": (
        table("time_s,fds,edc", ["" if i == 7 else f"{one:g}" for i, one in enumerate(TIMES_S)], *EMG),
        {},
        "line 9: the time .* is missing",
    ),
    "a gap of a day": (
        table("time_s,fds,edc", TIMES_S + 86400.0 * (TIMES_S > 0.2), *EMG),
        {},
        "line 203: the time .* jumps from 0.2 to 86400.2",
    ),
    "underscores": (table("fds,edc", ["1_0"] * N, FDS), {}, "line 101: '1_0' is not a number"),
    "a decimal comma": ("fds;edc\n" + "0,5;0,25\n" * 30, {}, "no table of numbers"),
    "a row of another length": (
        "fds,edc\n" + "1,2\n" * 10 + "3\n" + "1,2\n" * 10,
        {},
        "line 12: not a row of 2 numbers",
    ),
    "a word in a row": ("fds,edc\n" + "1,2\n" * 10 + "1,rest\n" + "1,2\n" * 10, {}, "line 12: not a row"),
    "no number": (
        table("time_s,fds,edc", TIMES_S, FDS, ["nan"] * N),
        {},
        "column 2 'edc' has no finite number",
    ),
    "a number that is no EMG": (
        table("time_s,fds,edc", TIMES_S, FDS, [*["0.1"] * (N - 1), "-1e300"]),
        {},
        r"line 401: column 2 'edc' holds -1e\+300; no EMG is as large",
    ),
    "a unit and none": (
        table("time_s,FDS (mV),EDC"),
        {},
        "FDS in mV and EDC in no unit; state the unit of both with --unit",
    ),
}
EMPTY = b"0       " * 2
REFUSED_FILES: dict[str, tuple[bytes | Write, str]] = {
    "no key.npz": (npz(fds=FDS, edc=EDC, frame_rate=100.0), "key 'frame_rate' is 100.0; state it with --fs"),
    "two keys.npz": (
        npz(fds=FDS, edc=EDC, fs=1000.0, srate=2000.0),
        "key 'fs' says 1000 Hz, key 'srate' says 2000 Hz",
    ),
    "square.npz": (npz(emg=np.zeros((9, 9)), fs=1000.0), "'emg' is square"),
    "lengths.npz": (npz(fds=FDS, edc=EDC[:-1], fs=1000.0), "have 400 and 399 samples"),
    "objects.npz": (npz(fds=np.array([{}] * 9, dtype=object)), "not a readable NPZ file"),
    "zeros.npz": (packed_zeros, "unpacks to more than 2 GiB"),
    "gaps.edf": (patched(edf(), 192, b"EDF+D"), r"its records have gaps \(EDF\+D\)"),
    "no record.edf": (edf()[: 256 * 3], "no whole record of positive duration"),
    "another.edf": (b"1" + edf()[1:], "not an EDF or BDF file"),
    "no range.edf": (patched(patched(edf(), 464, EMPTY), 480, EMPTY), r"holds no usable signal \(FDS, EDC\)"),
    "no EMG.xdf": (xdf(MARKERS), "has no stream of type EMG; it has: no stream of numbers"),
    "no rate.xdf": (xdf(lsl(rate_hz=0.0)), "is sampled irregularly"),
    "rate.xdf": (
        xdf(lsl(rate_hz=1500.0)),
        "the nominal rate of the stream gives 1500 Hz, but its time stamps 1000 Hz",
    ),
    "no sample.xdf": (xdf(lsl(EMG[:, :0], TIMES_S[:0])), "has no sample"),
    "twice.xdf": (xdf(lsl(), lsl()), "'Noraxon: FDS' is there twice"),
}


@pytest.mark.parametrize(
    ("name", "content", "options", "words"),
    [
        *(("csv", *row) for row in REFUSED.values()),
        *((name, content, {}, words) for name, (content, words) in REFUSED_FILES.items()),
    ],
    ids=[*REFUSED, *REFUSED_FILES],
)
def test_what_a_file_does_not_say_is_asked_for(
    tmp_path: Path, name: str, content: str | bytes | Write, options: dict[str, Any], words: str
) -> None:
    path = made(tmp_path, name, content)
    with pytest.raises(PalpError, match=rf"{path.name}: .*{words}"):
        read(path, **options)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".edf", ".bdf", ".xdf"])
@pytest.mark.parametrize(
    "content",
    [b"", b"rubbish\n", b"0       " + b"x" * 300, bytes(range(256)) * 3, b'"' * 200_000, b"XDF:\x09\x00"],
)
def test_what_is_no_recording_is_refused_with_its_name(
    tmp_path: Path, suffix: str, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(PalpError, match="bad"):
            read_emg(path)
    assert caplog.text == ""


def test_missing_and_unknown_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="no such file"):
        read_emg(tmp_path / "a.csv")
    (tmp_path / "a.mat").write_text("1")
    with pytest.raises(PalpError, match=r"cannot read '\.mat' files; convert it to one of \.csv"):
        read_emg(tmp_path / "a.mat")
    with pytest.raises(PalpError, match="without a bag"):
        read_emg(tmp_path)
    with (tmp_path / "a.npz").open("wb") as file:
        np.save(file, EMG)
    with pytest.raises(PalpError, match=r"a single array.*numpy\.savez"):
        read_emg(tmp_path / "a.npz")


PADDED = np.concatenate([EMG[:, :330], np.zeros((2, 70))], axis=1)
NOTED: dict[str, tuple[str, bytes, int, str]] = {
    "cut text": ("csv", table()[:-30].encode(), N - 1, "line 401 is left out"),
    "cut EDF": ("edf", edf()[:-30], 300, "the header promises 4 records, the file has 3"),
    "padded EDF": ("edf", edf(PADDED), 330, "the last record is padded; its last 0.7 s are left out"),
    "padded BDF": ("bdf", edf(PADDED, wide=True), 330, "the last record is padded"),
    "cut XDF": ("xdf", xdf(lsl())[:-600], 350, "cut or damaged after"),
    "a stream of another type": ("xdf", xdf(lsl(kind="EEG")), N, "no stream is of type EMG"),
}


@pytest.mark.parametrize("name", NOTED)
def test_what_is_left_out_is_noted(tmp_path: Path, name: str) -> None:
    suffix, content, kept, words = NOTED[name]
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content)
    found = read(path)
    assert found.samples.shape[1] == kept
    assert found.samples == pytest.approx(EMG[:, :kept], abs=2e-8)
    assert any(words in note for note in found.notes), found.notes


def test_a_signal_that_cannot_be_scaled_is_left_out_of_an_edf(tmp_path: Path) -> None:
    data = edf(np.concatenate([EMG, EMG[:1]]), labels="FDS EDC -")
    limits = 256 + 104 * 3  # where the ranges of three signals begin: least and most, physical and digital
    for field in (2, 5):
        data = patched(data, limits + 8 * field, b"0       ")
    (tmp_path / "a.edf").write_bytes(data)
    assert read(tmp_path / "a.edf").samples == pytest.approx(EMG, abs=2e-8)
    assert "signal '-' is left out: its range in the header is empty" in read_emg(tmp_path / "a.edf").notes


@pytest.mark.parametrize(
    ("name", "content"),
    [
        *(
            ("csv", table("time_s,fds,edc", times_s[GONE], *EMG[:, GONE]))
            for times_s in (TIMES_S, TIMES_S * 1.0004, np.round(TIMES_S * 1.003, 4), 1.7e9 + TIMES_S)
        ),
        ("xdf", xdf(lsl(np.tile(EMG, 8)[:, LONG_GONE], LONG_GONE / 1e3))),
    ],
)
def test_gaps_of_the_time_are_lost_samples(tmp_path: Path, name: str, content: str | bytes) -> None:
    found = read(made(tmp_path, name, content))
    first, count = (100, 50) if name == "csv" else (600, 700)
    assert np.flatnonzero(np.isnan(found.samples[0])).tolist() == list(range(first, first + count))
    assert found.samples[:, 0] == pytest.approx(EMG[:, 0], abs=2e-8)
    assert any("the times have gaps" in note for note in found.notes)


def test_two_streams_of_one_rate_stand_side_by_side_by_their_times(tmp_path: Path) -> None:
    late = 250
    first = lsl(EMG[:1], labels=("FDS",), name="left box")
    second = lsl(EMG[1:, late:], TIMES_S[late:], labels=("EDC",), name="right box")
    (tmp_path / "a.xdf").write_bytes(xdf(first, second))
    found = read(tmp_path / "a.xdf")
    assert found.names == ["0 'left box: FDS' [uV]", "1 'right box: EDC' [uV]"]
    assert np.isnan(found.samples[1, :late]).all()
    assert found.samples[1, late:] == pytest.approx(EDC[late:], abs=1e-12)


def test_every_cut_of_an_xdf_is_a_note_or_an_error(tmp_path: Path) -> None:
    whole, path, read_count = xdf(MARKERS, lsl()), tmp_path / "a.xdf", 0
    for size in [*range(0, 600, 23), *range(600, len(whole), 611)]:
        path.write_bytes(whole[:size])
        try:
            found = read_emg(path)
        except PalpError:
            continue
        kept = found.columns[0].samples
        assert np.array_equal(kept, 1e6 * FDS[: kept.size])
        assert found.notes or kept.size % 50 == 0
        read_count += 1
    assert read_count > 5


def test_infinite_and_missing_numbers_are_lost_samples_without_a_warning(tmp_path: Path) -> None:
    holes = dict(enumerate(["inf", "-inf", "1e999", "", "nan", "N/A", "-"], 50))
    cells = [holes.get(i, f"{one:.9g}") for i, one in enumerate(FDS)]
    made(tmp_path, "csv", table("time_s,FDS [V],EDC [V]", TIMES_S, cells, EDC))
    numbers = np.where(np.isin(np.arange(N), [*holes]), np.inf, FDS)
    np.savez(tmp_path / "a.npz", fds_v=numbers, edc_v=EDC, fs=1000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in tmp_path.iterdir():
            both = read(path).samples
            assert np.flatnonzero(np.isnan(both[0])).tolist() == [*holes]
            assert np.isfinite(both[1]).all()


def test_one_muscle_of_several_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table("biceps,triceps", *EMG), encoding="utf-8")
    found = read(path, 1500.0, fds="triceps", edc="none")
    assert (found.names, found.columns_from) == (["1 'triceps'"], "one muscle, chosen")
    with pytest.raises(PalpError, match="--edc none"):
        read(path, 1500.0, edc="none")


@pytest.mark.parametrize(
    ("times_s", "rate_hz"),
    [
        (np.floor(np.arange(3000) / 1500.0 * 1e3) / 1e3, 1500.0),  # two samples a stamp, at times one
        (np.round(np.arange(3000) / 1024.0, 3), 1024.0),  # one in 42 repeats
        (np.round(np.arange(3000) / 740.0, 3), 740.0),  # steps of one and two
        (np.round(np.delete(np.arange(3000) / 1500.0, np.arange(2000, 2050)), 4), 1500.0),
        (np.floor(TIMES_S * 100.0) / 100.0, 1000.0),
    ],
)
def test_the_rate_of_rounded_stamps_is_that_of_the_span(times_s: np.ndarray, rate_hz: float) -> None:
    found = time_samples(times_s)
    assert found.rate == pytest.approx(rate_hz, rel=max(1e-3, found.doubt))
    assert found.places[-1] in (times_s.size - 1, times_s.size + 49)


@settings(deadline=None, max_examples=50)
@given(st.sets(st.integers(1, 398), max_size=150), st.floats(0.97, 1.03))
def test_samples_missing_from_the_times_leave_their_places(gone: set[int], clock: float) -> None:
    kept = np.array([i for i in range(400) if i not in gone])
    lost = np.diff(kept) > 1
    assume(np.median(np.diff(kept)) == 1.0)
    assume(lost.mean() < 0.02 or np.ptp(kept - np.arange(kept.size) * 399 / (kept.size - 1)) > 2.0)
    found = time_samples(kept * clock / 1000.0)
    assert found.places.tolist() == kept.tolist()
    assert found.rate == pytest.approx(1000.0 / clock)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        ([0, 1, 2, 3, 4, 5, 5, 5, 5, 5, 5, 6], "repeats 5"),
        ([0, 0, 9, 9, 18, 18, 1e4, 1e4], "jumps from 18"),
        ([3], "never moves"),
    ],
)
def test_stamps_that_rounding_does_not_explain_are_faults(stamps: list[float], words: str) -> None:
    with pytest.raises(TimeFault, match=words):
        time_samples(np.array(stamps, dtype=float))
