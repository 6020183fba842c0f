"""What every device promises, simulated, emulated or real (``--hardware CONFIG``).

CONFIG is a file as ``docs/hardware.yaml``. With it the stage **moves** up to 20 mm about y = 0 and the ring
up to 10 mm, and only if the file says that they may.
"""

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
from palp_core.palpation.devices.contract import PROMISES, Promise, Subject, promises_of
from palp_core.palpation.devices.emulator import EmulatedRig
from palp_core.palpation.devices.registry import KINDS, kind_of, known_devices
from palp_core.palpation.devices.sim.ring import SimRing
from tests.support.hardware import HARDWARE, Hardware

pytestmark = pytest.mark.filterwarnings("default::palp_core.palpation.devices.unverified.UnverifiedWarning")
BY_KIND = {kind: known_devices(kind) for kind in KINDS}
SIM_OPTIONS: dict[str, dict[str, Any]] = {"emg": {"matrix": [[0.2] * 5] * 5}, "stage": {"lift_m": 0.002}}
EMULATED_OPTIONS: dict[str, dict[str, Any]] = {  # slow: what is predicted or cut short has seconds of time
    "stage": {"lift_m": 0.002, "sweep_speed_m_per_s": 0.001, "return_speed_m_per_s": 0.005},
    "ring": {"speed_m_per_s": 1.25e-3},
}
PATIENCE_S = 120.0


def cases(hardware: dict[str, Hardware]) -> Iterator[Any]:
    """Yield every promise with every device that has it; a real one of each kind of hardware."""
    without_lsl = pytest.mark.skipif(find_spec("pylsl") is None, reason="needs palp-core[lsl]")
    for promise in PROMISES:
        for kind in promise.kinds:
            for name in [*BY_KIND[kind], *(["hardware"] if kind in hardware else [])]:
                marks = [without_lsl] if name == "lsl" else []
                yield pytest.param(
                    (kind, name), promise, id=f"{kind}-{name}-{promise.check.__name__}", marks=marks
                )


@pytest.fixture
def subject(
    request: pytest.FixtureRequest,
    quick_rig: Callable[..., EmulatedRig],
    hardware: dict[str, Hardware],
    patient: dict[str, dict[str, Any]],
) -> Iterator[Subject]:
    kind, name = request.param
    if name == "hardware":
        made = Subject(kind, hardware[kind].device, hardware[kind].options, patience_s=PATIENCE_S)
    elif name == "sim":
        made = Subject(kind, name, SIM_OPTIONS.get(kind, {}), simulated=True)
    else:
        options = quick_rig(name).options[name] | patient[name] | EMULATED_OPTIONS.get(kind, {})
        made = Subject(kind, name, options, patience_s=PATIENCE_S)
    yield made
    made.device.close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "promise" in metafunc.fixturenames:
        found = list(cases(metafunc.config.stash[HARDWARE]))
        metafunc.parametrize(("subject", "promise"), found, indirect=["subject"])


def test_a_device_keeps_the_promise(subject: Subject, promise: Promise) -> None:
    promise(subject)


class Deaf(SimRing):
    """A ring that accepts any target, and never settles."""

    def command(self, target_m: float, now_ns: int, state: Any, rng: Any) -> int:
        return super().command(min(max(target_m, 0.0), 0.05), now_ns, state, rng)


def test_a_driver_that_breaks_a_promise_is_told_which_and_how() -> None:
    name = f"{__name__}:Deaf"
    assert kind_of(name) == "ring"
    broken = {str(one): why_broken(one, Subject("ring", name, simulated=True)) for one in promises_of("ring")}
    why = broken.pop("a ring refuses targets beyond its stroke")
    assert why == "it does not refuse a target of -0.001 m (with a DeviceError that says 'target_m')"
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
    status, said = contract("other_stage:Mine", "--sim", "lift_m:=0.002")
    assert status == 0, said
    assert said.count("kept") == len(promises_of("stage"))
    assert "cannot import 'no_stage:Mine'" in contract("no_stage:Mine")[1]
    listed = CliRunner().invoke(app, ["devices", "list", "other_stage:Mine"]).output
    assert "stage" in listed
    assert "lift_m" in listed
