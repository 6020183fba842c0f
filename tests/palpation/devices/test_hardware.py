"""``--hardware``: the contract on devices at their addresses, and no motion without leave to move."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from palp_core.errors import DeviceError
from palp_core.palpation.devices import open_device
from palp_core.palpation.devices.contract import Subject, promises_of
from palp_core.palpation.devices.emulator import EmulatedRig
from tests.palpation.devices.test_contract import cases
from tests.support.hardware import HARDWARE, read_hardware

ROOT = Path(__file__).parents[3]
SAMPLE = ROOT / "docs" / "hardware.yaml"
TRAVEL: dict[str, dict[str, Any]] = {
    "stage": {"y_m": [-0.025, 0.025], "z_m": [0.0, 0.010], "speed_m_per_s": 0.05},
    "ring": {"ring_m": [0.0, 0.012]},
}
SLOW_STAGE = {"lift_m": 0.002, "sweep_speed_m_per_s": 0.001, "return_speed_m_per_s": 0.005}
SLOW_RING = {"speed_m_per_s": 1.25e-3}
KINDS = {"stage": "aerotech", "ring": "maestro", "torque": "ati", "emg": "noraxon"}


def write(path: Path, tree: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


@pytest.mark.parametrize("without", [("sweeps", "arrives"), pytest.param((), marks=pytest.mark.nightly)])
def test_the_contract_holds_for_the_devices_of_a_file(
    quick_rig: Callable[..., EmulatedRig],
    tmp_path: Path,
    patient: dict[str, dict[str, Any]],
    without: tuple[str, ...],
) -> None:
    """The emulator's addresses stand in for the devices'."""
    rig = quick_rig(*KINDS.values())
    tree: dict[str, Any] = {
        kind: {"device": name, "options": json.loads(json.dumps(rig.options[name] | patient[name]))}
        | ({"travel": TRAVEL[kind]} if kind in TRAVEL else {})
        for kind, name in KINDS.items()
    }
    tree["stage"]["options"] |= SLOW_STAGE
    tree["ring"]["options"] |= SLOW_RING
    for kind, entry in read_hardware(write(tmp_path / "hardware.yaml", tree)).items():
        for promise in promises_of(kind):
            if not any(word in str(promise) for word in without):
                promise(Subject(kind, entry.device, entry.options, patience_s=120.0))
    y_m = rig.call(lambda _: [line for _, _, line in rig.axes.log if line.startswith("MOVEABS X")])
    assert y_m  # the stage has moved, and nowhere beyond what the file allows
    assert all(-25.0 <= float(line.split()[2]) <= 25.0 for line in y_m)


STAGE = {"device": "aerotech", "options": {"url": "socket://127.0.0.1:1"}}
RING = {"device": "maestro", "options": {"url": "/dev/null"}}


@pytest.mark.parametrize(
    ("kind", "entry", "said"),
    [
        ("stage", STAGE, "'travel' does not say how far"),
        ("stage", {**STAGE, "travel": {"y_m": [-0.025, 0.025]}}, "'travel' does not give z_m"),
        ("stage", {**STAGE, "travel": {**TRAVEL["stage"], "y_m": [-0.001, 0.001]}}, "so nothing is moved"),
        ("stage", {**STAGE, "travel": {**TRAVEL["stage"], "y_m": [0.02, -0.02]}}, "must lie in"),
        ("stage", {**STAGE, "travel": {**TRAVEL["stage"], "y_m": "far"}}, "travel"),
        ("ring", RING, "'travel' does not say how far"),
        ("ring", {**RING, "travel": {"ring_m": [0.0, 0.005]}}, "so nothing is moved"),
        ("ring", {**RING, "travel": {"ring_m": 3}}, "travel"),
        ("ring", {**RING, "travel": {"rings_m": [0.0, 0.02]}}, "travel"),
        ("stage", "[", "no list of devices"),
        ("gripper", {"device": "hand"}, "no kind of device 'gripper'"),
        ("torque", {"device": "nano"}, "no device 'nano'; known: ati"),
        ("torque", {"device": "sim"}, "no device 'sim'"),
        ("torque", {"device": "ati", "option": {}}, "unknown field"),
    ],
)
def test_what_makes_no_sense_or_may_not_move_as_far_as_the_contract_does_is_not_even_opened(
    tmp_path: Path, kind: str, entry: Any, said: str
) -> None:
    with pytest.raises(DeviceError, match=said):
        read_hardware(write(tmp_path / "h.yaml", {kind: entry}))


def configured(pytestconfig: pytest.Config, **options: object) -> list[str]:
    """Configure a run with options, as pytest does; return the cases of the contract on real devices."""
    hooks: Any = pytestconfig.pluginmanager.get_plugin(str(Path(__file__).with_name("conftest.py")))
    config = SimpleNamespace(
        getoption=lambda name, default=None: options.get(name.lstrip("-"), default), stash=pytest.Stash()
    )
    hooks.pytest_configure(config)
    assert hooks.pytest_xdist_auto_num_workers(config) == (0 if "hardware" in options else None)
    return [str(case.id) for case in cases(config.stash[HARDWARE])]


def test_only_a_run_on_real_devices_has_their_cases(pytestconfig: pytest.Config, tmp_path: Path) -> None:
    config = write(tmp_path / "h.yaml", {"torque": {"device": "ati", "options": {"channel": "none"}}})
    more = set(configured(pytestconfig, hardware=config)) - set(configured(pytestconfig))
    assert more == {f"torque-hardware-{promise.check.__name__}" for promise in promises_of("torque")}
    with pytest.raises(pytest.UsageError, match="no two tests may move the same stage"):
        configured(pytestconfig, hardware=config, numprocesses=2)


def test_the_run_ends_before_its_first_test_where_the_file_is_wrong(
    pytestconfig: pytest.Config, tmp_path: Path
) -> None:
    entry = {"device": "aerotech", "options": {"url": "socket://127.0.0.1:1"}}
    with pytest.raises(pytest.UsageError, match="'travel' does not say how far it may"):
        configured(pytestconfig, hardware=write(tmp_path / "h.yaml", {"stage": entry}))


def test_a_file_may_be_toml(tmp_path: Path) -> None:
    path = tmp_path / "h.toml"
    path.write_text('[torque]\ndevice = "ati"\n[torque.options]\nchannel = "can1"\n')
    assert read_hardware(path)["torque"].options == {"channel": "can1"}


def test_the_sample_of_the_documentation_names_every_kind_and_fits_the_drivers() -> None:
    found = read_hardware(SAMPLE)
    assert {kind: entry.device for kind, entry in found.items()} == KINDS
    for kind, entry in found.items():
        device: Any = open_device(kind, entry.device, **entry.options)  # type: ignore[call-overload]
        assert set(device.verified) == set(device.UNVERIFIED)
