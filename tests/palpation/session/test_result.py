"""``result.json``: what it counts, from a small record whose trials are known."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from palp_core.errors import PalpError
from palp_core.graph.launch.run_journal import MethodSpan, RunChange
from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.mechanics.scene.rig import rig
from palp_core.palpation.session import report_page, run_note
from palp_core.palpation.session.methods.used import rig_uses
from palp_core.palpation.session.policy_changes import PolicySpan
from palp_core.palpation.session.recorded_session import read_session
from palp_core.palpation.session.report_page import headline, write_report
from palp_core.palpation.session.result import SessionResult, build, read_result, write_result
from palp_core.palpation.world.model import LAB
from tests.support.sessions import SMALL_STRAIN, Summariser, Writer

TRIALS = [
    (0, [[0.6, 0.3, 0.1], [0.9, 0.1, 0.0]]),
    (0, [[0.8, 0.1, 0.1]]),
    (2, [[0.1, 0.2, 0.7]]),
    (2, [[0.1, 0.6, 0.3], [0.1, 0.7, 0.2], [0.1, 0.8, 0.1]]),
]


def built(out: Path, summary: RunSummary) -> dict[str, Any]:
    """Return a result as its file has it."""
    return dict(msgspec.json.decode(msgspec.json.encode(build(read_session(out), summary))))


def result_of(found: dict[str, Any]) -> SessionResult:
    return msgspec.convert(found, SessionResult)


def test_the_result_counts_trials_depths_palpations_and_mountings(
    record: Writer, summary: Summariser
) -> None:
    found = built(out := record(trials=TRIALS), summary(out))
    overall = found["accuracy"]["overall"]
    assert (overall["right"], overall["of"], overall["value"]) == (3, 4, 0.75)
    assert overall["ci"] == pytest.approx([0.3006, 0.9544], abs=1e-4)  # Wilson's, 3 of 4
    assert {d: s["value"] for d, s in found["accuracy"]["per_depth_mm"].items()} == {"2": 1.0, "8": 0.5}
    assert found["accuracy"]["interval"] == "95 % Wilson, this session only"
    assert found["chance"] == pytest.approx(1 / 3)
    assert (found["probes_mean"], found["probes_mean_per_depth_mm"]) == (7 / 4, {"2": 1.5, "8": 2.0})
    assert found["mounts"] == {"training": 1, "estimation": 1}
    table = {"depths_mm": [2.0, 4.0, 8.0], "actual_by_estimated": [[2, 0, 0], [0, 0, 0], [0, 1, 1]]}
    assert found["confusion"] == table
    assert found["calibration"]["overconfidence"] == pytest.approx(0.8 - 0.75)
    assert (found["palpations"], found["sim_time_s"]) == (12 + 7, 123.0)
    assert found["sweep_s"] == pytest.approx(19 * 1.399)
    assert found["sweep_s_per_wall_s"] == pytest.approx(19 * 1.399 / 2.0)
    assert built(out, summary(out, wall_s=0.0))["sweep_s_per_wall_s"] is None
    limits = {"threshold": 0.0005, "settled": 0.05, "max_probes": 15}
    assert found["stop_rule"] == {"name": "paper_guarded", "settings": limits}


def test_the_rigs_time_is_from_decision_to_decision_on_one_mounting(
    record: Writer, summary: Summariser
) -> None:
    out = record(trials=TRIALS)
    found = built(out, summary(out, reading="trace"))
    last = {
        row.trial: (row.remount, row.end_ns) for row in read_session(out).rows if row.phase == "estimation"
    }
    ends = [last[trial] for trial in sorted(last)]
    took = [(b - a) * 1e-9 for (one, a), (other, b) in itertools.pairwise(ends) if one == other]
    assert found["rig_s_per_decision"] == {"mean": pytest.approx(np.mean(took)), "trials": len(took)}
    assert len(took) >= 1
    assert (found["reading"], built(out, summary(out))["reading"]) == ("trace", "feature")


def test_undecided_trials_count_with_their_estimate_and_a_single_depth_has_chance_one(
    record: Writer, summary: Summariser
) -> None:
    found = built(out := record(trials=TRIALS, last_word="undecided"), summary(out))
    assert found["verdicts"] == {"decided": 0, "undecided": 4}
    assert found["accuracy"]["overall"]["value"] == 0.75
    single = record("single", depths_m=(0.004,), trials=[(0, [[1.0]])])
    found = built(single, summary(single, stop="fixed_number"))
    assert (found["chance"], list(found["accuracy"]["per_depth_mm"])) == (1.0, ["4"])


def test_without_a_trial_there_is_no_accuracy_but_a_result(
    record: Writer, summary: Summariser, strict_json: Callable[[Path], Any]
) -> None:
    found = built(out := record(), summary(out))
    assert found["accuracy"]["overall"] == {"value": None, "ci": None, "right": 0, "of": 0}
    assert found["calibration"] is found["probes_mean"] is None
    assert strict_json(write_result(result_of(found), out)) == found


def test_numbers_of_protocol_and_scene_have_their_basis(
    record: Writer, summary: Summariser, tmp_path: Path
) -> None:
    run = summary(out := record())
    found = built(out, run)
    assert found["protocol"]["experiment"]["rehome"] == {"value": "trial", "basis": "not published; assumed"}
    assert found["protocol"]["phantom"]["height_sd_mm"]["basis"].startswith("assumed")
    assert "out" not in found["protocol"]["experiment"]
    scene = found["mechanics"]["scene"]
    assert scene["probe"]["spring_n_per_m"] == {"value": 240.0, "basis": "published: 0.24 N/mm"}
    assert scene["C"]["depth_m"]["value"] == 0.008
    assert "assumed" in scene["C"]["modulus_pa"]["basis"]
    file = tmp_path / "soft.yaml"
    file.write_text("S: {modulus_pa: 8000.0, bead: {depth_m: 0.003}}\n")
    run.params["phantom"]["phantoms"] = str(file)
    scene = built(out, run)["mechanics"]["scene"]
    assert scene["S"]["modulus_pa"] == {"value": 8000.0, "basis": f"given by {file}"}
    assert scene["S"]["depth_m"]["basis"] == f"given by {file}"


def test_the_mechanics_have_the_guards_of_the_run_and_solve_nothing_again(
    record: Writer, summary: Summariser, monkeypatch: pytest.MonkeyPatch
) -> None:
    def solve_again(*_: object) -> None:
        raise AssertionError("the mechanics are solved a second time")

    monkeypatch.setattr("palp_core.palpation.mechanics.equilibrium.sweep_table.solve", solve_again)
    monkeypatch.setattr("palp_core.palpation.mechanics.scene.rig.solve", solve_again, raising=False)
    run = summary(out := record())
    table = out / "trials.csv"
    table.write_text(table.read_text(encoding="utf-8").replace(SMALL_STRAIN, "lift-off | stuck"))
    mechanics = built(out, run)["mechanics"]
    assert mechanics["tolerance"] == 0.02
    assert mechanics["guards"] == {
        "A": ["ring_m = 0.016: lift-off", "ring_m = 0.016: stuck"],
        "B": [],
        "C": [],
    }
    run.listens["experiment"].remove("/phantom/guard")
    assert built(out, run)["mechanics"]["guards"] is None


def test_a_result_is_read_back_and_a_missing_or_broken_one_is_an_error(
    record: Writer, summary: Summariser, tmp_path: Path
) -> None:
    found = build(read_session(out := record(trials=TRIALS)), summary(out))
    write_result(found, out)
    assert read_result(out) == found
    with pytest.raises(PalpError, match=r"result\.json is missing"):
        read_result(tmp_path)
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(PalpError, match="is not a result"):
        read_result(tmp_path)


def test_a_run_that_recorded_nowhere_is_an_error(summary: Summariser, tmp_path: Path) -> None:
    nowhere = msgspec.structs.replace(summary(tmp_path), args={}, params={})
    with pytest.raises(PalpError, match="names no folder"):
        run_note.out_of(nowhere)


def changed(before: str, run: str, at_s: float = 0.5) -> RunChange:
    return RunChange("policy", at_s, f"nodes.policies:{before}", f"nodes.policies:{run}")


@pytest.mark.parametrize(
    ("chose", "present", "label"),
    [
        ([], [], "markov, 12 mm"),
        ([], ["Fixed"], "markov, then fixed, 12 mm"),
        ([("markov", 1)], ["Fixed"], "markov"),  # the ring is of one that came after the last palpation
        ([("fixed", 1)], ["Fixed"], "fixed, 12 mm"),
        ([("fixed", 1), ("uniform", 2)], ["Fixed", "Uniform"], "fixed, from trial 2 on uniform, 12 mm"),
        ([("markov", 1), ("mine", 60)], [], "markov, from trial 60 on mine, 12 mm"),
    ],
)
def test_a_label_names_the_policies_that_chose_and_the_ring_of_the_last(
    chose: list[tuple[str, int]], present: list[str], label: str, record: Writer, summary: Summariser
) -> None:
    changes = [changed("Markov", name) for name in present]
    found = build(read_session(out := record()), msgspec.structs.replace(summary(out), changes=changes))
    found.protocol["policy"] = result_of(built(out, summary(out))).protocol["policy"]
    found.protocol["policy"]["ring_mm"] = msgspec.structs.replace(
        found.protocol["experiment"]["rehome"], value=12.0
    )
    found.policies = [PolicySpan(policy=name, trial=trial, palpation=1, at_s=0.0) for name, trial in chose]
    assert found.policy_label() == label


def test_what_was_changed_stands_with_its_time_and_a_parameter_as_it_was_in_the_end(
    record: Writer, summary: Summariser
) -> None:
    out = record(trials=TRIALS)
    rows = read_session(out).rows
    first_trial = next(number for number, row in enumerate(rows, 1) if row.phase == "estimation")
    at_s = rows[first_trial - 1].start_ns / 1e9
    changes = [
        changed("Markov", "Fixed", at_s=rows[0].start_ns / 1e9),
        RunChange("policy", at_s, params={"ring_mm": 12.0}),
        RunChange("estimator", 1e6, params={"stop_value": 0.5}),
    ]
    run = summary(out)
    run.params["policy"] = {"ring_mm": 16.0}
    found = built(out, msgspec.structs.replace(run, changes=changes))
    listed = [(one["node"], one["phase"], one["palpation"], one["params"]) for one in found["changes"]]
    assert listed == [
        ("policy", rows[0].phase, 1, {}),
        ("policy", "estimation", first_trial, {"ring_mm": 12.0}),
        ("estimator", "", None, {"stop_value": 0.5}),
    ]
    assert found["protocol"]["policy"]["ring_mm"]["value"] == 12.0
    page = write_report(out / "report.html", result_of(found), ()).read_text()
    for words in ("nodes.policies:Markov → nodes.policies:Fixed", "ring_mm = 12.0", "after the last"):
        assert words in page


def test_a_session_whose_trials_were_all_dropped_says_why(record: Writer, summary: Summariser) -> None:
    found = built(out := record(), summary(out))
    assert headline(result_of(found)).endswith("no trial of estimation came to an end.")
    dropped = [{"trial": number, "reason": "ring position 16 mm was not trained"} for number in (7, 8)]
    words = (
        "came to an end: 2 trials were dropped (ring position 16 mm was not trained); train it by rings_mm"
    )
    assert words in headline(result_of(found | {"trials_dropped": dropped}))


def test_the_world_stands_in_result_and_page_unless_it_is_the_papers(
    record: Writer, summary: Summariser
) -> None:
    plain = built(out := record(trials=TRIALS), summary(out))
    assert "world" not in plain
    assert "world" not in headline(result_of(plain))
    used = [MethodSpan(node="phantom", at_s=0.0, use=use) for use in rig_uses(rig(), None, LAB)]
    found = built(out, msgspec.structs.replace(summary(out), methods=used))
    texture = found["world"]["parameters"]["texture_sd_n_m"]
    assert (found["world"]["name"], texture["value"], texture["unit"]) == ("lab", LAB.texture_sd_n_m, "N m")
    assert texture["basis"].startswith("assumed")
    assert headline(result_of(found)).endswith("Simulated in the world “lab”, not in the paper's own design.")
    page = write_report(out / "page.html", result_of(found), []).read_text("utf-8")
    assert ">World: lab</h2>" in page
    assert "texture_sd_n_m" in page


@pytest.mark.parametrize(
    ("device", "link", "touch", "shown"),
    [
        ("sim", None, True, "simulated rig"),
        ("aerotech", "socket://10.0.0.1:8001", True, "emulated devices, simulated phantoms"),
        ("aerotech", "socket://10.0.0.1:8001", False, "rig with devices"),
        ("newport", "none", False, "rig with devices, without a link of the safety node's own to the stage"),
        ("newport", "none", True, "simulated phantoms, without a link of the safety node's own to the stage"),
    ],
)
def test_the_page_says_what_was_swept_and_that_the_stage_had_no_link_for_stopping(
    device: str, link: str | None, touch: bool, shown: str, record: Writer, summary: Summariser
) -> None:
    run = summary(out := record())
    run.params["stage"] = {"device": device}
    if link is not None:
        run.params["safety"] = {"stop_link": link}
    if not touch:
        run.publishes["phantom"].pop("/phantom/guard")
    words = report_page._rig(build(read_session(out), run))
    assert shown in words
    assert ("(stop_link: none)" in words) == (link == "none")
