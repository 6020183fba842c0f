import csv
import io
import re
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

N = 400
EMG = 1e-4 * np.random.default_rng(0).normal(size=(2, N))
TIMES_S = np.arange(N) / 1000.0


def read(path: Path, fs: float | None = None, **chosen: Any) -> Muscles:
    return read_muscles(path, ImportOptions(fs, **chosen))


def table(
    *columns: Any,
    heading: str = "time_s,fds,edc",
    delimiter: str = ",",
    decimal: str = ".",
    quoting: Any = csv.QUOTE_MINIMAL,
    form: str = ".9g",
) -> str:
    """Return columns of numbers or texts as a table below heading lines."""
    text = io.StringIO()
    rows = csv.writer(text, delimiter=delimiter, quoting=quoting, lineterminator="\n")
    for row in zip(*columns, strict=True):
        rows.writerow([one if isinstance(one, str) else f"{one:{form}}".replace(".", decimal) for one in row])
    return (heading + "\n" if heading else "") + text.getvalue()


def seconds(times_s: np.ndarray, before: str = "") -> list[str]:
    """Return times of day from noon on."""
    return [f"{before}12:{int(one // 60):02}:{one % 60:09.6f}" for one in times_s]


# --- what is read, all of it at 1000 Hz: name, text, options and source of the rate ---

UCI = """File Name: sentado.log
Channel 4: 'Recto Femoral', 400 values, engineering units: mV, no filters.
Channel 5: 'Biceps Femoral', 400 values, engineering units: mV, no filters.
Channel 8: 'Flexo-Extension', 400 values, engineering units: deg, no filters.
"""
TAB = "\t"
PLAIN = table(TIMES_S, *EMG)
Case = tuple[bytes, dict[str, Any], str]


def case(text: str | bytes, shown: str = "the time column 0 'time_s' [s]", **options: Any) -> Case:
    """Return a table, how it is read, and where its rate is from or what is wrong with it."""
    return text if isinstance(text, bytes) else text.encode(), options, shown


def at(name: str, unit: str = "", index: int = 0) -> str:
    """Return that the rate is that of a time column."""
    how = f" [{unit}]" if unit else ", in seconds as it states no unit,"
    return f"the time column {index} '{name}'{how}"


def headed(heading: str) -> str:
    """Return the plain table under other names."""
    return table(TIMES_S, *EMG, heading=heading)


