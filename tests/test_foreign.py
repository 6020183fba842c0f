"""The boundary to other people's code: their words stay off the screen, palp's own pass."""

from __future__ import annotations

import io
import logging
import os
import socket
import socketserver
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edfio import Bdf, BdfSignal, Edf, EdfSignal
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosWriter
from rosbags.typesys import Stores, get_typestore

from palp_core.errors import BagError, DeviceError, PalpError
from palp_core.foreign import catch_foreign
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.topic import Topic
from palp_core.palpation.reporting.charts import Chart, image
from tests.palpation.identification.emg.xdf_writer import XdfStream, xdf
from tests.support.palp import PATIENCE_S, Palp


@pytest.mark.parametrize(
    ("raised", "text"),
    [
        (RuntimeError("no\n  such port"), "x.mcap: RuntimeError: no such port; try another"),
        (NameError(), "x.mcap: NameError; try another"),
        (
            OSError(2, "No such file", "x"),
            "x.mcap: No such file; try another",
        ),
        (ModuleNotFoundError("gone", name="pyxdf"), "x.mcap: pyxdf is not installed; type: "),
        (SystemExit(3), "x.mcap: SystemExit: 3; try another"),
        (ModuleNotFoundError("No module 'canlib'", name="canlib"), "x.mcap: ModuleNotFoundError: No module"),
    ],
)
def test_an_exception_becomes_an_error_of_the_place_with_a_fix(raised: BaseException, text: str) -> None:
    with pytest.raises(BagError) as seen, catch_foreign("x.mcap", BagError, "try another"):
        raise raised
    assert str(seen.value).startswith(text)
    assert seen.value.__cause__ is raised


@pytest.mark.parametrize("raised", [DeviceError("ati: no answer"), KeyboardInterrupt()])
def test_palps_own_error_and_an_interruption_pass_as_they_are(raised: BaseException) -> None:
    with pytest.raises(type(raised)) as seen, catch_foreign("x.mcap", BagError):
        raise raised
    assert seen.value is raised


def test_log_lines_and_warnings_are_remarks_once_each_and_nothing_is_printed(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])  # as on the command line
    library = logging.getLogger("pyxdf.pyxdf")
    with catch_foreign("x.xdf", PalpError) as remarks:
        for _ in range(2):
            library.warning("Stream %d: it\n differs", 1)
            warnings.warn("mean of an empty slice", RuntimeWarning, stacklevel=1)
        library.info("loading")
        with catch_foreign("y.xdf", PalpError) as inner:
            library.error("damaged")
        library.error("also damaged")
    assert remarks == ["Stream 1: it differs", "mean of an empty slice", "also damaged"]
    assert inner == ["damaged"]
    assert capfd.readouterr().err == ""


