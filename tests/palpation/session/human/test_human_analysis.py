"""What sessions with people come to: counted by hand, refused where no one was a person."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from palp_core.errors import PalpError
from palp_core.palpation.session import audit
from palp_core.palpation.session.human.analysis import analyse, gather
from palp_core.palpation.session.human.record import HUMAN_TABLE, HumanRow, HumanWriter, read_human
from palp_core.palpation.session.human.report import headline, write_human

DEPTHS_M = (0.002, 0.004, 0.008)
PUBLISHED = {0.002: 24, 0.004: 17, 0.008: 17}
"""Right answers of 30 at each depth."""


def row(number: int, **more: Any) -> HumanRow:
    plain: dict[str, Any] = {
        "row": number, "subject": "S01", "phase": "estimation", "trial": number + 1,
        "attempt": 1, "phantom": "A", "depth_m": 0.002, "told": False, "palpation_s": 5.0,
        "ended_by": "subject", "answer_s": 1.0, "answer_mm": 2.0, "estimate_m": 0.002, "emg": "",
        "lost_count": 0, "clipped_count": 0, "source": "person", "answered_by": "terminal",
        "order": "paper", "subject_number": 1, "seed": 1, "end_ns": 0,
    }  # fmt: skip
    return HumanRow(**(plain | more))


def written(folder: Path, rows: list[HumanRow]) -> Path:
    writer = HumanWriter(str(folder))
    writer.start()
    for one in rows:
        writer.append(one)
    return folder


def six_subjects(folder: Path, **more: Any) -> list[Path]:
    """Write the paper's counts: right answers dealt out over six subjects."""
    folders = []
    for subject in range(6):
        rows = []
        for repeat in range(5):
            for i, depth_m in enumerate(DEPTHS_M):
                right = 7 * (5 * subject + repeat) % 30 < PUBLISHED[depth_m]  # 7 k mod 30: each once
                answer_m = depth_m if right else DEPTHS_M[(i + 1) % 3]
                facts = {
                    "depth_m": depth_m,
                    "estimate_m": answer_m,
                    "answer_mm": answer_m * 1e3,
                    "phantom": "ABC"[i],
                }
                rows.append(row(3 * repeat + i, subject=f"S0{subject + 1}", **facts, **more))
        folders.append(written(folder / f"S0{subject + 1}", rows))
    return folders


def test_a_row_comes_back_as_it_was_written(tmp_path: Path) -> None:
    rows = [row(0), row(1, depth_m=None, estimate_m=None, answer_s=None, answer_mm=None, told=True)]
    assert read_human(written(tmp_path / "S01", rows)) == rows


@pytest.mark.parametrize(
    ("cell", "other"), [(",estimation,", ",other,"), (",5.0,", ",nan,"), (",5.0,", ",-inf,")]
)
def test_a_cell_that_no_session_writes_is_named_by_its_line(tmp_path: Path, cell: str, other: str) -> None:
    table = written(tmp_path / "S01", [row(0), row(1)]) / HUMAN_TABLE
    table.write_text(table.read_text().replace(cell, other))
    with pytest.raises(PalpError, match=f"{HUMAN_TABLE}:2: the row is damaged"):
        read_human(tmp_path / "S01")


def test_the_papers_counts_give_the_papers_shares(tmp_path: Path) -> None:
    found = analyse(gather(folders := six_subjects(tmp_path)))
    right = {mm: (one["right"], one["of"]) for mm, one in found["by_depth"].items()}
    assert right == {"2": (24, 30), "4": (17, 30), "8": (17, 30)}
    assert (found["subjects"], found["accuracy"]["right"]) == (6, 58)
    assert found["confusion"]["counts"] == [[24, 6, 0], [0, 17, 13], [13, 0, 17]]
    assert {one["name"] for one in found["anova"]["effects"]} == {"depth", "trial", "depth:trial"}
    assert write_human(folders, tmp_path / "page", charts=True).startswith(headline(found))
    page = (tmp_path / "page/human.html").read_text()
    assert "<td>2</td><td>24</td><td>6</td><td>0</td>" in page
    assert 'data-name="human_accuracy"' in page
    assert (tmp_path / "page/charts/human_accuracy.csv").is_file()


@pytest.mark.parametrize(
    ("whose", "shown"),
    [
        ({"source": "simulated"}, "the muscles are simulated"),
        ({"source": "emulator"}, "the amplifier is emulated"),
        ({"source": "file"}, "the muscles are a recording's"),
        ({"answered_by": "script"}, "a script answered"),
        ({"answered_by": ""}, "it is unknown who answered"),
    ],
)
def test_who_is_no_person_has_no_accuracy_anywhere(tmp_path: Path, whose: dict[str, str], shown: str) -> None:
    folders = six_subjects(tmp_path)
    written(tmp_path / "one", [row(0, **whose)])  # a single such trial among 90 of people
    for chosen in ([tmp_path / "one"], [*folders, tmp_path / "one"]):
        found = analyse(gather(chosen))
        assert found["accuracy"] is None
        assert shown in found["note"]
        assert not {"by_depth", "by_trial", "confusion", "anova", "permutation_p"} & found.keys()
        assert "%" not in headline(found)
    write_human([tmp_path / "one"], tmp_path / "page")
    page = (tmp_path / "page/human.html").read_text()
    assert "no accuracy" in page
    assert json.loads((tmp_path / "page/human.json").read_text())["accuracy"] is None
    assert "human_accuracy" not in page


def test_what_was_excluded_or_is_to_be_done_again_does_not_count(tmp_path: Path) -> None:
    folder = written(
        tmp_path / "S01", [row(0), row(1, estimate_m=0.004), row(2, ended_by="repeat", attempt=1), row(3)]
    )
    assert analyse(gather([folder]))["accuracy"]["of"] == 3
    audit.decide(folder, ("estimation", 2), "exclude", "the subject saw the phantom")
    audit.decide(folder, ("estimation", 4), "redo", "the phantom slipped")
    found = analyse(gather([folder]))
    assert (found["accuracy"]["right"], found["accuracy"]["of"]) == (1, 1)
    assert found["left_out"] == {"spoilt and done again": 1, "exclude": 1, "redo": 1}
    assert len(read_human(folder)) == 4
    path = folder / audit.AUDIT
    path.write_text(path.read_text().replace("exclude", "forget"))
    with pytest.raises(PalpError, match=r"audit\.csv:2"):
        gather([folder])


def test_a_session_is_never_replaced_nor_counted_twice(tmp_path: Path) -> None:
    folder = written(tmp_path / "S01", [row(0)])
    with pytest.raises(PalpError, match="never overwritten"):
        HumanWriter(str(folder)).start()
    with pytest.raises(PalpError, match="named twice"):
        gather([folder, tmp_path / "." / "S01"])
