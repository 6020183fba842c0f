"""Is what the register chooses right enough, and what does it cost beside the best choice? On new scenes.

A scene draws the quantities of a task, within the ranges of its stated bounds and beyond, and a tolerance.
The register chooses by what it states; then the choice and everything cheaper is measured against a truth
that the choice had no part in. Of each task: scenes in which the true error kept the tolerance, stated bounds
that were not kept, the declared cost of the choice over that of the cheapest method that would have done
(references, which are never chosen, left out), refusals, and how many of those were needless. A choice
that chance leaves open is measured longer, twice at most, while it is within three standard errors of
tolerance or bound, and is ``unclear`` if it still is; what is cheaper is measured once. A scene without an
answer to be right about is drawn again.

The task contact has a study of its own, ``palp study run contact-validity``. The default seed is none that
bounds were measured on. On SIGINT or SIGTERM it tells what it has.

Run: .venv/bin/python -m benchmarks.choices [--scenes 200] [--task NAME]... [--seed 7] [--json] [--out DIR]
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from benchmarks.choice_bench import counts, joint, touches, traced
from benchmarks.choice_bench.contest import Case, Verdict, judge
from benchmarks.choice_bench.table import Line, markdown, write
from palp_core.errors import PalpError

CONTESTS: dict[str, Callable[[np.random.Generator, int], Case]] = {
    **joint.CONTESTS,
    **counts.CONTESTS,
    **touches.CONTESTS,
    **traced.CONTESTS,
}
"""By task; draws a scene."""

_DRAWS = 50  # of a scene, until one has an answer


@dataclass
class Outcome:
    """What is known so far.

    Attributes:
        tasks: Those asked for.
        verdicts: In the order in which they came.
        redrawn: Scenes without an answer, by task.
        cpu_s: CPU time, by task.
        ended: ``complete`` or ``interrupted``.
    """

    tasks: Sequence[str]
    verdicts: list[Verdict] = field(default_factory=list)
    redrawn: dict[str, int] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)
    ended: str = "complete"

    def lines(self) -> list[Line]:
        """Return what every task came to."""
        by_task = {task: [one for one in self.verdicts if one.task == task] for task in self.tasks}
        return [Line.of(task, found, self.redrawn.get(task, 0)) for task, found in by_task.items()]


def run(
    tasks: Sequence[str], scenes: int, seed: int, tell: Callable[[str], object] = lambda _: None
) -> Outcome:
    """Judge scenes of every task, index by index, until all are done or somebody interrupts.

    Args:
        tasks: Which.
        scenes: Of each task.
        seed: Of the draw; a scene is the same whatever else is drawn.
        tell: Told of each scene.
    """
    outcome = Outcome(tasks)
    try:
        for task, index in _turns(tasks, scenes):
            begun_ns = time.process_time_ns()
            one = _judged(outcome, task, index, seed)
            spent_s = (time.process_time_ns() - begun_ns) / 1e9
            outcome.cpu_s[task] = outcome.cpu_s.get(task, 0.0) + spent_s
            outcome.verdicts.append(one)
            tell(_said(one))
    except KeyboardInterrupt:
        outcome.ended = "interrupted"
    return outcome


def _turns(tasks: Sequence[str], scenes: int) -> Iterator[tuple[str, int]]:
    """Give every task its next scene in turn: tasks of one index share what is touched."""
    for index in range(scenes):
        for task in tasks:
            yield task, index


def _judged(outcome: Outcome, task: str, index: int, seed: int) -> Verdict:
    problem = ""
    for draw in range(_DRAWS):
        rng = np.random.default_rng([seed, index, draw])
        try:
            return judge(CONTESTS[task](rng, index), index)
        except PalpError as error:
            outcome.redrawn[task] = outcome.redrawn.get(task, 0) + 1
            problem = str(error)
    raise PalpError(f"{task}: no scene of {_DRAWS} has an answer; the last: {problem}")


def _said(one: Verdict) -> str:
    asked = f"{one.task} {one.index}: {one.output} within {one.tolerance:.3g}"
    if not one.chosen:
        return f"{asked}: refused{f', needlessly: {one.best} would do' if one.best else ''}"
    spread = f" +- {one.sd:.2g}" if one.sd else ""
    kept = {"yes": "kept", "no": "NOT KEPT", "unclear": "unclear"}[one.kept]
    words = f"{asked}: {one.chosen}, {one.error:.3g}{spread} (stated {one.bound:.3g}), {kept}"
    return "; ".join([words, *(f"BROKEN {broken}" for broken in one.broken)])


def main() -> None:
    """Judge and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=200, help="of each task")
    parser.add_argument("--task", action="append", choices=sorted(CONTESTS), help="only this one; repeatable")
    parser.add_argument("--seed", type=int, default=8, help="of the draw")
    parser.add_argument("--json", action="store_true", help="an object for machines")
    parser.add_argument("--out", type=Path, metavar="DIR", help="choices.json, scenes.csv, choices.png there")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    tasks = options.task or list(CONTESTS)
    outcome = run(
        tasks, options.scenes, options.seed, lambda words: print(words, file=sys.stderr, flush=True)
    )
    lines = outcome.lines()
    about = {
        "seed": options.seed, "scenes": options.scenes, "ended": outcome.ended, "cpu_s": outcome.cpu_s,
    }  # fmt: skip
    if options.out is not None:
        write(options.out, lines, outcome.verdicts, about)
    if options.json:
        print(json.dumps({**about, "tasks": [vars(one) for one in lines]}))
        return
    print(markdown(lines))
    for one in outcome.verdicts:
        for broken in one.broken:
            print(f"{one.task} {one.index}, {one.words}: {broken}")
        if one.kept == "no":
            print(f"{_said(one)} ({one.words})")


if __name__ == "__main__":
    main()