def test_what_a_half_made_object_logs_as_it_goes_is_a_remark(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Bus:
        def __init__(self) -> None:
            raise OSError("no driver")

        def __del__(self) -> None:
            logging.getLogger("can.bus").warning("not shut down")

    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    with pytest.raises(DeviceError) as seen, catch_foreign("ati", DeviceError) as remarks:
        Bus()
    assert remarks == ["not shut down"]
    del seen
    assert capfd.readouterr().err == ""


def test_palps_own_words_other_threads_and_what_follows_are_not_kept_back(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class OwnWarning(UserWarning):
        __module__ = "palp_core.palpation"

    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    with pytest.warns(OwnWarning, match="mine"), catch_foreign("x.xdf", PalpError) as remarks:  # noqa: PT031
        warnings.warn("mine", OwnWarning, stacklevel=1)
        logging.getLogger("palp.estimator").warning("of palp")
        other = threading.Thread(target=lambda: logging.getLogger("can").warning("of another thread"))
        other.start()
        other.join()
    logging.getLogger("can").warning("afterwards")
    assert remarks == []
    assert capfd.readouterr().err.splitlines() == ["of palp", "of another thread", "afterwards"]


def _bag(folder: Path) -> bytes:
    with BagWriter(folder / "bag", compression="none") as bag:
        number = bag.stream(Stream(topic=Topic(name="/emg/block")))
        for sequence in range(1, 50):
            bag.write(number, sequence, sequence * 10**6, sequence * 10**6, b"\x81\xa1x\x01")
    return (folder / "bag" / "bag_0.mcap").read_bytes()


def _without_chunks(folder: Path) -> bytes:
    file = io.BytesIO()
    writer = Writer(file, use_chunking=False)
    writer.start("ros2", "libmcap")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/é", "cdr", schema, {"offered_qos_profiles": ""})
    for i in range(40):
        writer.add_message(channel, i, b"\0\1\0\0\4\0\0\0abc\0", i)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def _rosbag(plugin: StoragePlugin, folder: Path) -> bytes:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text: Any = store.types["std_msgs/msg/String"]
    with RosWriter(folder / "ros", version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/é", "std_msgs/msg/String", typestore=store)
        for i in range(40):
            bag.write(connection, i, store.serialize_cdr(text("é"), "std_msgs/msg/String"))
    (file,) = (path for path in (folder / "ros").iterdir() if path.suffix in (".mcap", ".db3"))
    return file.read_bytes()


def _table(folder: Path) -> bytes:
    rows = [f"{i / 1000:.3f},{np.sin(i):.4f},{np.cos(i * 1.1):.4f}" for i in range(300)]
    return "\n".join(["time (s),EMG fléchisseur (µV),EMG extenseur (µV)", *rows]).encode()


def _arrays(folder: Path) -> bytes:
    file = io.BytesIO()
    np.savez(file, fds=np.sin(np.arange(300.0)), edc=np.cos(np.arange(300.0)), fs=1000.0)
    return file.getvalue()


def _edf(folder: Path, *, wide: bool = False) -> bytes:
    signal: Any = BdfSignal if wide else EdfSignal
    file: Any = Bdf if wide else Edf
    path = folder / "one.edf"
    muscles = [
        signal(np.sin(np.arange(1000.0) * k), 1000, label=f"EMG {k}", physical_dimension="uV") for k in (1, 2)
    ]
    file(muscles).write(path)
    return path.read_bytes()


def _xdf(folder: Path) -> bytes:
    rows, times_s = np.random.default_rng(0).normal(size=(300, 2)), np.arange(300) / 1000
    return xdf(XdfStream("é", "EMG", 1000.0, rows, list(times_s), ["fds", "edc"]))


IMPORT = ("emg", "import", "{file}", "--dry-run")
READERS: dict[str, tuple[Callable[[Path], bytes], str, tuple[str, ...]]] = {
    "bag": (_bag, ".mcap", ("bag", "info", "{file}")),
    "bag to CSV": (_bag, ".mcap", ("bag", "convert", "{file}", "--to", "csv", "-o", "{out}")),
    "bag to Parquet": (_bag, ".mcap", ("bag", "convert", "{file}", "--to", "parquet", "-o", "{out}")),
    "bag recover": (_bag, ".mcap", ("bag", "recover", "{file}", "-o", "{out}")),
    "no chunks": (_without_chunks, ".mcap", ("bag", "info", "{file}")),
    "no chunks recover": (_without_chunks, ".mcap", ("bag", "recover", "{file}", "-o", "{out}")),
    "rosbag2 MCAP": (
        partial(_rosbag, StoragePlugin.MCAP),
        ".mcap",
        ("bag", "convert", "{file}", "--from", "ros2", "-o", "{out}"),
    ),
    "rosbag2 SQLite": (
        partial(_rosbag, StoragePlugin.SQLITE3),
        ".db3",
        ("bag", "convert", "{file}", "--from", "ros2", "-o", "{out}"),
    ),
    "EMG CSV": (_table, ".csv", IMPORT),
    "EMG NPZ": (_arrays, ".npz", IMPORT),
    "EMG EDF": (_edf, ".edf", IMPORT),
    "EMG BDF": (partial(_edf, wide=True), ".bdf", IMPORT),
    "EMG XDF": (_xdf, ".xdf", IMPORT),
    "EMG bag": (_bag, ".mcap", IMPORT),
}
DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "whole": lambda data: data,
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) * 2 // 3],
    "only a head": lambda data: data[: len(data) // 20],
    "noise": lambda data: np.random.default_rng(1).bytes(3000),
    "head of noise": lambda data: data[:9] + np.random.default_rng(2).bytes(300) + data[309:],
    "flipped bits": lambda data: _flipped(data, 40),
    "one flipped bit": lambda data: _flipped(data, 1),
    "zeros": lambda data: data[: len(data) // 2] + bytes(len(data) - len(data) // 2),
    "not a number": lambda data: data.replace(b"1", b"x"),
}


def _flipped(data: bytes, count: int) -> bytes:
    changed, random = bytearray(data), np.random.default_rng(count)
    for place in random.integers(len(data), size=count).tolist():
        changed[place] ^= 1 << int(random.integers(8))
    return bytes(changed)


ONE_EACH = {
    "bag recover": "zeros",
    "bag to Parquet": "cut",
    "rosbag2 SQLite": "head of noise",
    "EMG EDF": "not a number",
    "EMG XDF": "whole",
}


@pytest.mark.parametrize(
    ("reader", "damages"),
    [
        *((reader, [damage]) for reader, damage in ONE_EACH.items()),
        *(pytest.param(reader, list(DAMAGES), marks=pytest.mark.nightly) for reader in READERS),
    ],
)
def test_a_damaged_file_is_one_line_of_palp_and_a_status(
    palp: Palp, reader: str, damages: list[str], tmp_path: Path
) -> None:
    palp.environment["PYTHONIOENCODING"] = "ascii"
    make, suffix, words = READERS[reader]
    data = make(tmp_path)
    for place, name in enumerate(damages):
        file = tmp_path / f"{place}é{suffix}"
        file.write_bytes(DAMAGES[name](data))
        process = palp.start(*(word.format(file=file, out=tmp_path / f"out{place}é") for word in words))
        output, errors = process.communicate(timeout=PATIENCE_S)
        assert process.returncode in (0, 1, 2), (name, errors)
        assert len(errors.splitlines()) == (process.returncode == 2), (name, errors)
        assert not errors or f"{place}\\u00e9" in errors, (name, errors)
        assert (output + errors).isascii(), name


NOISE = b"\xff\xfe\x80caf\xe9\r\n\0<?xml < hi >" * 100


@contextmanager
def speaking(answer: bytes, endless: bytes = b"") -> Iterator[int]:
    """A server that gives each visitor this answer, whatever is asked, and ends or never does; its port."""

    class Visitor(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            with suppress(OSError):
                self.request.sendall(answer)
                while endless:
                    self.request.sendall(endless * 1000)
                self.request.shutdown(socket.SHUT_WR)
                while self.request.recv(4096):
                    pass

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Visitor) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()
            thread.join()


def page(body: bytes) -> bytes:
    return b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(body) + body


DRIVER = """
import logging, warnings
from palp_core.palpation.devices.sim.torque import SimTorque

class Raises(SimTorque):
    def __post_init__(self):
        raise NameError("caf\xe9")

class OpensNot(SimTorque):
    def open(self, now_ns, state, rng):
        logging.getLogger("maker").error("caf\xe9")
        warnings.warn("caf\xe9")
        raise RuntimeError("caf\xe9")
"""
NORAXON = ("noraxon", "host:=127.0.0.1", "port:={port}")
SOCKETCAND = ("ati", "interface:=socketcand", "options:={{host: 127.0.0.1, port: {port}}}")
SERIAL = ("aerotech", "maestro")
ABSENT = ("pcan", "ixxat", "socketcan", "vector", "canalystii", "gs_usb", "udp_multicast", "caf\xe9")


@pytest.mark.parametrize(
    ("answer", "words", "said"),
    [
        (b"", ("ati", "interface:=kvaser", "channel:=0"), "ati: cannot open the bus kvaser 0: NameError: "),
        (b"", ("ati", "interface:=neousys", "channel:=0"), "and that the driver of 'neousys' is installed"),
        (page(b"[" * 100_000), NORAXON, "noraxon: /headers makes no sense: RecursionError: "),
        (b"", ("driver:OpensNot",), ":OpensNot: cannot open it: RuntimeError: caf\\u00e9"),
        *(
            pytest.param(answer, words, "", marks=pytest.mark.nightly)
            for answer, words in (
                *((NOISE, (name, "url:=socket://127.0.0.1:{port}")) for name in SERIAL),
                *((b"", (name, "url:=socket://127.0.0.1:{port}")) for name in SERIAL),
                *((b"", (name, "url:=/dev/caf\xe9")) for name in SERIAL),
                (b"", ("maestro", "url:=hwgrep://caf\xe9")),
                (b"", ("maestro", "url:=alt:///dev/null?class=caf\xe9")),
                (b"", ("maestro", "url:=rfc2217://127.0.0.1:{port}?timeout=0.1")),
                (NOISE, NORAXON),
                (page(b'{"headers": [1]}'), NORAXON),
                (page(b'{"headers": [{"name": "caf\xc3\xa9", "type": "real.emg"}]}'), NORAXON),
                (b"", ("noraxon", "host:=" + "x" * 70 + ".lab")),
                (NOISE, SOCKETCAND),
                (b"", (*SOCKETCAND, "channel:=caf\xe9")),
                (NOISE, ("ati", "interface:=slcan", "channel:=socket://127.0.0.1:{port}")),
                *((b"", ("ati", f"interface:={name}", "channel:=0")) for name in ABSENT),
                (b"", ("lsl", "stream:=caf\xe9", "find_s:=0.1")),
                (b"", ("lsl", "stream:='it''s'", "find_s:=0.1")),
                (b"", ("driver:Raises",)),
            )
        ),
    ],
)
def test_a_device_that_does_not_open_is_one_line_of_palp_and_a_status(
    palp: Palp, answer: bytes, words: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    path = os.pathsep.join([palp.environment["PYTHONPATH"], str(tmp_path)])
    palp.environment |= {"PYTHONIOENCODING": "ascii", "PYTHONPATH": path}
    (tmp_path / "driver.py").write_text(DRIVER)
    with speaking(answer) as port:
        given = [word.format(port=port) for word in words]
        process = palp.start("devices", "probe", *given, "--patience", "0.2")
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, output) == (1, "")
    (line,) = errors.splitlines()
    assert given[0] in line
    assert said in line
    assert line.isascii()


AEROTECH = ("aerotech", "url:=socket://127.0.0.1:{port}")
CHUNKED = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"


@pytest.mark.parametrize(
    ("answer", "endless", "words"),
    [
        (b"", b"%12\n", AEROTECH),
        (b"HTTP/1.1 200 OK\r\n\r\n", b"{", NORAXON),
        *(
            pytest.param(answer, endless, words, marks=pytest.mark.nightly)
            for answer, endless, words in (
                *((b"", endless, AEROTECH) for endless in (b"A", b"\n", b"%", b"!")),
                (b"", b"\0", ("maestro", "url:=socket://127.0.0.1:{port}")),
                (CHUNKED, b"1\r\n{\r\n", NORAXON),
                (b"", b"HTTP/1.1 200 OK\r\n", NORAXON),
                (b"< hi >", b"< ok >", SOCKETCAND),
            )
        ),
    ],
)
def test_a_device_that_never_stops_talking_does_not_open(
    palp: Palp, answer: bytes, endless: bytes, words: tuple[str, ...]
) -> None:
    with speaking(answer, endless) as port:
        process = palp.start("devices", "probe", *(word.format(port=port) for word in words))
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, output) == (1, "")
    assert words[0] in errors


def test_what_matplotlib_makes_of_names_is_a_chart_or_an_error_of_palp(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging.getLogger(), "handlers", [])

    def named(text: str) -> Chart:
        def draw(figure: Any) -> None:
            figure.suptitle(text)

        return Chart("names", "", "", 2.0, [], [], draw)

    assert image(named("\u65e5\U0001f600"), "png").startswith(b"\x89PNG")
    with pytest.raises(PalpError, match="chart 'names' cannot be drawn: ValueError"):
        image(named("$x^{$"), "svg")
    assert capfd.readouterr() == ("", "")
