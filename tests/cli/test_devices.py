"""``palp devices``: the list, and what it says of devices that are there, and of those that are not."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from typer.testing import CliRunner

from palp_core.cli.devices import app
from palp_core.devices.emulator import EmulatedRig

runner = CliRunner()


@pytest.fixture(scope="module")
def rig() -> Iterator[EmulatedRig]:
    with EmulatedRig(devices=("aerotech", "maestro", "ati", "netft", "noraxon", "spikershield")) as started:
        yield started


def words(rig: EmulatedRig, device: str) -> list[str]:
    return [f"{name}:={json.dumps(value)}" for name, value in rig.options[device].items()]


def test_list_prints_every_device_that_has_a_driver() -> None:
    lines = runner.invoke(app, ["list"]).output.splitlines()
    assert [line.split()[0] for line in lines] == [
        "aerotech", "maestro", "ati", "netft", "noraxon", "lsl", "spikershield",
    ]  # fmt: skip


def test_list_tells_machines_the_options() -> None:
    found = {entry["device"]: entry for entry in json.loads(runner.invoke(app, ["list", "--json"]).output)}
    assert found["ati"]["kind"] == "torque"
    assert found["ati"]["options"]["bitrate"] == "500000"


@pytest.mark.parametrize("device", ["aerotech", "maestro", "ati", "netft", "noraxon", "spikershield"])
def test_probe_finds_what_is_there(rig: EmulatedRig, device: str) -> None:
    done = runner.invoke(app, ["probe", device, *words(rig, device)])
    assert done.exit_code == 0, done.output
    assert done.output.startswith(f"{device} answers")


def test_probe_moves_and_enables_nothing(rig: EmulatedRig) -> None:
    runner.invoke(app, ["probe", "aerotech", *words(rig, "aerotech")])
    lines = {line for _, _, line in rig.on_world(lambda world, _: list(world.log))}
    assert lines <= {"NONE"}


def test_probe_of_what_is_not_there_says_what_to_check() -> None:
    done = runner.invoke(app, ["probe", "aerotech", "url:=socket://127.0.0.1:1"])
    assert done.exit_code == 1
    assert "127.0.0.1:1" in done.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["probe", "nano"], "no device 'nano'; known: aerotech"),
        (["probe", "aerotech"], "where is it? give url:="),
        (["probe", "ati", "chanel:=can0"], "its options are channel"),
    ],
)
def test_a_mistake_is_answered_with_what_there_is(arguments: list[str], said: str) -> None:
    done = runner.invoke(app, arguments)
    assert done.exit_code == 1
    assert said in done.output


def test_monitor_says_what_a_sensor_delivers(rig: EmulatedRig) -> None:
    done = runner.invoke(
        app, ["monitor", "ati", *words(rig, "ati"), "--for", "0.3", "--every", "0.1", "--json"]
    )
    assert done.exit_code == 0, done.output
    rows = [json.loads(line) for line in done.output.splitlines()]
    assert rows[-1]["state"] == "ok"
    assert {"rate_hz", "gaps", "tx_n_m", "tx_n_m_sd", "drift_ppm"} <= set(rows[-1])


def test_emulate_prints_options_and_obeys() -> None:
    done = runner.invoke(app, ["emulate", "ati"], input="fault ati silence\nclear ati\nquit\n")
    assert done.exit_code == 0, done.output
    assert done.output.startswith("ati channel:=can0")
    assert done.output.splitlines()[-2:] == ["ok", "ok"]
