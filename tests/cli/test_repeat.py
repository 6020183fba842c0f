"""``palp launch --repeat``: sessions side by side, pooled; what is refused, and what goes on."""

from __future__ import annotations

import json
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from palp_core.cli.launch import side_by_side
from palp_core.cli.launch.repeat import Run, plan, refuse, refuse_options, repeat
from palp_core.errors import GraphError
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.launch import checking
from palp_core.palpation.session.report import session
from tests.support.palp import PATIENCE_S, ROOT, SIM, Palp, wait_for_line
from tests.support.rig_session import ComposedGraph, RigSession, check_here
from tests.support.sessions import no_charts

SMALL = ("trials:=2", "training:=2", "policy:=markov", "seed:=1", "--compose")
"""As of ``rig_session``."""


@pytest.fixture(scope="module")
def checked() -> CheckedGraph:
    return check_here(SIM, ["out:=results/many", "seed:=3"])


def test_each_run_has_its_seed_and_folder_and_all_are_pooled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ["trials:=1", "training:=2", "rings_mm:=8, 16", "policy:=fixed", "shared.stop:=fixed_number"]
    ran: list[list[str]] = []

    def one_after_another(commands: Mapping[str, Sequence[str]], workers: int) -> dict[str, str]:
        for file, *words in commands.values():
            ran.append([file, *words])
            with ComposedGraph(file, overrides=[word for word in words if ":=" in word]) as rig:
                assert rig.run().exit_code == 0
        return {}

    monkeypatch.setattr(side_by_side, "run_side_by_side", one_after_another)
    monkeypatch.setattr(checking, "check_file", check_here)
    many = tmp_path / "many"
    given = [*small, "seed:=1", f"out:={many}"]
    with no_charts():
        assert repeat(SIM, given, 2, compose=True, resume=False) == 0
    assert ran == [
        [str(SIM), *small, f"seed:={seed}", f"out:={many / f'seed_{seed}'}", "--compose"] for seed in (1, 2)
    ]
    said = capsys.readouterr()
    assert f"2 runs of {SIM}, seeds 1 to 2, " in said.err
    assert "over 2 sessions" in said.out
    assert "not all were run alike" not in said.out
    one, other = ((many / f"seed_{seed}" / "trials.csv").read_bytes() for seed in (1, 2))
    assert one != other
    pooled = json.loads((many / "pooled.json").read_text())
    assert [(group["unit"], group["units"]) for group in pooled["groups"]] == [("session", 2)]
    assert (many / "index.html").exists()
    with pytest.raises(GraphError, match=f"{many / 'seed_1'} is there already: --resume goes on"):
        repeat(SIM, given, 2, compose=True, resume=False)


@pytest.mark.nightly
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGKILL])
def test_what_was_ended_in_the_middle_goes_on(
    kill: signal.Signals, palp: Palp, rig_session: RigSession, tmp_path: Path
) -> None:
    """A session that was whole is left as it is, and the others come to the bytes they would have."""
    many = tmp_path / "many"
    words = ("launch", SIM, *SMALL)
    process = palp.start(*words, f"out:={many}", "--repeat", 2)
    wait_for_line(process, "seed 1: ")
    process.send_signal(kill)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == (130 if kill is signal.SIGINT else -kill)
    assert palp.all_gone()
    whole = {
        path: path.read_bytes() for path in many.glob("seed_*/trials.csv") if session.complete(path.parent)
    }
    done = palp.run(*words, f"out:={many}", "--repeat", 2, "--resume")
    assert done.returncode == 0, done.stderr
    assert "over 2 sessions" in done.stdout
    assert {path: path.read_bytes() for path in whole} == whole
    one, other = ((many / f"seed_{seed}" / "trials.csv").read_bytes() for seed in (1, 2))
    assert one == (rig_session.out / "trials.csv").read_bytes() != other
    assert all(session.complete(many / f"seed_{seed}") for seed in (1, 2))


def test_each_run_has_the_next_seed_and_a_folder_of_its_own(checked: CheckedGraph) -> None:
    runs = plan(checked, 3, session, resume=False)
    assert runs == [Run(seed, Path(f"results/many/seed_{seed}"), "begin") for seed in (3, 4, 5)]


def test_what_is_whole_is_left_and_what_is_not_begins_again(
    checked: CheckedGraph, rig_session: RigSession, tmp_path: Path
) -> None:
    import msgspec

    out = tmp_path / "many"
    here = msgspec.structs.replace(checked, args=checked.args | {"out": str(out)})
    with pytest.raises(GraphError, match=r"nothing to resume: .*many has no run; name the folder"):
        plan(here, 2, session, resume=True)
    for seed in (4, 5):
        (out / f"seed_{seed}").mkdir(parents=True)
    (out / "seed_3").symlink_to(rig_session.out)
    found = plan(here, 4, session, resume=True)
    assert [run.way for run in found] == ["done", "begin", "begin", "begin"]
    assert [run.anew for run in found] == [False, True, True, False]  # the second and third were cut off
    assert found[1].words == ["seed:=4", f"out:={out / 'seed_4'}", "overwrite:=true"]
    with pytest.raises(GraphError, match="seed_3 is there already: --resume goes on with the runs of"):
        plan(here, 4, session, resume=False)


def test_what_cannot_go_on_side_by_side_is_refused_in_words(checked: CheckedGraph) -> None:
    import msgspec

    wall = check_here(ROOT / "launch" / "emulated.yaml")
    with pytest.raises(GraphError, match="its graph goes by the machine's clock"):
        refuse(Path("emulated.yaml"), wall, 2)
    with pytest.raises(GraphError, match="--repeat 0: one run at least"):
        refuse(SIM, checked, 0)
    with pytest.raises(GraphError, match="no argument seed"):
        refuse(SIM, msgspec.structs.replace(checked, args={"out": "there"}), 2)
    with pytest.raises(GraphError, match="does not say what several runs say together"):
        refuse(SIM, msgspec.structs.replace(checked, report=""), 2)
    with pytest.raises(GraphError, match="--repeat with --record: that is of one run"):
        refuse_options({"--record": Path("bag"), "--view": False})
