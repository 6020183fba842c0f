import io
import re
import sys
from pathlib import Path

import edfio
import numpy as np
import pytest
from scipy.io import savemat

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.identification.emg.guess import Guess, guess, muscles

N = 400
EMG = 1e-4 * np.random.default_rng(0).normal(size=(2, N))


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


def read(path: Path, fs_hz: float | None = 1500.0) -> tuple[Guess, np.ndarray]:
    file = read_emg(path)
    found = guess(file, fs_hz=fs_hz)
    return found, muscles(file, found)


def test_plain_csv_with_units_in_its_heading(tmp_path: Path) -> None:
    times = np.arange(N) / 1500.0
    path = tmp_path / "a.csv"
    np.savetxt(
        path,
        np.column_stack([times, *(1e6 * EMG)]),
        delimiter=",",
        header="time (s),FDS (uV),EDC (uV)",
        comments="",
    )
    found, both = read(path, None)
    assert (found.time, found.rate_hz, found.rate_why, found.unit) == (
        "time",
        1500.0,
        "the time column",
        "uV",
    )
    assert both == pytest.approx(EMG)


def test_european_csv_with_preamble_units_row_and_holes(tmp_path: Path) -> None:
    lines = ["Subject;7", "Sampling rate: 1500 Hz", "", "Zeit;Extensor;Flexor", "ms;mV;mV"]
    for i in range(N):
        cells = [f"{i / 1.5:.4f}", f"{1e3 * EMG[1, i]:.9f}", "" if i == 9 else f"{1e3 * EMG[0, i]:.9f}"]
        lines.append(";".join(cells).replace(".", ","))
    path = tmp_path / "a.csv"
    path.write_bytes("\r\n".join(lines).encode("latin-1"))
    found, both = read(path, None)
    assert (found.fds, found.edc, found.time, found.rate_hz) == ("Flexor", "Extensor", "Zeit", 1500.0)
    assert np.flatnonzero(np.isnan(both[0])).tolist() == [9]
    assert both[1] == pytest.approx(EMG[1], abs=1e-12)


def test_text_without_heading_goes_by_order(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    np.savetxt(path, EMG.T, fmt="%.12e")
    found, both = read(path)
    assert found.columns_why == "FDS by order, EDC by order"
    assert found.unit_why.startswith("guessed")
    assert both == pytest.approx(EMG)


def test_rows_missing_by_their_time_become_lost_samples(tmp_path: Path) -> None:
    table = np.delete(np.column_stack([np.arange(N) / 1500.0, *EMG]), [50, 51], axis=0)
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header="t,fds_v,edc_v", comments="")
    _, both = read(path, None)
    assert both.shape == (2, N)
    assert np.flatnonzero(np.isnan(both[0])).tolist() == [50, 51]