READ: dict[str, Case] = {
    "seconds": case(PLAIN),
    "milliseconds in the heading": case(
        table(1e3 * TIMES_S, *EMG, heading="Time (ms),FDS (V),EDC (V)"), at("Time", "ms")
    ),
    "a time without a unit is in seconds": case(headed("t,fds,edc"), at("t")),
    "a time without a unit fits the user's rate": case(
        table(1e3 * TIMES_S, *EMG, heading="t,fds,edc"), "the time column 0 't'", fs=1000.0
    ),
    "a counter says nothing of the rate": case(
        table(np.arange(N), *EMG, heading="sample,fds,edc"), "--fs", fs=1000.0
    ),
    "no heading, the first column rises": case(headed(""), at("column0"), fds="1", edc="2"),
    "blanks, no heading": case(table(*EMG, heading="", delimiter=" "), "--fs", fs=1000.0, fds="0", edc="1"),
    "tabs, UTF-16": case(table(TIMES_S, *EMG, heading="time_s\tfds\tedc", delimiter=TAB).encode("utf-16")),
    "semicolons, decimal comma, a row of units, Latin-1, an empty last column": case(
        (
            "Versuch f\u00fcr S7\nZeit;Extensor;Flexor;\nms;mV;mV;\n"
            + table(1e3 * TIMES_S, *1e3 * EMG[::-1], [""] * N, heading="", delimiter=";", decimal=",").strip()
        ).encode("latin-1"),
        at("Zeit", "ms"),
    ),
    "quoted cells with a decimal comma": case(
        table(TIMES_S, *EMG, decimal=",", quoting=csv.QUOTE_ALL, heading='"time_s","fds","edc"')
    ),
    "each muscle has its own time": case(
        table(
            TIMES_S,
            EMG[0],
            TIMES_S,
            EMG[1],
            6.75 * TIMES_S,
            EMG[0],
            heading="X[s],FDS: EMG 1 [V],X[s],EDC: EMG 2 [V],X[s],FDS: ACC X [g]",
        ),
        at("X", "s"),
    ),
    "line ends in quoted headings": case(
        table(1e3 * TIMES_S, *1e6 * EMG, heading='"time\n(ms)","FDS\n\n(uV)","EDC\n(uV)"'), at("time", "ms")
    ),
    "a line end in a quoted number": case(PLAIN.replace("\n0.2,", '\n"0.2\n",')),
    "two time columns that agree": case(
        table(TIMES_S, 1e3 * TIMES_S, *EMG, heading="time_s,time_ms,fds,edc"), at("time_ms", "ms", 1)
    ),
    "dates": case(table(seconds(TIMES_S, "2024-03-30T"), *EMG, heading="when,fds,edc"), at("when", "s")),
    "times of day": case(table(seconds(TIMES_S), *EMG, heading="clock,fds,edc"), at("clock", "s")),
    "dates and times of day in columns of their own": case(
        table(["2024-03-30"] * N, seconds(TIMES_S), *EMG, heading="Date,Time,fds,edc"), at("Time", "s", 1)
    ),
    "a unit behind a comma": case(
        table(1e3 * TIMES_S, *1e6 * EMG, heading='"Time, ms","FDS, uV","EDC, uV"'), at("Time", "ms")
    ),
    "dates over midnight and a time zone": case(
        table(
            [
                f"2024-03-30 23:59:{59.9 + one:09.6f}+01:00"
                if one < 0.0999
                else f"2024-03-31 00:00:{one - 0.1:09.6f}+01:00"
                for one in TIMES_S
            ],
            *EMG,
            heading="when,fds,edc",
        ),
        at("when", "s"),
    ),
    "two characters for micro": case(
        table(TIMES_S, *1e6 * EMG, heading="time (s),FDS (\u00b5V),EDC (\u03bcV)"), at("time", "s")
    ),
    "UTF-8 read as Latin-1": case(
        table(TIMES_S, *1e6 * EMG, heading="time (s),FDS (\u00c2\u00b5V),EDC (microvolts)"), at("time", "s")
    ),
    "two voltages": case(
        table(TIMES_S, 1e3 * EMG[0], 1e6 * EMG[1], heading="time (s),FDS (mV),EDC (uV)"), at("time", "s")
    ),
    "a name that is there twice, by index": case(headed("time_s,emg,emg"), fds="1", edc="2"),
    "free text on rates is not believed": case("# Line frequency 50 Hz\n# heart rate: 70\n" + PLAIN),
    "lines of labels and of one unit for all": case(
        "# Labels:= time, flexor, extensor\n# engineering units: mV\n"
        + table(TIMES_S, *1e3 * EMG, heading=""),
        at("time"),
    ),
    "lines with keys, tabs": case(
        "Interval=\t0.001 s\nChannelTitle=\tFDS\tEDC\nRange=\t10.000 mV\t10.000 mV\n"
        + table(TIMES_S, *EMG, heading="", delimiter=TAB),
        at("column0"),
    ),
    "headings that begin with a digit, a form feed": case(
        "page\f1\n" + table(TIMES_S, *EMG, heading="time_s,1 FDS,2 EDC")
    ),
    "a muscle whose name speaks of time": case(
        headed("time_s,FDS real-time,EDC real-time"), fds="1", edc="2"
    ),
    "minutes": case(
        table(TIMES_S / 60.0, *EMG, heading="Time (min),fds,edc", form=".12g"), at("Time", "min")
    ),
    "stamps that are too coarse for a rate": case(
        table(np.floor(TIMES_S * 10.0) / 10.0, *EMG), "--fs", fs=1000.0
    ),
    "UTF-8 read as Latin-1 in a suffix": case(
        table(TIMES_S, *1e6 * EMG, heading="time_s,FDS_\u00c2\u00b5V,EDC_\u00ce\u00bcV")
    ),
    "a line for each channel": case(
        UCI + table(*1e3 * EMG, 90.0 + EMG[0], heading="", delimiter=TAB) + "\t\t\n",
        "--fs",
        fs=1000.0,
        fds="Recto Femoral",
        edc="1",
    ),
}


@pytest.mark.parametrize("name", READ)
def test_a_table_of_text_is_read(tmp_path: Path, name: str) -> None:
    text, options, rate_from = READ[name]
    path = tmp_path / "a.txt"
    path.write_bytes(text)
    found = read(path, **options)
    assert found.samples == pytest.approx(EMG, abs=1e-8)
    assert found.rate_hz == pytest.approx(1000.0)
    assert found.rate_from == rate_from


