"""``palp devices``: the list, and what it says of devices that are there, and of those that are not."""

from __future__ import annotations

import json
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import serial
from typer.testing import CliRunner

from palp_core.cli.rig import device_discovery
from palp_core.cli.rig.devices import app
from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.link.serial_link import SerialLink
from palp_core.palpation.devices.protocols import TorqueSamples
from tests.support import made_up_stage

runner = CliRunner()
# Deadlines that a busy host does not pass: what is there is found.
PATIENT = {
    "aerotech": ("timeout_s:=30.0",),
    "maestro": ("timeout_s:=30.0",),
    "ati": ("stale_s:=10.0", "timeout_s:=30.0", "lost_s:=30.0", "rate_hz:=100.0"),
    "noraxon": ("stale_s:=30.0", "timeout_s:=30.0"),
}


@pytest.fixture(scope="module")
def rig() -> Iterator[EmulatedRig]:
    with EmulatedRig(devices=("aerotech", "maestro", "ati", "noraxon")) as started:
        yield started


@contextmanager
def chattering() -> Iterator[str]:
    """Give the address of a port that sends bytes without end to who connects, as fast as a serial line."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def chatter() -> None:
            client, _ = server.accept()
            pause = threading.Event()
            with client, suppress(OSError):  # it has gone
                while not pause.wait(0.001):
                    client.sendall(bytes(20))

        thread = threading.Thread(target=chatter, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        thread.join()


def words(rig: EmulatedRig, device: str) -> list[str]:
    return [f"{name}:={json.dumps(value)}" for name, value in rig.options[device].items()]


def test_list_prints_every_device_that_has_a_driver_and_its_options_to_machines() -> None:
    lines = runner.invoke(app, ["list"]).output.splitlines()
    assert [line.split()[0] for line in lines] == ["aerotech", "maestro", "ati", "lsl", "noraxon"]
    found = {entry["device"]: entry for entry in json.loads(runner.invoke(app, ["list", "--json"]).output)}
    assert found["ati"]["kind"] == "torque"
    assert found["ati"]["options"]["bitrate"] == "500000"


@pytest.mark.parametrize("device", PATIENT)
def test_probe_finds_what_is_there(rig: EmulatedRig, device: str) -> None:
    done = runner.invoke(app, ["probe", device, "--patience", "60", *words(rig, device), *PATIENT[device]])
    assert done.exit_code == 0, done.output
    assert done.output.startswith(f"{device} answers")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["probe", "nano"], "no device 'nano'; known: aerotech"),
        (["probe", "aerotech"], "where is it? give url:="),
        (["probe", "ati", "chanel:=can0"], "its options are channel"),
        (["probe", "aerotech", "url:=socket://127.0.0.1:1"], "127.0.0.1:1"),
        (["probe", "aerotech", "url:=/dev/no-such-port"], "No such file or directory"),
        (["probe", "maestro", "url:=/dev/null"], "cannot open /dev/null"),
        (
            ["probe", "aerotech", "url:=socket://127.0.0.1:1", "baud:=fast"],
            "baud = 'fast': it must be a whole number",
        ),
        (["probe", "aerotech", "url:=nowhere://x"], "protocol 'nowhere' not known"),
        (["probe", "ati", "interface:=socketcand"], "no option 'host'"),
        (["probe", "ati", "interface:=no-such-bus"], "no-such-bus"),
        (["probe", "ati", "rate_hz:=x"], "rate_hz = 'x': it must be a number"),
        (["probe", "ati", "verified:=[colour]"], "what can be verified: axis, bitrate, calibration"),
        (["probe", "noraxon", "host:=127.0.0.1", "port:=1"], "is MR3 measuring"),
    ],
)
def test_a_mistake_or_a_device_out_of_reach_is_one_clear_line_and_a_status(
    arguments: list[str], text: str
) -> None:
    done = runner.invoke(app, arguments)
    assert done.exit_code == 1
    assert isinstance(done.exception, SystemExit)  # not an error that would print a traceback
    assert text in done.output
    assert len(done.output.splitlines()) == 1
    assert done.output.count(f"{arguments[1]}:") <= 1


@pytest.mark.parametrize(
    ("option", "text", "length"),
    [("--for", "seconds", "nan"), ("--for", "seconds", "-1"), ("--for", "seconds", "inf"),
     ("--patience", "patience_s", "nan")],
)  # fmt: skip
def test_a_length_of_time_that_is_none_is_refused_before_anything_is_opened(
    option: str, text: str, length: str
) -> None:
    arguments = ["monitor", "noraxon", "host:=127.0.0.1", "port:=1", option, length]
    done = runner.invoke(app, arguments)
    if length == "-1":
        assert isinstance(done.exception, DeviceError)
        assert text in str(done.exception)
    else:  # refused as the command line is read
        assert done.exit_code == 2
        assert "finite number" in done.output


def test_a_port_without_the_right_to_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port /dev/ttyACM0: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    done = runner.invoke(app, ["probe", "maestro", "url:=/dev/ttyACM0"])
    assert done.exit_code == 1
    assert "Permission denied; check address, cable and rights" in done.output


def test_a_serial_port_that_another_program_has_is_refused(rig: EmulatedRig) -> None:
    link = SerialLink("maestro", rig.addresses["maestro"], 115200)
    try:
        done = runner.invoke(app, ["probe", "maestro", *words(rig, "maestro")])
    finally:
        link.close()
    assert done.exit_code == 1
    assert "that no other program has it" in done.output
    again = runner.invoke(app, ["probe", "maestro", *words(rig, "maestro"), *PATIENT["maestro"]])
    assert again.exit_code == 0


@pytest.mark.parametrize("device", PATIENT)
@pytest.mark.parametrize("fault", ["garbage", "silence"])  # garbage: as at a wrong baud rate
def test_a_device_that_makes_no_sense_is_a_clear_error(rig: EmulatedRig, device: str, fault: str) -> None:
    rig.fault(device, fault)
    try:
        done = runner.invoke(app, ["probe", device, "--patience", "0", *words(rig, device)])
    finally:
        rig.clear(device)
    assert done.exit_code == 1, done.output
    assert isinstance(done.exception, SystemExit)
    assert done.output.strip()


@pytest.mark.parametrize("device", ["aerotech", "maestro"])
def test_a_port_of_another_device_that_never_falls_silent_is_an_error(device: str) -> None:
    with chattering() as url:
        done = runner.invoke(app, ["probe", device, f"url:={url}"])
    assert done.exit_code == 1, done.output
    assert isinstance(done.exception, SystemExit)


def test_probe_shows_what_is_not_verified(rig: EmulatedRig) -> None:
    given = [word for word in words(rig, "ati") if not word.startswith("verified")]
    given += [*PATIENT["ati"], "--patience", "60"]
    done = runner.invoke(app, ["probe", "ati", *given, "verified:=[axis]"])
    assert done.exit_code == 0, done.output
    assert "not verified: bitrate: the sensor is delivered with 250 kbit/s" in done.output
    assert "axis" not in done.output
    found = json.loads(runner.invoke(app, ["probe", "ati", *given, "--json"]).output)
    assert set(found["unverified"]) == {"axis", "bitrate", "calibration"}
    assert found["serial_number"] == "FT32918"


def test_probe_of_the_stage_reports_position_and_limits_and_moves_nothing(rig: EmulatedRig) -> None:
    done = runner.invoke(app, ["probe", "aerotech", *words(rig, "aerotech"), *PATIENT["aerotech"]])
    assert "X: disabled, not homed, at rest, at 0 mm, fault none, soft limits -55 to 55 mm" in done.output
    assert {line for _, _, line in rig.call(lambda _: list(rig.axes.log))} <= {"NONE"}


def test_monitor_says_what_a_sensor_delivers(rig: EmulatedRig) -> None:
    how = ["--patience", "60", "--for", "0.3", "--every", "0.1", "--json"]
    done = runner.invoke(app, ["monitor", "ati", *words(rig, "ati"), *PATIENT["ati"], *how])
    assert done.exit_code == 0, done.output
    rows = [json.loads(line) for line in done.output.splitlines()]
    assert rows[-1]["state"] == "ok"
    assert rows[-1]["nominal_hz"] == 100.0
    assert {"rate_hz", "gaps", "tx_n_m", "tx_n_m_sd", "drift_ppm"} <= set(rows[-1])


def test_emulate_prints_options_and_obeys() -> None:
    done = runner.invoke(app, ["emulate", "ati"], input="fault ati silence\nclear ati\nquit\n")
    assert done.exit_code == 0, done.output
    assert done.output.startswith("ati channel:=can0")
    assert done.output.splitlines()[-2:] == ["ok", "ok"]


def test_emulate_takes_all_settings_and_prints_options_for_a_program() -> None:
    done = runner.invoke(app, ["emulate", "ati", "--json", "--settings", '{"seed": 2}'], input="quit\n")
    assert json.loads(done.output)["ati"]["channel"] == "can0"
    wrong = runner.invoke(app, ["emulate", "ati", "--settings", '{"seed": "two"}'])
    assert "give the fields of RigSettings as JSON" in str(wrong.exception)
    taken = runner.invoke(app, ["emulate", "ati", "--host", "192.0.2.1"])
    assert "cannot listen on 192.0.2.1" in str(taken.exception)
    raised = runner.invoke(app, ["emulate", "aerotech"], input="axes\nquit\n")  # to tare the sensor free
    assert json.loads(raised.output.splitlines()[-1])["z"]["position_m"] == 0.020


def test_a_driver_is_found_by_its_module_in_the_workspace_one_is_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "nodes").mkdir()
    (tmp_path / "own_drivers").mkdir()
    source = Path(made_up_stage.__file__).read_text(encoding="utf-8")
    (tmp_path / "own_drivers" / "found_here.py").write_text(source, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done = runner.invoke(app, ["list", "own_drivers.found_here:MadeUpStage"])
    assert done.exit_code == 0, done.output + str(done.exception)


@pytest.mark.filterwarnings("error")
def test_a_sensor_of_one_axis_has_a_torque_and_no_forces() -> None:
    no = np.zeros(2, bool)
    block = TorqueSamples(np.array([1, 2]), np.array([0.01, 0.03]), 0, gap=no, faulty=no)
    row = device_discovery._row(block, "ok", 1.0, 1000.0)
    assert (row["torque_n_m"], "fx_n" in row) == (pytest.approx(0.02), False)


def test_a_rate_is_of_the_time_that_has_passed_however_late_it_is_looked_at() -> None:
    exact = "palp_core.palpation.devices.sim.torque:SimTorque"
    rows = list(device_discovery.watch(exact, {"rate_hz": 1000.0}, 0.2, 0.05, 5.0))
    assert [row["rate_hz"] for row in rows] == [pytest.approx(1000.0, abs=25.0)] * len(rows)  # a sample of 50