@pytest.mark.parametrize("name", ["a.npy", "b.npz", "c.mat", "d.mat", "e.h5"])
def test_arrays_of_every_kind(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "a.npy":
        np.save(path, EMG)
    elif name == "b.npz":
        np.savez(path, fds=EMG[0], edc=EMG[1], fs=1500.0)
    elif name == "c.mat":
        savemat(path, {"rec": {"emg": EMG.T, "fs": 1500.0, "labels": ["FDS", "EDC"], "note": "x"}})
    elif name == "d.mat":
        savemat(path, {"FDS": EMG[0], "EDC": EMG[1], "srate": 1500})
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            group = file.create_group("trial")
            group["fds"], group["edc"] = EMG[0], EMG[1]
            group.attrs["fs"] = 1500.0
            group["fds"].attrs["unit"] = "V"
    found, both = read(path, 1500.0 if name == "a.npy" else None)
    assert found.rate_hz == 1500.0
    assert both == pytest.approx(EMG)


@pytest.mark.parametrize("wide", [False, True])
def test_edf_and_bdf(tmp_path: Path, wide: bool) -> None:
    path = tmp_path / ("a.bdf" if wide else "a.edf")
    path.write_bytes(edf_bytes(1e6 * EMG, 100, wide=wide))
    found, both = read(path, None)
    assert (found.fds, found.rate_hz, found.unit) == ("EMG FDS", 100.0, "uV")
    assert np.abs(both - EMG).max() < (1e-10 if wide else 2e-8)


@pytest.mark.parametrize("wide", [False, True])
def test_gaps_of_a_discontinuous_edf_are_lost_samples(tmp_path: Path, wide: bool) -> None:
    path = tmp_path / ("a.bdf" if wide else "a.edf")
    path.write_bytes(edf_bytes(1e6 * EMG, 100, wide=wide, starts_s=[0.0, 1.0, 2.5, 3.5]))
    _, both = read(path, None)
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


def test_an_edf_with_other_signals_needs_no_names_where_two_are_voltages(tmp_path: Path) -> None:
    path = tmp_path / "a.bdf"
    others = np.concatenate([EMG, EMG[:1], EMG[:1]])
    labels = {"EMG1+": "uV", "EMG2+": "uV", "ACC X": "g", "Status": "Boolean"}
    path.write_bytes(edf_bytes(1e6 * others, 100, wide=True, labels=labels))
    found, both = read(path, None)
    assert (found.fds, found.edc) == ("EMG1+", "EMG2+")
    assert found.columns_why == "FDS by order, of the voltages, EDC by order, of the voltages"
    assert np.abs(both - EMG).max() < 1e-10
    assert [one.name for one in read_emg(path).columns] == ["EMG1+", "EMG2+", "ACC X"]


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
    said = [edfio.EdfAnnotation(1.25, None, "press")]
    (edfio.Bdf if wide else edfio.Edf)(rows, annotations=said).write(path)  # type: ignore[arg-type]
    fds, acc = read_emg(path).columns
    assert (fds.name, fds.rate_hz, fds.unit, fds.samples.size) == ("EMG FDS", 100.0, "uV", 400)
    assert (acc.name, acc.rate_hz, acc.unit, acc.samples.size) == ("ACC X", 10.0, "", 40)
    assert np.abs(acc.samples - np.linspace(-1.0, 1.0, 40)).max() < (1e-6 if wide else 4e-5)


@pytest.mark.parametrize("length", ["512", "9999", "abc", ""])
def test_an_edf_whose_header_is_wrong_about_its_own_length_is_read(tmp_path: Path, length: str) -> None:
    path, data = tmp_path / "a.edf", edf_bytes(1e6 * EMG, 100)
    path.write_bytes(data)
    expected = read(path)[1]
    path.write_bytes(data[:184] + length.ljust(8).encode() + data[192:])
    assert np.array_equal(read(path)[1], expected)


def test_digital_limits_of_an_edf_may_have_a_decimal_point(tmp_path: Path) -> None:
    path, data = tmp_path / "a.edf", edf_bytes(1e6 * EMG, 100)
    path.write_bytes(data)
    expected = read(path)[1]
    path.write_bytes(data.replace(b"-32767  ", b"-32767.0").replace(b"32767   ", b"32767.0 "))
    assert np.array_equal(read(path)[1], expected)


def test_a_cut_edf_keeps_its_whole_records_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.edf"
    path.write_bytes(edf_bytes(1e6 * EMG, 100)[:-30])
    file = read_emg(path)
    assert file.columns[0].samples.size == 300
    assert "promises 4 records, the file has 3" in file.notes[0]


@pytest.mark.parametrize("suffix", [".csv", ".npy", ".npz", ".mat", ".edf", ".bdf", ".h5"])
@pytest.mark.parametrize("content", [b"", b"rubbish\n", b"0       " + b"x" * 300, bytes(range(256)) * 3])
def test_what_is_no_recording_is_refused_with_its_name(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    with pytest.raises(PalpError, match="bad"):
        read_emg(path)


def test_missing_and_unknown_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="no such file"):
        read_emg(tmp_path / "a.csv")
    (tmp_path / "a.xyz").write_text("1")
    with pytest.raises(PalpError, match="no known kind"):
        read_emg(tmp_path / "a.xyz")
    with pytest.raises(PalpError, match="without a bag"):
        read_emg(tmp_path)


def test_a_row_of_another_length_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("fds,edc\n" + "1,2\n" * 10 + "3\n" + "1,2\n" * 10)
    with pytest.raises(PalpError, match="line 12"):
        read_emg(path)


def test_muscles_that_cannot_be_told_are_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    np.savetxt(
        path, np.random.default_rng(1).normal(size=(N, 4)), delimiter=",", header="a,b,c,d", comments=""
    )
    file = read_emg(path)
    with pytest.raises(PalpError, match="--fds and --edc"):
        guess(file)
    assert (guess(file, fds="3", edc="B").fds, guess(file, fds="3", edc="B").edc) == ("d", "b")
    with pytest.raises(PalpError, match="no column 'z'"):
        guess(file, fds="z")
    with pytest.raises(PalpError, match="same column"):
        guess(file, fds="a", edc="a")
    with pytest.raises(PalpError, match="state it with --fs"):
        muscles(file, guess(file, fds="a", edc="b"))


def test_a_matlab_file_of_version_7_3_is_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["emg"], file["fs"] = EMG, np.array([[1500.0]])
        file["comment"] = np.frombuffer(b"a long comment", np.uint8).astype(np.uint16)[:, None]
        file["comment"].attrs["MATLAB_class"] = np.bytes_(b"char")
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as raw:
        raw.write(header)
    found, both = read(path, None)
    assert (found.fds, found.edc, found.rate_hz) == ("emg[0]", "emg[1]", 1500.0)
    assert both == pytest.approx(EMG)


def test_an_hdf5_file_named_mat_is_read_too(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file["emg"] = EMG
    _, both = read(path)
    assert both == pytest.approx(EMG)


def test_without_h5py_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.h5").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(PalpError, match=re.escape(install_line("emg"))):
        read_emg(tmp_path / "a.h5")


def test_a_counter_of_samples_shows_what_was_lost(tmp_path: Path) -> None:
    table = np.delete(np.column_stack([np.arange(N), *EMG]), [50, 51], axis=0)
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header="sample,ch1,ch2", comments="")
    found, both = read(path)
    assert found.time == "sample"
    assert np.flatnonzero(np.isnan(both[0])).tolist() == [50, 51]


def test_a_stated_rate_that_differs_from_the_files_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, fds=EMG[0], edc=EMG[1], fs=2000.0)
    assert "--fs says 1500 Hz" in guess(read_emg(path), fs_hz=1500.0).notes[0]