GONE = np.r_[0:100, 150:N]
COARSE_S = np.floor(TIMES_S * 100.0) / 100.0
REFUSED: dict[str, Case] = {
    "a name that is there twice": case(headed("time_s,emg,emg"), r"'emg' is there twice.*1 'emg', 2 'emg'"),
    "a chosen name that is there twice": case(
        headed("time_s,emg,emg"), "several columns are named 'emg'; give --fds an index", fds="emg", edc="2"
    ),
    "names that say nothing": case(
        headed("time_s,a,b"), r"the column of the flexor.*of 0 'time_s' \[s\], 1 'a', 2 'b'"
    ),
    "one name that says something": case(headed("time_s,fds,b"), "the column of the extensor"),
    "two flexors": case(headed("time_s,flexor 1,flexor 2"), "the column of the flexor"),
    "no such column": case(PLAIN, "no column 'z'; give --fds an index of 0 'time_s'", fds="z"),
    "no such index": case(PLAIN, "no column '7'", fds="7"),
    "one column twice": case(PLAIN, "are the same column, 1 'fds'", fds="1", edc="fds"),
    "the time as a muscle": case(PLAIN, r"column 0 'time_s' \[s\] is a time", fds="0"),
    "a corner of a filter": case(
        "# High-pass filter frequency: 20 Hz\n" + table(*EMG, heading="fds,edc"),
        "line 1 says '# High-pass filter frequency: 20 Hz'; state it with --fs",
    ),
    "a rate in thousands": case(
        "# Sampling rate: 1,000 Hz\n" + table(*EMG, heading="fds,edc"),
        "line 1 says '# Sampling rate: 1,000 Hz'; state it with --fs",
    ),
    "a counter alone": case(
        table(np.arange(N), *EMG, heading="sample,fds,edc"),
        "no time column and no field states the sampling rate",
    ),
    "a time in no unit that gives no rate of EMG": case(
        table(1e3 * TIMES_S / 1.5, *EMG, heading="t,fds,edc"), "state it with --fs"
    ),
    "two rates": case(PLAIN, r"the time column 0 'time_s' \[s\] gives 1000 Hz, but --fs 1500 Hz", fs=1500.0),
    "two rates, a time without a unit": case(
        headed("t,fds,edc"), "no unit, gives 1000 Hz, but --fs 1500 Hz", fs=1500.0
    ),
    "two times": case(
        table(TIMES_S, 2.0 * TIMES_S, *EMG, heading="time_s,time_s,fds,edc"),
        r"column 1 'time_s' \[s\] gives 500 Hz, but the time column 0 'time_s' \[s\] 1000 Hz",
    ),
    "milliseconds as seconds": case(
        table(1e3 * TIMES_S, *EMG), r"column 0 'time_s' \[s\] gives 1 Hz, at which no EMG is sampled"
    ),
    "a quote that never closes": case(
        PLAIN.replace("\n0.2,", '\n"0.2,'), "line 202: a quote opens a cell that never ends"
    ),
    "a line end in a quoted word": case(
        table(TIMES_S, *EMG, [""] * N, heading="time_s,fds,edc,").replace("\n0.2,", '\n"a\nb",'),
        "line 202: not a row of 4 numbers, 'a b' is none",
    ),
    "a time that goes back": case(
        table(np.r_[TIMES_S[:200], TIMES_S[:200]], *EMG),
        "line 202: the time in column 0 'time_s' .* goes back from 0.199 to 0;",
    ),
    "a time that repeats": case(
        table(np.r_[TIMES_S[:200], TIMES_S[199:-1]], *EMG),
        "line 202: the time in column 0 'time_s' .* repeats 0.199;",
    ),
    "a time that never moves": case(
        table(0.0 * TIMES_S, *EMG), "line 3: the time in column 0 'time_s' .* never moves", fs=1000.0
    ),
    "a time that is missing": case(
        table(["" if i == 7 else f"{one:g}" for i, one in enumerate(TIMES_S)], *EMG),
        "line 9: the time .* is missing",
    ),
    "a gap of a day": case(
        table(TIMES_S + 86400.0 * (TIMES_S > 0.2), *EMG), "line 203: the time .* jumps from 0.2 to 86400.2"
    ),
    "underscores": case(
        table(["1_0"] * N, EMG[0], heading="fds,edc"), "line 101: '1_0' is no number", fs=1000.0
    ),
    "dates that are not ISO": case(
        table(seconds(TIMES_S, "30.03.2024 "), *EMG, heading="when,fds,edc"),
        r"line 101: '30\.03\.2024 12:00:00\.099000' is no number, ISO date or hh:mm:ss",
    ),
    "a column of words": case(
        table(TIMES_S, *EMG, ["rest"] * N, heading="time_s,fds,edc,phase"), "line 101: 'rest' is no number"
    ),
    "a row of another length": case(
        "fds,edc\n" + "1,2\n" * 10 + "3\n" + "1,2\n" * 10, "line 12: not a row of 2 numbers, it has 1 cell"
    ),
    "a word in a row": case(
        "fds,edc\n" + "1,2\n" * 10 + "1,rest\n" + "1,2\n" * 10, "line 12: not a row of 2 numbers, 'rest'"
    ),
    "a day that is none": case(
        table(["2024-13-40 12:00:00"] * N, *EMG), "line 101: '2024-13-40 12:00:00' is no number"
    ),
    "a muscle without a number": case(
        table(TIMES_S, EMG[0], ["nan"] * N), "column 2 'edc' has no finite number"
    ),
    "a number that is no EMG": case(
        table(TIMES_S, EMG[0], [*["0.1"] * (N - 1), "-1e300"]),
        r"line 401: column 2 'edc' holds -1e\+300; no EMG is as large",
    ),
    "thousands with a point": case(
        table(["987", "1.234"] * (N // 2), EMG[0], heading="fds;edc", delimiter=";"),
        r"column 0: is '1\.234' a number of thousands",
        fs=1000.0,
    ),
    "thousands with a comma": case(
        table(["987", "1,234"] * (N // 2), ["0,5"] * N, heading="fds;edc", delimiter=";"),
        "column 0: is '1,234' a number of thousands",
        fs=1000.0,
    ),
    "stamps to the second": case(
        table([f"12:00:{i // 200:02}" for i in range(N)], *EMG),
        "'time_s' .* is rounded too much: its rate may be 100% off; state it with --fs",
    ),
    "a last column of which every cell is missing": case(
        "# Labels:= time_s, fds, edc\n# end\n" + table(TIMES_S, EMG[0], [""] * N, heading=""),
        "column 2 'edc' has no finite number",
    ),
    "bad first rows": case(
        "time_s,fds,edc\n" + table(TIMES_S, *EMG, heading="OL,OL,OL"), "cannot find the column of the flexor"
    ),
    "UTF-16 without its mark": case(PLAIN.encode("utf-16-le").decode(), "UTF-16 without its mark"),
    "a unit and none": case(
        headed("time_s,FDS (mV),EDC"), "FDS in mV and EDC in no unit; state the unit of both with --unit"
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_table_does_not_say_is_asked_for(tmp_path: Path, name: str) -> None:
    text, options, words = REFUSED[name]
    path = tmp_path / "a.csv"
    path.write_bytes(text)
    with pytest.raises(PalpError, match=rf"a\.csv: .*{words}"):
        read(path, **options)


@pytest.mark.parametrize(
    ("text", "kept", "words"),
    [
        (PLAIN + "Mean,0,0\n", N, "line 402 is left out, it is no row of the table: 'Mean,0,0'"),
        (PLAIN + "Mean,0,0\nSD,1,1\n", N, "line 403 is left out"),
        (PLAIN[:-30], N - 1, "line 401 is left out"),
        (PLAIN + "\0" * 512, N, "512 NUL characters at the end left out"),
        (headed("OL,OL,OL\ntime_s,fds,edc"), N, "line 1 does not name 3 columns; not used: 'OL,OL,OL'"),
        (PLAIN[:-1], N, "the last line has no end; it may be cut"),
        (table(TIMES_S, EMG[0], heading="biceps"), N, "line 1 does not name 2 columns; not used: 'biceps'"),
        (table(TIMES_S, EMG[0], heading="time_s,biceps"), N, "one muscle only"),
    ],
)
def test_what_is_left_out_of_a_table_is_noted(tmp_path: Path, text: str, kept: int, words: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    found = read(path) if "fds" in text else read(path, fds="1", edc="none")
    assert found.samples.shape[1] == kept
    assert found.samples[0] == pytest.approx(EMG[0, :kept], abs=1e-8)
    assert any(words in note for note in found.notes), found.notes


@pytest.mark.parametrize(
    "times_s", [TIMES_S, TIMES_S * 1.0004, np.round(TIMES_S * 1.003, 4), 1.7e9 + TIMES_S]
)
def test_gaps_of_the_time_are_lost_samples(tmp_path: Path, times_s: np.ndarray) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table(times_s[GONE], *EMG[:, GONE], form=".14g"), encoding="utf-8")
    found = read(path)
    assert found.samples.shape == (2, N)
    assert np.flatnonzero(np.isnan(found.samples[0])).tolist() == list(range(100, 150))
    assert "the times have gaps: 50 of 400 samples count as lost, 50 after line 101" in found.notes


def test_a_decimal_comma_that_comes_late_is_one(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("fds;edc\n" + "0;1\n" * 9 + "0,5;0,25\n" * 20, encoding="utf-8")
    assert [one.samples[[8, 9, -1]].tolist() for one in read_emg(path).columns] == [
        [0, 0.5, 0.5],
        [1, 0.25, 0.25],
    ]


def test_infinite_and_missing_numbers_are_lost_samples_without_a_warning(tmp_path: Path) -> None:
    holes = dict(enumerate(["inf", "-inf", "1e999", "", "nan", "N/A", "-"], 50))
    cells = [holes.get(i, f"{one:.9g}") for i, one in enumerate(EMG[0])]
    (tmp_path / "a.csv").write_text(
        table(TIMES_S, cells, EMG[1], heading="time_s,FDS [V],EDC [V]"), encoding="utf-8"
    )
    numbers = np.where(np.isin(np.arange(N), [*holes]), np.inf, EMG[0])
    np.savez(tmp_path / "a.npz", fds_v=numbers, edc_v=EMG[1], fs=1000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in tmp_path.iterdir():
            both = read(path).samples
            assert np.flatnonzero(np.isnan(both[0])).tolist() == [*holes]
            assert np.isfinite(both[1]).all()


@pytest.mark.parametrize(
    ("times_s", "rate_hz"),
    [
        (np.floor(np.arange(3000) / 1500.0 * 1e3) / 1e3, 1500.0),  # two samples a stamp, at times one
        (np.round(np.arange(3000) / 1024.0, 3), 1024.0),  # one in 42 repeats
        (np.round(np.arange(3000) / 740.0, 3), 740.0),  # steps of one and two
        (np.round(np.delete(np.arange(3000) / 1500.0, np.arange(2000, 2050)), 4), 1500.0),
        (COARSE_S, 1000.0),
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


def packed_zeros(path: Path) -> None:
    """Write an archive that states more than it has."""
    np.savez(path, fds=FDS, edc=EDC, fs=1000.0)
    data = bytearray(path.read_bytes())
    place = data.index(b"PK\x01\x02") + 24  # in the directory at its end: the size of the first when unpacked
    data[place : place + 4] = (0xF0000000).to_bytes(4, "little")
    path.write_bytes(data)


def npz(**arrays: Any) -> Callable[[Path], None]:
    return lambda path: np.savez(path, **arrays)


FDS, EDC = EMG
RECORDS = np.zeros(N, dtype=[("fds", float), ("edc", float)])
RECORDS["fds"], RECORDS["edc"] = EMG


@pytest.mark.parametrize(
    ("write", "options", "rate_from"),
    [
        (
            npz(fds=FDS, edc=EDC, fs=1000.0, frame_rate=100.0, heart_rate=70.0, line_frequency=50.0),
            {},
            "key 'fs'",
        ),
        (npz(fds_v=FDS, edc_v=EDC, rate_hz=np.array([1000])), {}, "key 'rate_hz'"),
        (npz(fds=FDS, edc=EDC, sampling_rate=1000, sfreq=1001.0), {}, "key 'sampling_rate'"),
        (npz(time=TIMES_S, fds=FDS, edc=EDC, fs=1000.0), {}, "the time column 0 'time'"),
        (npz(t=np.arange(9), fds=FDS, edc=EDC), {"fs": 1000.0}, "--fs"),
        (npz(emg=EMG, note="x", fs=1000.0), {"fds": "0", "edc": "1"}, "key 'fs'"),
        (npz(emg=EMG.T, sample_rate=1000.0), {"fds": "emg[0]", "edc": "emg[1]"}, "key 'sample_rate'"),
        (npz(rec=RECORDS, srate=1000.0), {}, "key 'srate'"),
        (
            npz(when=np.arange(N).astype("timedelta64[ms]"), fds=FDS, edc=EDC, x=np.array(["a"] * N)),
            {},
            "the time column 0 'when' [s]",
        ),
    ],
)
def test_an_archive_of_arrays(
    tmp_path: Path, write: Callable[[Path], None], options: dict[str, Any], rate_from: str
) -> None:
    write(tmp_path / "a.npz")
    found = read(tmp_path / "a.npz", **options)
    assert np.array_equal(found.samples, EMG)
    assert (found.rate_hz, found.rate_from) == (1000.0, rate_from)


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (
            npz(fds=FDS, edc=EDC, frame_rate=100.0),
            "sampling rate; key 'frame_rate' is 100.0; state it with --fs",
        ),
        (
            npz(fds=FDS, edc=EDC, fs=1000.0, srate=2000.0),
            "rates differ: key 'fs' 1000 Hz, key 'srate' 2000 Hz",
        ),
        (npz(fds=FDS, edc=EDC, fs=np.inf), "key 'fs' is inf; state it with --fs"),
        (npz(fds=FDS, fs=1000.0), "cannot find the column of the extensor"),
        (npz(fds=FDS, edc=EDC, time_s=TIMES_S, fs=2000.0), "gives 1000 Hz, but key 'fs' 2000 Hz"),
        (npz(emg=np.zeros((9, 9)), fs=1000.0), "'emg' is square"),
        (npz(fds=FDS, edc=EDC[:-1], fs=1000.0), "have 400 and 399 samples"),
        (npz(fds=np.array([{}] * 9, dtype=object)), "not a readable NPZ file.*; write plain arrays"),
        (packed_zeros, "unpacks to more than 2 GiB"),
        (lambda path: path.write_bytes(b"\x93NUMPY rubbish"), "not a readable NPZ file"),
    ],
)
def test_an_archive_that_does_not_say_enough(
    tmp_path: Path, write: Callable[[Path], None], words: str
) -> None:
    write(tmp_path / "a.npz")
    with pytest.raises(PalpError, match=rf"a\.npz: .*{words}"):
        read(tmp_path / "a.npz")


def test_a_single_array_is_no_archive(tmp_path: Path) -> None:
    with (tmp_path / "a.npz").open("wb") as file:
        np.save(file, EMG)
    with pytest.raises(PalpError, match=r"a single array.*numpy\.savez"):
        read(tmp_path / "a.npz")


def edf_bytes(
    signals: np.ndarray,
    rate: int,
    *,
    wide: bool = False,
    labels: dict[str, str] | None = None,
    starts_s: list[float] | None = None,
) -> bytes:
    """Return an EDF or BDF file of signals in the unit, records of one second."""
    most = 2**23 - 1 if wide else 2**15 - 1
    span = float(np.ceil(np.abs(signals).max()))
    units = labels or {"EMG FDS": "uV", "EMG EDC": "uV"}
    own, records, name = len(units), signals.shape[1] // rate, "BDF" if wide else "EDF"
    count = own + (starts_s is not None)
    fields = {
        "label": (16, [*units, f"{name} Annotations"]),
        "transducer": (80, [""] * (own + 1)),
        "unit": (8, [*units.values(), ""]),
        "pmin": (8, [f"{-span:g}"] * own + ["-1"]),
        "pmax": (8, [f"{span:g}"] * own + ["1"]),
        "dmin": (8, [str(-most)] * (own + 1)),
        "dmax": (8, [str(most)] * (own + 1)),
        "filter": (80, [""] * (own + 1)),
        "samples": (8, [str(rate)] * own + ["10" if wide else "15"]),
        "reserved": (32, [""] * (own + 1)),
    }
    kind = f"{name}+D" if starts_s is not None else ""
    main = (b"\xffBIOSEMI" if wide else b"0       ") + b" " * 160 + b"01.01.2601.01.26"
    head = f"{256 * (1 + count):<8}{kind:<44}{records:<8}{1:<8}{count:<4}".encode()
    text = "".join(f"{v:<{w}}" for w, values in fields.values() for v in values[:count]).encode()
    digital = np.rint(signals / span * most).astype("<i4")
    body = io.BytesIO()
    for record in range(records):
        for row in digital:
            part = row[record * rate : (record + 1) * rate]
            body.write(
                part.view(np.uint8).reshape(-1, 4)[:, :3].tobytes() if wide else part.astype("<i2").tobytes()
            )
        if starts_s is not None:
            body.write(f"+{starts_s[record]:g}\x14\x14".encode().ljust(30, b"\0"))
    return main + head + text + body.getvalue()


@pytest.mark.parametrize("wide", [False, True])
def test_edf_and_bdf(tmp_path: Path, wide: bool) -> None:
    path = tmp_path / ("a.bdf" if wide else "a.edf")
    path.write_bytes(edf_bytes(1e6 * EMG, 100, wide=wide))
    found = read(path)
    assert (found.names[0], found.rate_hz, found.unit) == ("0 'EMG FDS' [uV]", 100.0, "V")
    assert np.abs(found.samples - EMG).max() < (1e-10 if wide else 2e-8)


@pytest.mark.parametrize("wide", [False, True])
def test_gaps_of_a_discontinuous_edf_are_lost_samples(tmp_path: Path, wide: bool) -> None:
    path = tmp_path / ("a.bdf" if wide else "a.edf")
    path.write_bytes(edf_bytes(1e6 * EMG, 100, wide=wide, starts_s=[0.0, 1.0, 2.5, 3.5]))
    both = read(path).samples
    assert both.shape == (2, 450)
    assert np.flatnonzero(np.isnan(both[0])).tolist() == list(range(200, 250))
    assert np.abs(both[:, 250:] - EMG[:, 200:]).max() < 2e-8


@pytest.mark.parametrize("wide", [False, True])
def test_what_fills_up_the_last_record_is_no_signal(tmp_path: Path, wide: bool) -> None:
    path = tmp_path / ("a.bdf" if wide else "a.edf")
    filled = np.concatenate([1e6 * EMG[:, :330], np.zeros((2, 70))], axis=1)
    path.write_bytes(edf_bytes(filled, 100, wide=wide))
    file = read_emg(path)
    assert [one.samples.size for one in file.columns] == [330, 330]
    assert "the last record is padded; its last 0.7 s are left out" in file.notes
    path.write_bytes(edf_bytes(1e6 * EMG, 100, wide=wide))
    assert read_emg(path).notes == ()


def test_triggers_of_a_bdf_are_no_muscle(tmp_path: Path) -> None:
    path = tmp_path / "a.bdf"
    others = np.concatenate([EMG, EMG[:1], EMG[:1]])
    labels = {"EMG1+": "uV", "EMG2+": "uV", "ACC X": "g", "Status": "Boolean"}
    path.write_bytes(edf_bytes(1e6 * others, 100, wide=True, labels=labels))
    found = read(path, fds="0", edc="1")
    assert np.abs(found.samples - EMG).max() < 1e-10
    assert [one.name for one in read_emg(path).columns] == ["EMG1+", "EMG2+", "ACC X", "Status"]


@pytest.mark.parametrize("wide", [False, True])
def test_rates_units_and_annotations_of_a_library_that_writes_both_formats(
    tmp_path: Path, wide: bool
) -> None:
    path = tmp_path / ("a.bdf" if wide else "a.edf")
    signal = edfio.BdfSignal if wide else edfio.EdfSignal
    rows = [
        signal(1e6 * EMG[0], 100.0, label="EMG FDS", physical_dimension="uV"),
        signal(np.linspace(-1.0, 1.0, 40), 10.0, label="ACC X"),
    ]
    pressed = [edfio.EdfAnnotation(1.25, None, "press")]
    (edfio.Bdf if wide else edfio.Edf)(rows, annotations=pressed).write(path)  # type: ignore[arg-type]
    fds, acc, texts = read_emg(path).columns
    assert (fds.name, fds.rate_hz, fds.unit, fds.samples.size) == ("EMG FDS", 100.0, "uV", 400)
    assert (acc.name, acc.rate_hz, acc.unit, acc.samples.size) == ("ACC X", 10.0, "", 40)
    assert np.abs(acc.samples - np.linspace(-1.0, 1.0, 40)).max() < (1e-6 if wide else 4e-5)
    assert (texts.name[4:], texts.samples.size) == ("Annotations", 0)


def damaged(data: bytes, *fields: tuple[int, bytes]) -> bytes:
    """Return a file with other bytes at some places."""
    whole = bytearray(data)
    for at, text in fields:
        whole[at : at + len(text)] = text
    return bytes(whole)


TWO = edf_bytes(1e6 * EMG, 100)
GAPPED = edf_bytes(1e6 * EMG, 100, starts_s=[0.0, 1.0, 2.5, 3.5])
CONTINUOUS = GAPPED.replace(b"EDF+D", b"EDF+C")


@pytest.mark.parametrize(
    ("data", "kept", "words"),
    [
        (TWO[:-30], 300, "the header promises 4 records, the file has 3"),
        (TWO[:-30], 300, "370 bytes after the last whole record left out"),
        (TWO + b"?", 400, "1 byte after the last whole record left out"),
        (TWO + bytes(900), 400, "2 records of NUL at the end left out"),
        (damaged(TWO, (236, b"-1      ")), 400, "the recording was not closed: .* it has 4"),
        (damaged(TWO, (236, b"2       ")), 400, "the header promises 2 records, the file has 4"),
        (CONTINUOUS, 400, r"record 2 begins 1\.5 s after the one before, not 1 s"),
        (CONTINUOUS.replace(b"+2.5", b"+2  ").replace(b"+3.5", b"+3  "), 400, "record 2 has no start time"),
    ],
)
def test_an_edf_that_is_not_what_its_header_promises_is_noted(
    tmp_path: Path, data: bytes, kept: int, words: str
) -> None:
    (tmp_path / "a.edf").write_bytes(data)
    found = read(tmp_path / "a.edf")
    assert np.isfinite(found.samples).sum() == 2 * kept
    assert any(re.search(words, note) for note in found.notes), found.notes


THREE = edf_bytes(
    1e6 * np.concatenate([EMG, EMG[:1]]), 100, labels={"EMG FDS": "uV", "EMG EDC": "uV", "-": "uV"}
)
LIMITS = 256 + 104 * 3  # where the ranges of three signals begin


UNSCALED = "signal '-' is left out: its range in the header is empty or no number"


@pytest.mark.parametrize(
    ("data", "note"),
    [
        *((damaged(TWO, (184, length.ljust(8))), "") for length in (b"512", b"9999", b"abc", b"")),
        (TWO.replace(b"-32767  ", b"-32767.0").replace(b"32767   ", b"32767.0 "), ""),
        (damaged(THREE, (LIMITS + 8 * (6 + 2), b"0       "), (LIMITS + 8 * (9 + 2), b"0       ")), UNSCALED),
        (damaged(THREE, (LIMITS + 8 * 2, b"0       "), (LIMITS + 8 * (3 + 2), b"0       ")), UNSCALED),
        (damaged(THREE, (LIMITS + 8 * (6 + 2), b"        ")), UNSCALED),
        (damaged(THREE, (LIMITS + 8 * (9 + 2), b"nan     ")), UNSCALED),
    ],
)
def test_a_header_that_is_wrong_about_what_is_not_needed_costs_no_sample(
    tmp_path: Path, data: bytes, note: str
) -> None:
    path = tmp_path / "a.edf"
    path.write_bytes(data)
    assert np.abs(read(path).samples - EMG).max() < 2e-8
    assert note in "".join(read_emg(path).notes)


def test_a_signal_that_is_left_out_keeps_its_index(tmp_path: Path) -> None:
    path = tmp_path / "a.edf"
    path.write_bytes(damaged(THREE, (LIMITS + 8 * 6, b"0       "), (LIMITS + 8 * 9, b"0       ")))
    assert np.abs(read(path, fds="2", edc="1").samples - EMG).max() < 2e-8
    with pytest.raises(PalpError, match=r"column 0 'EMG FDS' .* has no finite number"):
        read(path, fds="0", edc="1")


def test_an_edf_padded_with_nul_and_with_names_that_repeat(tmp_path: Path) -> None:
    path, data = (
        tmp_path / "a.edf",
        edf_bytes(1e6 * np.concatenate([EMG, EMG[:1]]), 100, labels=dict.fromkeys("abc", "uV")),
    )
    head = data[: 256 * 4].replace(b" ", b"\0").replace(b"a\0", b"c\0", 1)
    path.write_bytes(head + data[256 * 4 :])
    assert [one.name for one in read_emg(path).columns] == ["c", "b", "c"]
    assert np.abs(read(path, fds="0", edc="1").samples - EMG).max() < 2e-8
    with pytest.raises(PalpError, match="several columns are named 'c'"):
        read(path, fds="c", edc="b")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (damaged(GAPPED, (256 + 32, b"Another signal  ")), "without annotations of the records' times"),
        (GAPPED.replace(b"+2.5\x14", b"nope\x14"), "record 2 has no start time"),
        (GAPPED.replace(b"+2.5\x14", b"+nan\x14"), "record 2 has no start time"),
        (
            GAPPED.replace(b"+2.5\x14", b"+0.5\x14"),
            "sample 200: the time of EMG FDS goes back from 1.99 to 0.5",
        ),
        (
            damaged(THREE, *((LIMITS + 8 * i, b"0       ") for i in range(6))),
            r"no usable signal \(EMG FDS, EMG EDC, -\)",
        ),
        (THREE[: 256 * 4], "no whole record of positive duration"),
        (damaged(THREE, (244, b"1,0     ")), r"no whole record of positive duration \('1,0' s\)"),
        (THREE[:900], "its header of 3 signals is cut"),
        (damaged(THREE, (252, b"3.5 ")), "damaged header: its number of signals is '3.5'"),
        (
            damaged(THREE, (256 + 216 * 3, b"abc     ")),
            "damaged header: its number of samples of signal 0 is 'abc'; record or copy it again",
        ),
        (b"1" + THREE[1:], "not an EDF or BDF file"),
    ],
)
def test_an_edf_that_cannot_be_used_is_refused(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.edf").write_bytes(data)
    with pytest.raises(PalpError, match=rf"a\.edf: .*{words}"):
        read(tmp_path / "a.edf")


def test_an_edf_of_annotations_alone_is_named_so(tmp_path: Path) -> None:
    edfio.Edf([], annotations=[edfio.EdfAnnotation(0.5, None, "press")]).write(tmp_path / "a.edf")
    with pytest.raises(PalpError, match="holds annotations only"):
        read(tmp_path / "a.edf")


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".edf", ".bdf", ".xdf"])
@pytest.mark.parametrize(
    "content", [b"", b"rubbish\n", b"0       " + b"x" * 300, bytes(range(256)) * 3, b'"' * 200_000]
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


def test_one_muscle_of_several_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(table(*EMG, heading="biceps,triceps"), encoding="utf-8")
    found = read(path, 1500.0, fds="triceps", edc="none")
    assert (found.names, found.columns_from) == (["1 'triceps'"], "one muscle, chosen")
    with pytest.raises(PalpError, match="--edc none"):
        read(path, 1500.0, edc="none")
