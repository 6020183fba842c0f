"""``palp launch --repeat N``: a launch file N times side by side, each run with its own seed and folder."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from palp_core.cli.output import note, print_text
from palp_core.counted import counted
from palp_core.errors import GraphError

if TYPE_CHECKING:
    from palp_core.graph.description.checked import CheckedGraph

SEED, OUT = "seed", "out"
"""The arguments of the launch file by which its runs differ."""

ANEW = "overwrite:=true"
"""By which a launch file replaces what is there."""


class Pooling(Protocol):
    """What a launch file's report does about several runs."""

    def complete(self, folder: Path) -> bool:
        """Tell whether a folder holds a run that came to its end, with its report."""

    def pool(self, folder: Path) -> str:
        """Write what the runs below a folder say together; return it in words."""


@dataclass(frozen=True)
class Run:
    """One of the runs.

    Attributes:
        seed: Of it: the launch file's ``seed``, and those that follow.
        folder: Its own, below the launch file's ``out``.
        way: It begins, or is done.
        anew: Replace what is in its folder: a run that was cut off.
    """

    seed: int
    folder: Path
    way: Literal["begin", "done"]
    anew: bool = False

    @property
    def words(self) -> list[str]:
        """The words of its command that are its own."""
        own = [f"{SEED}:={self.seed}", f"{OUT}:={self.folder}"]
        return own + [ANEW] * self.anew


def repeat(file: Path, overrides: Sequence[str], count: int, *, compose: bool, resume: bool) -> int:
    """Run a launch file several times on all cores, and pool what comes out; return the exit status.

    Raises:
        GraphError: Its runs cannot go on side by side, or are there already.
    """
    from palp_core.cli.launch.side_by_side import run_side_by_side
    from palp_core.graph.launch.checking import check_file
    from palp_core.graph.launch.summary import report_function
    from palp_core.graph.supervision.interrupt import Interrupted

    checked = check_file(file, overrides)
    refuse(file, checked, count)
    pooling: Pooling = report_function(checked.report, checked.workspace)  # type: ignore[assignment]
    runs = plan(checked, count, pooling, resume=resume)
    out = runs[0].folder.parent
    left = [run for run in runs if run.way != "done"]
    workers = min(len(os.sched_getaffinity(0)), max(len(left), 1))
    done = f", {count - len(left)} of them done already" if len(left) < count else ""
    seeds = f"seeds {runs[0].seed} to {runs[-1].seed}" if count > 1 else f"seed {runs[0].seed}"
    pace = f", {workers} at a time" if left else ""
    note(f"{counted(count, 'run')} of {file}, {seeds}{done}{pace}: {out}/{runs[0].folder.name} ...")
    words = [word for word in overrides if word.partition(":=")[0] not in (SEED, OUT)]
    options = ["--compose"] if compose else []
    commands = {f"seed {run.seed}": [str(file), *words, *run.words, *options] for run in left}
    again = shlex.join(
        ["palp", "launch", str(file), *overrides]
        + ([] if any(word.startswith(f"{OUT}:=") for word in overrides) else [f"{OUT}:={out}"])
        + [*options, "--repeat", str(count), "--resume"]
    )
    try:
        failed = run_side_by_side(commands, workers)
    except Interrupted as stop:
        whole = sum(pooling.complete(run.folder) for run in runs)
        note(f"{stop}; every run has ended, {whole} of {count} are whole; to go on where they were: {again}")
        return 128 + int(stop.signal)
    for name, why in failed.items():
        note(f"{name} did not come to its end: {why}")
    if failed:
        note(f"to go on: {again}")
    print_text(pooling.pool(out))
    return 1 if failed else 0


def refuse(file: Path, checked: CheckedGraph, count: int) -> None:
    """Refuse what cannot go on side by side.

    Raises:
        GraphError: It cannot.
    """
    if count < 1:
        raise GraphError(f"--repeat {count}: one run at least")
    if checked.clock != "sim":
        raise GraphError(
            f"{file}: --repeat: its graph goes by the machine's clock: side by side its runs would share "
            "the cores that they are timed on, and on a rig the devices; launch it once for each"
        )
    if lacking := [name for name in (SEED, OUT) if name not in checked.args]:
        raise GraphError(
            f"{file}: --repeat: each run has a seed and a folder of its own, and the file has no argument "
            f"{' and no argument '.join(lacking)}"
        )
    from palp_core.graph.launch.summary import report_function

    if not checked.report or not hasattr(report_function(checked.report, checked.workspace), "pool"):
        raise GraphError(f"{file}: --repeat: its report does not say what several runs say together")


def plan(checked: CheckedGraph, count: int, pooling: Pooling, *, resume: bool) -> list[Run]:
    """Return the runs; of those that are there already only what is left.

    Raises:
        GraphError: Runs are there and are not to go on, or none is there that could.
    """
    out, first = Path(checked.args[OUT]), int(checked.args[SEED])
    folders = {seed: out / f"seed_{seed}" for seed in range(first, first + count)}
    there = [folder for folder in folders.values() if folder.exists()]
    if resume and not there:
        raise GraphError(f"nothing to resume: {out} has no run; name the folder that has: out:=NAME")
    if there and not resume and not checked.args.get("overwrite"):
        raise GraphError(
            f"{there[0]} is there already: --resume goes on with the runs of {out} and begins those that are "
            "missing; out:=NAME begins anew elsewhere"
        )
    return [_found(checked, seed, folder, pooling, resume=resume) for seed, folder in folders.items()]


def _found(checked: CheckedGraph, seed: int, folder: Path, pooling: Pooling, *, resume: bool) -> Run:
    """Return what is left of a run."""
    if not resume or not folder.exists():
        return Run(seed, folder, "begin")
    can_replace = checked.args.get("overwrite") is False  # there is such an argument, and it was not given
    if pooling.complete(folder):
        return Run(seed, folder, "done")
    return Run(seed, folder, "begin", anew=can_replace)


def refuse_options(given: dict[str, Any]) -> None:
    """Refuse options that are of one run.

    Args:
        given: Options as written, by name, each with its value.

    Raises:
        GraphError: One is given.
    """
    for name, value in given.items():
        if value:
            raise GraphError(f"--repeat with {name}: that is of one run; launch that one by its seed")