@pytest.mark.parametrize("decimals", [4, 5, 9])
def test_a_rounded_time_column_tells_the_rate_all_the_same(tmp_path: Path, decimals: int) -> None:
    rng = np.random.default_rng(1)
    times = np.round(np.delete(np.arange(3000) / 1500.0, np.arange(2000, 2050)), decimals)
    table = np.c_[times, rng.standard_normal((times.size, 2))]
    path = tmp_path / "trial.csv"
    np.savetxt(path, table, delimiter=",", header="Time,FDS,EDC", comments="", fmt="%.9f")
    assert guess(read_emg(path)).rate_hz == pytest.approx(1500.0, rel=1e-3)


def preamble(path: Path, lines: list[str], table: np.ndarray, delimiter: str = "\t") -> Path:
    with path.open("w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
        np.savetxt(file, table, fmt="%.9g", delimiter=delimiter)
    return path


def test_names_and_units_that_lines_before_the_table_state(tmp_path: Path) -> None:
    said = ["# Simple Text Format", "# Sampling Rate (Hz):= 1500.00", "# Resolution:= 12"]
    path = preamble(
        tmp_path / "a.txt", [*said, "# Labels:= EDC\tFDS", "# engineering units: mV"], 1e3 * EMG.T
    )
    found, both = read(path, None)
    assert (found.fds, found.edc, found.rate_hz, found.unit) == ("FDS", "EDC", 1500.0, "mV")
    assert found.unit_why == "the file"
    assert both == pytest.approx(EMG[::-1], abs=1e-12)


@pytest.mark.parametrize(
    ("labels", "units", "delimiter"),
    [
        ("Labels:= flexor, extensor", "Engineering units = uV", "\t"),
        ("Channels: flexor extensor", "units: uV uV", ";"),
        ('Columns: ["time", "flexor", "extensor"]', "Units: s, uV, uV", ","),
    ],
)
def test_a_time_column_needs_no_name_or_unit_of_its_own(
    tmp_path: Path, labels: str, units: str, delimiter: str
) -> None:
    table = np.column_stack([np.arange(N) / 1500.0, *(1e6 * EMG)])
    path = preamble(tmp_path / "a.csv", [f"# {labels}", f"# {units}"], table, delimiter)
    found, both = read(path, None)
    assert (found.time, found.fds, found.edc, found.unit) == ("time", "flexor", "extensor", "uV")
    assert both == pytest.approx(EMG, abs=1e-12)


def test_names_that_do_not_fit_the_table_are_said_and_not_used(tmp_path: Path) -> None:
    path = preamble(tmp_path / "a.txt", ["# Labels:= a, b, c, d", "# Channels: 2"], EMG.T)
    file = read_emg(path)
    assert "'Labels' names 4 columns, the table has 2; not used" in file.notes
    assert [one.name for one in file.columns] == ["column0", "column1"]


@pytest.mark.parametrize("kind", ["text", "timed", "npy", "mat"])
def test_a_file_of_one_muscle(tmp_path: Path, kind: str) -> None:
    times_s = np.arange(N) / 1500.0
    if kind == "text":
        path = preamble(tmp_path / "a.txt", ["# Sampling Rate (Hz):= 1500.00", "# Labels:= EMG"], EMG[0])
    elif kind == "timed":
        path = preamble(tmp_path / "a.csv", ["seconds,biceps"], np.c_[times_s, EMG[0]], ",")
    elif kind == "npy":
        path = tmp_path / "a.npy"
        np.save(path, EMG[0])
    else:
        path = tmp_path / "a.mat"
        savemat(path, {"emg": EMG[0], "t": times_s})
    found, both = read(path, 1500.0 if kind == "npy" else None)
    assert (both.shape, found.edc, found.rate_hz) == ((1, N), "", 1500.0)
    assert both[0] == pytest.approx(EMG[0], abs=1e-12)
    assert found.columns_why == "one muscle, the only one"
    assert any("one muscle only" in one for one in found.notes)


def test_one_muscle_of_several_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    np.savetxt(path, EMG.T, delimiter=",", header="biceps,triceps", comments="")
    found = guess(read_emg(path), fs_hz=1500.0, fds="triceps", edc="none")
    assert (found.fds, found.edc, found.columns_why) == ("triceps", "", "one muscle, named")
    with pytest.raises(PalpError, match="--edc none"):
        guess(read_emg(path), fs_hz=1500.0, edc="none")


@pytest.mark.parametrize("muscle_count", [1, 2])
def test_signals_in_a_tree_with_statistics_beside_them(tmp_path: Path, muscle_count: int) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        device = file.create_group("00:07:80:3B:46:61")
        device.attrs["sampling rate"] = 1500
        device.attrs["channels"] = np.arange(1, muscle_count + 1)
        raw, digital = device.create_group("raw"), device.create_group("digital")
        raw["nSeq"] = np.arange(N)[:, None] % 16
        digital["digital_1"] = (np.arange(N) > 200)[:, None].astype(np.int64)
        for channel in range(muscle_count):
            raw[f"channel_{channel + 1}"] = EMG[channel][:, None]
            level = device.create_group(f"support/level_10/channel_{channel + 1}")
            for name in ("mean", "max", "min", "std"):
                level[name] = EMG[channel].reshape(-1, 10).mean(axis=1)
            device[f"support/rms/channel_{channel + 1}"] = np.abs(EMG[channel])
    found, both = read(path, None)
    assert both == pytest.approx(EMG[:muscle_count])
    assert found.rate_hz == 1500.0
    assert found.fds == "00:07:80:3B:46:61.raw.channel_1"
    (note,) = [one for one in found.notes if one.startswith("left out")]
    assert "support.level_10.channel_1.mean" in note
    named = guess(read_emg(path), fds=f"00:07:80:3B:46:61.support.rms.channel_{muscle_count}", edc="none")
    assert named.fds.endswith(f"rms.channel_{muscle_count}")  # who asks for it gets it
