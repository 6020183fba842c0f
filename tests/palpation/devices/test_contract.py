"""Simulated and emulated devices keep the contract, and a driver that breaks it is named."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from palp_core.cli.main import app
from palp_core.cli.rig.device_discovery import why_broken
from palp_core.palpation.devices.contract import (
    EmgContract,
    RingContract,
    StageContract,
    Subject,
    TorqueContract,
    promises_of,
)
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.registry import kind_of, known_devices
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.torque import SimTorque

pytestmark = pytest.mark.filterwarnings("default::palp_core.palpation.devices.unverified.UnverifiedWarning")
SIM_OPTIONS: dict[str, dict[str, Any]] = {"emg": {"matrix": [[0.2] * 5] * 5}, "stage": {"lift_m": 0.002}}
EMULATED_OPTIONS: dict[str, dict[str, Any]] = {  # slow: what is predicted or cut short has seconds of time
    "stage": {
        "lift_m": 0.002,
        "sweep_speed_m_per_s": 0.001,
        "return_speed_m_per_s": 0.005,
        "poll_hz": 20.0,
    },
    "ring": {"speed_m_per_s": 1.25e-3, "poll_hz": 20.0},
}


ACROSS: dict[str, dict[str, Any]] = {  # a stage with a third axis, which counts backwards
    "sim": {"limits": {"x_m": [-0.01, 0.01]}},
    "aerotech": {
        "limits": {"x_m": [-0.01, 0.01]},
        "axes": ["X", "Y", "Z"],
        "origin_m": [0.0, 0.0, 0.001],
        "sign": [1, 1, -1],
    },
}


class Known:
    """Has every known device of a kind as the subject; of stages those with a third axis, too."""

    kind: str

    @pytest.fixture
    def subject(
        self,
        request: pytest.FixtureRequest,
        quick_rig: Callable[..., EmulatedRig],
        patient: dict[str, dict[str, Any]],
    ) -> Iterator[Subject]:
        kind, (name, *across) = self.kind, request.param.split()
        more = ACROSS[name] if across else {}
        if name == "sim":
            made = Subject(kind, name, SIM_OPTIONS.get(kind, {}) | more, simulated=True)
        else:
            options = quick_rig(name).options[name] | patient[name] | EMULATED_OPTIONS.get(kind, {}) | more
            made = Subject(kind, name, options, patience_s=120.0)
        with made:
            yield made


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if metafunc.cls is not None and issubclass(metafunc.cls, Known):
        without_lsl = pytest.mark.skipif(find_spec("pylsl") is None, reason="needs palp-core[emg]")
        devices = [
            pytest.param(name, marks=[without_lsl] if name == "lsl" else [])
            for name in known_devices(metafunc.cls.kind)
        ]
        if metafunc.cls.kind == "stage":
            devices += [pytest.param(f"{name} across") for name in ACROSS]
        metafunc.parametrize("subject", devices, indirect=True)


class TestStages(Known, StageContract):
    kind = "stage"


class TestRings(Known, RingContract):
    kind = "ring"


class TestTorqueSensors(Known, TorqueContract):
    kind = "torque"


class TestEmgAmplifiers(Known, EmgContract):
    kind = "emg"


def test_the_contract_moves_a_stage_no_farther_than_its_limits(
    quick_rig: Callable[..., EmulatedRig], patient: dict[str, dict[str, Any]]
) -> None:
    rig = quick_rig("aerotech")
    limits = {"y_m": [-0.021, 0.021], "z_m": [0.0, 0.010], "speed_m_per_s": 0.050}
    options = rig.options["aerotech"] | patient["aerotech"] | {"lift_m": 0.002, "limits": limits}
    with Subject("stage", "aerotech", options, patience_s=120.0) as subject:
        promises_of("stage")["a stage takes one move at a time and stops when it must"](subject)
    y_mm = rig.call(lambda _: [line.split()[2] for *_, line in rig.axes.log if line.startswith("MOVEABS X")])
    assert y_mm
    assert all(-21.0 <= float(place) <= 21.0 for place in y_mm)


class Deaf(SimRing):
    """A ring that accepts any target, and never settles."""

    def command(self, target_m: float, now_ns: int, state: Any, rng: Any) -> int:
        return super().command(min(max(target_m, 0.0), 0.05), now_ns, state, rng)


Untared = type(
    "Untared",
    SimTorque.__bases__,
    {
        name: value
        for name, value in vars(SimTorque).items()
        if name not in ("tare", "__dict__", "__weakref__")
    },
)
"""A torque sensor that lacks the method by which it is known; it is taken for an amplifier."""


@pytest.mark.parametrize(
    ("driver", "kind", "promise", "why"),
    [
        (
            Deaf,
            "ring",
            "a ring refuses targets beyond its stroke",
            "it does not refuse a target of -0.001 m (with a DeviceError that contains 'target_m')",
        ),
        (
            Untared,
            "emg",
            "samples are numbered and in order",
            "its samples have no fds_v, no edc_v; a torque sensor must have the method tare",
        ),
    ],
)
def test_a_driver_that_breaks_a_promise_is_reported_which_and_how(
    driver: type, kind: str, promise: str, why: str
) -> None:
    name = f"{__name__}:{driver.__name__}"
    assert kind_of(name) == kind
    broken = {
        promise: why_broken(check, Subject(kind, name, simulated=True))
        for promise, check in promises_of(kind).items()
    }
    assert broken.pop(promise) == why
    assert set(broken.values()) == {""}


def contract(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["devices", "contract", *words])
    return done.exit_code, done.output + str(done.exception or "")


def test_the_verb_checks_a_driver_of_ones_own_and_moves_nothing_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nodes").mkdir()
    (tmp_path / "other_stage.py").write_text(
        "from palp_core.palpation.devices.sim.stage import SimStage\n\n\nclass Mine(SimStage):\n    pass\n",
        encoding="utf-8",
    )
    assert "clear the way and add --moves" in contract("other_stage:Mine")[1]
    status, shown = contract("other_stage:Mine", "--sim", "lift_m:=0.002")
    assert status == 0, shown
    assert shown.count("kept") == len(promises_of("stage"))
    assert "cannot import 'no_stage:Mine'" in contract("no_stage:Mine")[1]
    listed = CliRunner().invoke(app, ["devices", "list", "other_stage:Mine"]).output
    assert "stage" in listed
    assert "lift_m" in listed
