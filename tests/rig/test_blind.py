"""A blinded session, searched byte by byte, and looked at by somebody who wants to know."""

from __future__ import annotations

import base64
import json
import math
import re
import shutil
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.session.session import app
from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.problems import GraphProblems
from palp_core.palpation.mechanics.scene.sealed import own_codes, sealed_phantoms, standing
from palp_core.palpation.session import plan
from palp_core.palpation.session.decided.audit import decisions
from palp_core.palpation.session.operating.unsealing import sealed_name, unseal
from palp_core.palpation.session.recorded_session import believed_depths, read_session
from palp_core.palpation.session.recorded_sweeps import read_sweeps
from palp_core.palpation.session.report import write
from palp_core.palpation.session.result_json import read_result
from palp_core.palpation.session.run_note import read_note, refuse_resuming, refuse_without_key
from palp_core.palpation.session.trials_csv import read_rows
from palp_core.whole_file import write_whole
from tests.support.palp import ROOT, SIM
from tests.support.rig_session import ComposedGraph, check_here
from tests.support.sessions import no_charts

DEPTHS_M = {"A": 0.0021373, "B": 0.0042917, "C": 0.0067131}
"""Numbers that nothing else in a run has."""

SMALL = {"policy": "fixed", "policy.ring_mm": 16.0, "rings_mm": "8, 16", "blind": True}
MEASURED = {"/phantom/contact", "/torque/block", "/estimator/palpation", "/estimator/primitives"}
"""What is felt: it answers to the depth, or there was nothing to measure."""


@dataclass(frozen=True)
class Blinded:
    """A session and its bag."""

    out: Path
    bag: Path

    @property
    def key(self) -> Path:
        return self.out / "key.sealed"


def blinded(folder: Path, **given: object) -> Blinded:
    """Run a blinded session."""
    folder.mkdir()
    phantoms = folder.parent / "phantoms.yaml"
    phantoms.write_text("".join(f"{code}: {{bead: {{depth_m: {d}}}}}\n" for code, d in DEPTHS_M.items()))
    found = Blinded(folder / "out", folder / "bag")
    with ComposedGraph(
        SIM, out=found.out, record=found.bag, phantoms=phantoms, **{**SMALL, **given}
    ) as graph:
        summary = graph.run()
    assert summary.exit_code == 0, summary.ended
    assert "palp session unseal" in summary.report
    return found


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Blinded:
    """Two palpations of training a setting, one trial a phantom; only to be read."""
    return blinded(tmp_path_factory.mktemp("blind") / "one", training=2, trials=1)


@pytest.fixture
def copy(session: Blinded, tmp_path: Path) -> Path:
    return Path(shutil.copytree(session.out, tmp_path / "out"))


def signs(depth_m: float) -> Iterator[bytes]:
    """Yield in which forms a depth may be told."""
    for number in (depth_m, depth_m * 1e3):
        yield from (struct.pack(form, number) for form in ("<d", ">d"))
        yield f"{number:.5g}".encode()


def disguises(depth_m: float) -> Iterator[bytes]:
    """Yield in which forms somebody may find a depth who looks for it: what follows from it, however written.

    In m, cm, mm, um and inches; from below, over the bead's middle and bottom, per ball, inverse, squared,
    as a logarithm; as numbers of four and eight bytes, in decimal, in hexadecimal and in base 64.
    """
    units = [depth_m * unit for unit in (1.0, -1.0, 1e2, 1e3, 1e6, 39.3701, 39370.1)]
    places = [0.03 - depth_m, 0.0075 + depth_m, 0.015 + depth_m, 22.5 + depth_m * 1e3]
    others = [1.0 / depth_m, depth_m / 0.006, depth_m**2, math.log(depth_m), math.sqrt(depth_m)]
    plain = {depth_m.hex().encode(), struct.pack("<q", round(depth_m * 1e9))}
    for number in (*units, *places, *others):
        plain |= {struct.pack(form, number) for form in ("<d", ">d", "<f", ">f")}
        plain |= {format(number, form).encode() for form in (".6g", ".5e", ".5E", "")}
    yield from plain
    yield from (one.hex().encode() for one in plain)
    for one in plain:
        for shift in range(3):  # whatever stands before it
            coded = base64.b64encode(bytes(shift) + one).rstrip(b"=")
            yield coded[(0, 2, 3)[shift] : -1]


