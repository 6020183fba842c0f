"""A session that is interrupted goes on, and ends with the same bytes as one that was not."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from palp_core.errors import PalpError
from palp_core.graph.bag.diff import diff_bags
from palp_core.graph.launch import checkpoints
from palp_core.graph.messages.frame import parse
from palp_core.graph.supervision.interrupt import Interrupted
from palp_core.palpation.session.result_json import TIME_KEYS
from palp_core.palpation.session.trials_csv import SessionWriter, read_rows, read_sweep
from tests.graph.launch.killed import command, environment, launch_and_kill, launch_to_its_end
from tests.support.palp import ROOT, SIM, Palp
from tests.support.rig_session import ComposedGraph, RigSession

SMALL = ("trials:=2", "training:=2", "seed:=1", "policy:=markov")
MESSAGES = [
    ("/experiment/trial", 17),
    *(("/torque/block", n) for n in (1, 111, 205)),
    ("/experiment/result", 6),
    ("/estimator/belief", 9),
    ("/estimator/primitives", 1),
    ("/cocontraction/cocontraction", 7),
]
"""Messages of the small session at which it is killed."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RigSession:
    """The session that nobody interrupts."""
    session = RigSession(tmp_path_factory.mktemp("whole"))
    with ComposedGraph(SIM, record=session.bag, overrides=[*SMALL, f"out:={session.out}"]) as graph:
        assert graph.run().exit_code == 0
    return session


