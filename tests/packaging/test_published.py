"""What a lab's package publishes by entry points is there by name, beside palp's own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from palp_core.cli.rig.device_discovery import device_entries
from palp_core.errors import DeviceError, PalpError
from palp_core.palpation.devices.registry import (
    back_end,
    drivers,
    known_devices,
    open_device,
)
from palp_core.palpation.identification.emg.files import is_recording, read_emg
from palp_core.palpation.studies.catalogue import STUDIES, studies, study
from palp_core.published import entries
from tests.graph.workspaces.installed import forgetting, install

LAB = {
    "gripper_lab/__init__.py": "",
    "gripper_lab/stage.py": "from tests.support.made_up_stage import MadeUpStage\n",
    "gripper_lab/trc.py": """
import numpy as np
from palp_core.palpation.identification.emg.files import Column, EmgFile


def read_trc(path):
    return EmgFile(path, "TRC", (Column("fds", np.array([float(x) for x in path.read_text().split()])),))


def read_odd(path):
    return None
""",
    "gripper_lab/raises.py": "raise RuntimeError('no licence')",
    "gripper_lab/leaves.py": "raise SystemExit(0)",
    "gripper_lab/grip.py": '''
def run(out, *, quick=False):
    """How firm is the grip?

    More of it.
    """
    page = out / "index.html"
    page.write_text(f"quick: {quick}")
    return page
''',
}
POINTS = {
    "palp.devices": {
        "stage.made_up": "gripper_lab.stage:MadeUpStage",
        "stage.sim": "gripper_lab.stage:MadeUpStage",
        "stage.gone": "gripper_lab.gone:Stage",
        "stage.raises": "gripper_lab.raises:Stage",
        "stage.leaves": "gripper_lab.leaves:Stage",
    },
    "palp.emg_readers": {
        "trc": "gripper_lab.trc:read_trc", "odd": "gripper_lab.trc:read_odd", "lost": "gripper_lab.lost:read",
        "raises": "gripper_lab.raises:read", "leaves": "gripper_lab.leaves:read",
        "fails": "gripper_lab.trc:Column",
    },
    "palp.studies": {
        "grip": "gripper_lab.grip:run", "gone": "gripper_lab.gone:run", "raises": "gripper_lab.raises:run",
        "leaves": "gripper_lab.leaves:run",
    },
}  # fmt: skip


@pytest.fixture(autouse=True)
def lab(tmp_path: Path) -> Iterator[None]:
    """Install a lab's package."""
    install(tmp_path / "site", "gripper-lab", LAB, POINTS)
    with forgetting() as patch:
        patch.syspath_prepend(str(tmp_path / "site"))
        entries.cache_clear()
        yield
    entries.cache_clear()


def test_a_device_is_known_by_name() -> None:
    assert "made_up" in known_devices("stage")
    assert ("stage", "made_up") in drivers()
    assert "made_up" not in known_devices("ring")
    assert type(open_device("stage", "made_up", port=7)).__name__ == "MadeUpStage"
    assert back_end("stage", "sim").__name__ == "SimStage"  # palp's own names stay palp's
    with pytest.raises(DeviceError, match=r"cannot import 'gripper_lab\.gone:Stage'"):
        back_end("stage", "gone")
    with pytest.raises(DeviceError, match="known: aerotech, gone, leaves, made_up, raises, sim, or give"):
        open_device("stage", "made_down")


def test_a_recording_is_read_by_its_suffix(tmp_path: Path) -> None:
    path = tmp_path / "grip.TRC"
    path.write_text("1 2 3", encoding="utf-8")
    assert is_recording(path)
    assert read_emg(path).columns[0].samples.tolist() == [1.0, 2.0, 3.0]
    for suffix, words in (
        ("odd", "returned no EmgFile but NoneType"),
        ("lost", "cannot import 'gripper_lab.lost:read'"),
        ("leaves", "SystemExit: 0"),
        ("fails", "TypeError: "),
    ):
        wrong = path.rename(path.with_suffix(f".{suffix}"))
        path = wrong
        with pytest.raises(PalpError, match=words):
            read_emg(wrong)


CAUSES = {"gone": "No module named", "raises": "RuntimeError: no licence", "leaves": "SystemExit: 0"}


@pytest.mark.parametrize(("name", "cause"), CAUSES.items())
def test_what_cannot_be_imported_is_an_error_of_its_name(name: str, cause: str) -> None:
    words = f"cannot import 'gripper_lab.{name}.*': .*{cause}"
    with pytest.raises(DeviceError, match=f"stage device: {words}"):
        back_end("stage", name)
    with pytest.raises(PalpError, match=f"study '{name}': {words}"):
        study(name)


def test_what_cannot_be_imported_leaves_the_lists_whole() -> None:
    entries = {one.name: one.link for one in device_entries()}
    assert {"aerotech", "made_up", *CAUSES} < {*entries}
    asked = {name: one.question for name, one in studies().items()}
    for name, cause in CAUSES.items():
        assert cause in entries[name]
        assert cause in asked[name]


def test_a_study_is_listed_with_its_question_and_runs(tmp_path: Path) -> None:
    assert list(studies()) == [*STUDIES, "gone", "grip", "leaves", "raises"]
    assert study("grip").question == "How firm is the grip?"
    assert study("grip").run(tmp_path, quick=True).read_text() == "quick: True"