def found_in(data: bytes, wanted: set[bytes]) -> set[bytes]:
    """Return which of many words are in data: looked for by their first two bytes, then four, then all."""
    heads = np.unique([np.frombuffer(one[:4], "<u4")[0] for one in wanted])
    begins = np.zeros(1 << 16, dtype=bool)
    begins[heads & 0xFFFF] = True
    met = set()
    for shift in range(4):
        words = (
            np.frombuffer(data, "<u4", (len(data) - shift) // 4, shift) if len(data) > shift else heads[:0]
        )
        near = words[begins[words & 0xFFFF]]
        met |= set(near[np.isin(near, heads)].tolist())
    return {one for one in wanted if int.from_bytes(one[:4], "little") in met and one in data}


def test_no_byte_of_any_file_or_message_tells_a_depth_but_the_key(session: Blinded) -> None:
    wanted = {sign for d in DEPTHS_M.values() for sign in (*signs(d), *disguises(d))}
    assert len(wanted) > 755
    files = [path for path in session.out.rglob("*") if path.is_file() and path != session.key]
    assert len(files) > 12
    assert session.out / "session.yaml" in files
    held = {str(path.relative_to(session.out)): path.read_bytes() for path in files}
    for path in session.out.glob("sweeps/*.npz"):
        with np.load(path) as sweep:
            held[f"{path.name}, unpacked"] = b"".join(sweep[name].tobytes() for name in sweep)
    held |= {f"bag: {path.name}": path.read_bytes() for path in session.bag.glob("*.yaml")}
    with Bag(session.bag) as bag:
        for name in bag.topics():
            held[name] = b"\0".join(one.payload for one in bag.recorded([name]))
        held |= {f"attachment {name}": data for name, data in bag.attachments().items()}
        held["metadata"] = repr(bag.metadata()).encode()
    assert {"/experiment/trial", "/phantom/truth", "/experiment/_order", "/phantom/_order"} <= held.keys()
    assert {where: told for where, data in held.items() if (told := found_in(data, wanted))} == {}
    assert found_in(b"?" + max(wanted) + b"?", wanted) >= {max(wanted)}


class Killed(BaseException):
    """In place of a power cut, within one process."""


def interrupt(given: dict[str, Any]) -> None:
    """Run a session until its second trial is decided."""
    results = 0

    def observe(_: int, frame: bytes) -> None:
        nonlocal results
        if frame.startswith(b"/experiment/result\0"):
            results += 1
            if results == 2:
                raise Killed

    with pytest.raises(Killed), ComposedGraph(SIM, observe=observe, **given) as graph:
        graph.run()


def test_an_interrupted_one_shows_no_depth_either_and_resumes_with_its_key_only(
    session: Blinded, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    shutil.copyfile(session.key, out / "key.sealed")  # a key that is there holds: the same codes
    given: dict[str, Any] = {**SMALL, "training": 2, "trials": 1, "out": out}
    given["phantoms"] = session.out.parents[1] / "phantoms.yaml"
    interrupt(given)
    held = {path.name: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    del held["key.sealed"]
    wanted = [sign for d in DEPTHS_M.values() for sign in signs(d)]
    assert {name for name, data in held.items() if any(sign in data for sign in wanted)} == set()
    asked = {"blind": True, "key": str(out / "key.sealed")}
    refuse_without_key(asked)
    (out / "key.sealed").unlink()
    with pytest.raises(PalpError, match="is gone, and nothing else says which phantom is which"):
        refuse_without_key(asked)


def test_the_search_finds_what_a_session_in_the_open_tells(tmp_path: Path) -> None:
    """Or it proves nothing."""
    folder = tmp_path / "open"
    folder.mkdir()
    phantoms = tmp_path / "phantoms.yaml"
    phantoms.write_text("".join(f"{code}: {{bead: {{depth_m: {d}}}}}\n" for code, d in DEPTHS_M.items()))
    given = SMALL | {
        "blind": False,
        "training": 1,
        "trials": 0,
        "out": folder / "out",
        "record": folder / "bag",
    }
    with ComposedGraph(SIM, phantoms=phantoms, **given) as graph:
        graph.run()
    wanted = [sign for d in DEPTHS_M.values() for sign in signs(d)]
    with Bag(folder / "bag") as bag:
        told = {
            name
            for name in bag.topics()
            if any(sign in one.payload for one in bag.recorded([name]) for sign in wanted)
        }
    assert {"/experiment/trial", "/phantom/truth", "/phantom/methods"} <= told
    assert any(sign in (folder / "out/trials.csv").read_bytes() for sign in wanted)


def test_neither_the_order_of_codes_nor_the_seed_tells_which_is_which(session: Blinded) -> None:
    """The plan draws places among the sorted codes: the same places whatever phantom has which code."""
    codes = sorted(standing(session.key))

    def places(phantoms: list[str]) -> list[int]:
        design = plan.ExperimentDesign(
            phantoms=tuple(plan.PlannedPhantom(code, 100.0 + i) for i, code in enumerate(phantoms)),
            repeats=1,
            trials_per_phantom=2,
        )
        steps, found = plan.experiment(design, np.random.default_rng(1)), []
        step: plan.Step | None = next(steps)
        while step is not None:
            if isinstance(step, plan.MountPhantom):
                found.append(phantoms.index(step.phantom))
            estimating = isinstance(step, plan.Palpate) and not step.ring_given
            try:
                step = steps.send(plan.StepReply("decided" if estimating else "done"))
            except StopIteration:
                step = None
        return found

    assert places(codes) == places(["K1", "K2", "K3"])
    assert sealed_phantoms(session.key).keys() == set(codes)


def test_beside_what_is_felt_two_sessions_with_other_keys_say_the_same_at_the_same_times(
    tmp_path: Path,
) -> None:
    """Of one seed, in a world of its own luck: when, how often, how much and what is said of which place."""
    lab = {"training": 1, "trials": 0, "world": "lab"}
    first = other = blinded(tmp_path / "a", **lab)
    while order(other.key) == order(first.key):  # one in six
        other = blinded(tmp_path / f"b{len([*tmp_path.iterdir()])}", **lab)

    def seen(one: Blinded) -> dict[str, list[tuple[int, int, Any]]]:
        with Bag(one.bag) as bag:
            names = [
                name for name in bag.topics() if not name.endswith("/_order") and name != "/graph/events"
            ]
            return {
                name: [
                    (message.log_ns, len(message.payload), placed(message.payload, one.key))
                    for message in bag.recorded([name])
                ]
                for name in names
            }

    mine, theirs = seen(first), seen(other)
    assert mine.keys() == theirs.keys()
    assert {name for name in mine if times(mine[name]) != times(theirs[name])} == set()
    assert {name for name in mine if mine[name] != theirs[name]} <= MEASURED
    assert {"/phantom/truth", "/experiment/trial", "/actuator/truth"} <= mine.keys()
    assert [(row.start_ns, row.end_ns, row.true_height_m) for row in read_rows(first.out)] == [
        (row.start_ns, row.end_ns, row.true_height_m) for row in read_rows(other.out)
    ]


def times(heard: list[tuple[int, int, Any]]) -> list[int]:
    return [at for at, *_ in heard]


def placed(payload: bytes, key: Path) -> Any:
    """Return what a message says, with places among the session's codes for these."""
    places = {code: place for place, code in enumerate(sorted(standing(key)))}
    said = msgspec.msgpack.decode(payload)
    return {name: places.get(one, one) if isinstance(one, str) else one for name, one in said.items()}


def order(key: Path) -> list[str]:
    """Return the phantoms' own codes in the order of the session's."""
    own = own_codes(key)
    return [own[code] for code in sorted(own)]


def test_nobody_is_told_how_well_it_goes(session: Blinded) -> None:
    with Bag(session.bag) as bag:
        said = [one.value for one in bag.messages(["/experiment/progress"])]
        truths = [one.value for one in bag.messages(["/phantom/truth"])]
        topics = set(bag.topics())
    assert said
    assert not any(one.score_defined or "right" in one.text for one in said)
    assert all(one.rung == "" and one.bound == 0.0 and one.depth_m >= 100.0 for one in truths)
    assert not {path.name for path in session.out.iterdir()} & {"result.json", "report.html", "charts"}
    assert "/phantom/guard" not in topics


def test_who_would_analyse_it_is_refused_until_it_is_unsealed(session: Blinded) -> None:
    for read in (read_session, read_sweeps, believed_depths):
        with pytest.raises(PalpError, match="palp session unseal"):
            read(session.out)
    with pytest.raises(PalpError, match="palp session unseal"):
        read_sweeps(session.bag)
    assert "blinded" in write(session.out, read_note(session.out))


def test_unsealed_it_has_the_depths_and_what_was_written_before_is_kept(copy: Path) -> None:
    before = (copy / "trials.csv").read_bytes()
    learnt = json.loads((copy / "primitives.json").read_text())
    sealed = read_rows(copy)
    own = own_codes(copy / "key.sealed")
    with no_charts():
        done = CliRunner().invoke(app, ["unseal", str(copy), "--reason", "all is done"])
    assert done.exit_code == 0, done.output
    rows = read_rows(copy)
    assert [row.depth_m for row in rows] == [DEPTHS_M[own[row.phantom]] for row in rows]
    assert sealed_name(copy / "trials.csv").read_bytes() == before
    places = sorted(range(3), key=lambda place: DEPTHS_M[own[sorted(own)[place]]])
    for was, now in zip(sealed, rows, strict=True):
        assert now.posterior == ([was.posterior[place] for place in places] if was.posterior else [])
        if was.estimate_m is not None:
            assert now.estimate_m == DEPTHS_M[own[sorted(own)[round(was.estimate_m) - 100]]]
    told = json.loads((copy / "primitives.json").read_text())
    assert told["depths_m"] == sorted(DEPTHS_M.values())
    assert told["mean"] == [learnt["mean"][place] for place in places]
    assert np.all(np.diff(np.array(told["mean"])[:, -1]) < 0.0)  # a deeper nodule is felt less
    result = read_result(copy)
    assert result["accuracy"]["overall"]["of"] == 3
    assert {*result["mechanics"]["per_phantom"]} == {*own}
    assert [(one.deed, one.reason) for one in decisions(copy)] == [("unseal", "all is done")]
    with pytest.raises(PalpError, match="is not sealed"):
        unseal(copy, "again")


@pytest.mark.parametrize("done", range(4))
def test_unsealing_that_was_cut_off_is_finished_by_the_next_run(
    copy: Path, tmp_path: Path, done: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Path(shutil.copytree(copy, tmp_path / "whole"))
    unseal(whole, "all is done")
    write, left = write_whole, [done]

    def write_some(path: Path, content: str | bytes) -> None:
        if not left[0]:
            raise OSError("disk full")
        left[0] -= 1
        write(path, content)

    monkeypatch.setattr("palp_core.palpation.session.operating.unsealing.write_whole", write_some)
    with pytest.raises(OSError, match="disk full"):
        unseal(copy, "all is done")
    monkeypatch.undo()
    unseal(copy, "all is done")
    names = {path.name for path in whole.iterdir() if path.is_file()} - {"audit.csv"}
    assert {sealed_name(Path(name)).name for name in ("trials.csv", "primitives.json")} < names
    for name in names:
        assert (copy / name).read_bytes() == (whole / name).read_bytes()


def test_a_session_is_either_unsealed_or_resumed(copy: Path) -> None:
    (copy / "checkpoint").touch()
    with pytest.raises(PalpError, match=r"unfinished.*palp launch --resume, or remove"):
        unseal(copy, "curious")
    (copy / "checkpoint").unlink()
    unseal(copy, "all is done")
    with pytest.raises(PalpError, match="was unsealed"):
        refuse_resuming(copy)


def test_another_sessions_key_opens_nothing(copy: Path, tmp_path: Path) -> None:
    from palp_core.palpation.mechanics.scene.sealed import seal

    before = {path: path.read_bytes() for path in copy.iterdir() if path.is_file()}
    while {*seal(tmp_path / "other", sealed_phantoms(copy / "key.sealed"))} == {
        *own_codes(copy / "key.sealed")
    }:
        (tmp_path / "other").unlink()
    with pytest.raises(PalpError, match="another session's key"):
        unseal(copy, "with the wrong key", tmp_path / "other")
    assert {path: path.read_bytes() for path in copy.iterdir() if path.is_file()} == before


@pytest.mark.parametrize("file", ["sim.yaml", "emulated.yaml", "rig.yaml", "human.yaml"])
def test_a_sealed_key_is_read_by_no_session_in_the_open(file: str, session: Blinded) -> None:
    """It would tell the depth of each code, and no audit would know."""
    given = [f"phantoms:={session.key}", *(["order:=counterbalanced"] if file == "human.yaml" else [])]
    with pytest.raises(GraphProblems, match="is sealed: read in the open it would tell"):
        check_here(ROOT / "launch" / file, given)
    shown = CliRunner().invoke(app, ["plan", "--phantoms", str(session.key), "--order", "counterbalanced"])
    assert "is sealed" in str(shown.exception)
    assert shown.output == ""


def check(*given: str, file: Path = SIM) -> CheckedGraph:
    return check_here(file, ["blind:=true", *given])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("shared.depths:=31", "needs the depths themselves"),
        ("shared.filter:=latent", "needs the depths themselves"),
        ("reading:=trace", "needs the depths themselves"),
        ("policy:=information", "needs the depths themselves"),
        ("overwrite:=true", "a folder of its own"),
        ("mounting:=list.csv", "by their stickers"),
        ("specimens:=other", "no two of one depth"),
        ("specimens:=other phantoms:=", "needs the depths themselves"),
    ],
)
def test_what_needs_the_depths_is_refused_before_anything_starts(
    given: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(GraphProblems, match=re.escape(said)):
        check(*given.split(), f"out:={tmp_path / 'out'}")
    assert not (tmp_path / "out").exists()


def test_a_check_draws_no_key_and_real_phantoms_need_stickers(tmp_path: Path) -> None:
    check(f"out:={tmp_path / 'out'}")
    check(f"out:={tmp_path / 'out'}", file=ROOT / "launch/emulated.yaml")
    assert not (tmp_path / "out").exists()
    with pytest.raises(GraphProblems, match="palp session seal KEY"):
        check(f"out:={tmp_path / 'out'}", file=ROOT / "launch/rig.yaml")
    done = CliRunner().invoke(app, ["seal", str(tmp_path / "key")])
    assert "sticker" in done.stdout
    check(f"out:={tmp_path / 'out'}", f"phantoms:={tmp_path / 'key'}", file=ROOT / "launch/rig.yaml")