@pytest.fixture(autouse=True)
def every_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each that is due is written, however little would be lost."""
    monkeypatch.setattr(checkpoints, "EVERY_NS", 0)


class Killed(BaseException):
    """In place of a power cut, within one process."""


def interrupt(out: Path, topic: str, sequence: int, *more: str, resume: bool = False) -> None:
    """Run the session until a message is published."""
    prefix, seen = topic.encode() + b"\0", 0

    def observe(_: int, frame: bytes) -> None:
        nonlocal seen
        if frame.startswith(prefix):
            seen += 1
            if seen == sequence:
                raise Killed

    overrides = [*SMALL, f"out:={out}", *more]
    with (
        pytest.raises(Killed),
        ComposedGraph(SIM, observe=observe, overrides=overrides, resume=resume) as graph,
    ):
        graph.run()


def resume(out: Path, *more: str) -> None:
    with ComposedGraph(SIM, resume=True, overrides=[*SMALL, f"out:={out}", *more]) as graph:
        assert graph.run().exit_code == 0


def files_of(out: Path) -> dict[str, bytes]:
    """Return what a folder holds of its session, by name; of the result, what does not tell of the run."""
    found = {path.name: path.read_bytes() for path in (out / "sweeps").iterdir()}
    for name in ("trials.csv", "primitives.json"):
        found[name] = (out / name).read_bytes()
    result = json.loads((out / "result.json").read_text())
    told = {key: value for key, value in result.items() if key not in TIME_KEYS}
    return {**found, "result": json.dumps(told).encode()}


def assert_equal(out: Path, whole: RigSession) -> None:
    ours, theirs = files_of(out), files_of(whole.out)
    assert ours.keys() == theirs.keys()
    assert [name for name in ours if ours[name] != theirs[name]] == []
    assert not (out / "checkpoint").exists()
    assert not list(out.glob(".*"))
    assert not (out / "interrupted").exists()


def test_an_interrupted_session_ends_with_the_same_bytes(whole: RigSession, tmp_path: Path) -> None:
    """Within a sweep of training, then as a trial of estimation ends, and then within a trial."""
    out = tmp_path / "out"
    interrupt(out, "/torque/block", 70)
    interrupt(out, "/experiment/result", 3, resume=True)
    assert_refused_with_the_command_that_goes_on(out)
    interrupt(out, "/estimator/belief", 3, resume=True)
    began = (out / "session.yaml").read_text()
    resume(out)
    assert_equal(out, whole)
    assert (out / "session.yaml").read_text() == began
    assert json.loads((out / "run.json").read_text())["resumed_count"] == 3


def assert_refused_with_the_command_that_goes_on(out: Path) -> None:
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(PalpError) as refused:
        ComposedGraph(SIM, overrides=[*SMALL, f"out:={out}"]).__enter__()
    said = str(refused.value)
    rows = read_rows(out)
    trials = sum(row.verdict not in ("", "continue") for row in rows)
    assert f"it is unfinished, {len(rows)} palpations and {trials} trials of estimation done" in said
    assert f"`palp launch {SIM} {' '.join(SMALL)} out:={out} --resume` goes on with it" in said
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_a_swap_before_the_interruption_is_told_once_it_has_ended(tmp_path: Path) -> None:
    out, swap = tmp_path / "out", "swaps:=1=nodes.policy_uniform:Uniform"
    interrupt(out, "/experiment/result", 3, swap)
    resume(out, swap)
    result = json.loads((out / "result.json").read_text())
    assert [(one["node"], one["run"], one["phase"]) for one in result["changes"]] == [
        ("policy", "nodes.policy_uniform:Uniform", "estimation")
    ]


BLOCKS, BLOCKS_OF_A_SWEEP = 210, 5
MOMENTS = [*range(3, BLOCKS, 19), *range(198, 208)]
"""Blocks of torque at which it is asked to end: anywhere in the session, and through a sweep."""


@pytest.mark.parametrize(
    "block", [pytest.param(n, marks=[] if n == 203 else [pytest.mark.nightly]) for n in MOMENTS]
)
def test_asked_to_end_it_goes_on_within_the_sweep(
    block: int, whole: RigSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the checkpoint of the first trial is written while it goes on, and what is due at the end."""
    monkeypatch.setattr(checkpoints, "EVERY_NS", sys.maxsize)
    out, seen = tmp_path / "out", []

    def observe(_: int, frame: bytes) -> None:
        found = parse(frame)
        if found.topic == "/torque/block":
            seen.append(found.sequence)
            if found.sequence == block:
                first._interrupt.request()

    given = {"observe": observe, "overrides": [*SMALL, f"out:={out}"]}
    with pytest.raises(Interrupted), ComposedGraph(SIM, **given) as first:
        first.run()
    with ComposedGraph(SIM, resume=True, **given) as again:
        assert again.run().exit_code == 0
    goes_on = block + 1 if block > BLOCKS_OF_A_SWEEP else 1  # nothing is due before the second trial
    assert seen == [*range(1, block + 1), *range(goes_on, BLOCKS + 1)]  # none was made twice
    assert_equal(out, whole)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("topic", "sequence", "compose"),
    [*((*message, True) for message in MESSAGES), *((*message, False) for message in MESSAGES[::4])],
)
def test_killed_with_all_its_processes_it_ends_with_the_same_bytes(
    topic: str, sequence: int, compose: bool, whole: RigSession, palp: Palp, tmp_path: Path
) -> None:
    out, bag = tmp_path / "out", str(tmp_path / "bag")
    words = (*SMALL, f"out:={out}")
    launch_and_kill(palp, SIM, topic, sequence, *words, compose=compose, record=bag)
    launch_to_its_end(palp, SIM, *words, compose=compose, record=bag, resume=True)
    assert_equal(out, whole)
    found = diff_bags(whole.bag, Path(bag), ignore=["hand_over"])  # it names the folder
    assert {name for name, topic in found.items() if topic.first is not None} == {"/graph/events"}


@pytest.mark.nightly
@pytest.mark.parametrize("compose", [True, False], ids=["composed", "processes"])
def test_killed_before_its_first_checkpoint_it_has_lost_nothing_and_begins_without_resume(
    compose: bool, whole: RigSession, palp: Palp, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = (*SMALL, f"out:={out}")
    launch_and_kill(palp, SIM, "/experiment/trial", 1, *words, compose=compose)
    refused = palp.run("launch", SIM, *words, "--resume", *(("--compose",) if compose else ()))
    assert refused.returncode == 2
    assert "without --resume one begins" in refused.stderr
    launch_to_its_end(palp, SIM, *words, compose=compose)
    assert_equal(out, whole)


@pytest.mark.nightly
@pytest.mark.parametrize("kib", [64, 180, 360])
def test_on_a_disk_that_fills_up_every_row_before_is_readable(
    kib: int, whole: RigSession, palp: Palp, tmp_path: Path
) -> None:
    """On a disk of its own, in a mount namespace that nobody else sees; then it is given room.

    Where there was none for a single checkpoint, the session begins anew.
    """
    disk, then, after = (tmp_path / name for name in ("disk", "then", "after"))
    disk.mkdir()
    namespace = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    mount = f"mount -t tmpfs -o size={kib}k none {disk}"
    if subprocess.run([*namespace, mount], capture_output=True, check=False).returncode:
        pytest.skip("no right to mount a disk in a namespace of one's own")
    words = (*SMALL, f"out:={disk}/out")
    first, again = (shlex.join(command(SIM, how, *words)) for how in ("composed", "composed resumed"))
    script = (
        f"{mount}; {first} > {tmp_path}/said 2>&1; cp -r {disk}/out {then}; "
        f"mount -o remount,size=64m {disk}; {again} > {tmp_path}/resumed 2>&1 || "
        f"{first} overwrite:=true > {tmp_path}/resumed 2>&1; cp -r {disk}/out {after}"
    )
    subprocess.run([*namespace, script], env=environment(palp), cwd=ROOT, capture_output=True, check=False)
    said = (tmp_path / "said").read_text()
    assert "No space left on device" in said
    rows = read_rows(then)
    assert rows or "Nothing is kept" in said
    for row in rows:
        assert len(read_sweep(then, row.row)[0]), row.row
    assert_equal(after, whole)


@pytest.mark.nightly
def test_on_a_disk_that_is_read_only_it_is_refused_in_words(palp: Palp, tmp_path: Path) -> None:
    out, disk = tmp_path / "disk" / "out", tmp_path / "disk"
    disk.mkdir()
    interrupt(out, "/experiment/trial", 5)
    launch = " ".join(palp.command("launch", SIM, *SMALL, f"out:={out}", "--compose", "--resume"))
    namespace = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    mount = f"mount --bind {disk} {disk} && mount -o remount,bind,ro {disk}"
    if subprocess.run([*namespace, mount], capture_output=True, check=False).returncode:
        pytest.skip("no right to mount a disk in a namespace of one's own")
    done = subprocess.run(
        [*namespace, f"{mount}; {launch}"], env=palp.environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.strip() == (f"no checkpoint can be written to {out}/checkpoint: Read-only file system")
    resume(out)  # the refusal has cost nothing


def test_palpations_of_the_trial_under_way_are_set_aside(whole: RigSession, tmp_path: Path) -> None:
    """As on the wall clock, where they cannot be made again as they were."""
    out = tmp_path / "out"
    shutil.copytree(whole.out, out)
    rows = read_rows(out)
    for count in (len(rows) - 1, len(rows) - 4):
        writer = SessionWriter(str(out), [0.002, 0.004, 0.008])
        writer.go_on(count, aside=True)
        writer.close()
    assert read_rows(out) == rows[:-4]
    assert read_rows(out / "interrupted" / "1") == rows[-1:]
    assert read_rows(out / "interrupted" / "2") == rows[-4:-1]
    assert len(list((out / "sweeps").iterdir())) == len(rows) - 4
    for row in rows[-4:-1]:
        kept, before = (read_sweep(folder, row.row)[0] for folder in (out / "interrupted/2", whole.out))
        assert kept.tolist() == before.tolist()
