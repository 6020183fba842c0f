"""In which order a robot's phantoms are put on: few remounts, mixed block by block, or as a list says.

A list is a CSV with the columns ``phase`` (training, estimation), ``phantom`` and, in training, ``ring_mm``,
a line per trial. Lines of one phantom that follow each other in a phase are one mounting; a column ``mount``,
where there is one, begins another whenever its entry changes.
"""

import csv
import dataclasses
import io
from itertools import groupby
from pathlib import Path
from typing import Any

from palp_core.errors import PerceptionError
from palp_core.palpation.session.plan import ExperimentDesign, ListedMounting
from palp_core.whole_file import read_whole

GROUPED, EACH_TRIAL, BLOCKS = MOUNTINGS = ("grouped", "each_trial", "block_randomised")
"""The orders by name; any other word names a file."""


def ordered(design: ExperimentDesign, order: str) -> ExperimentDesign:
    """Return a design with its phantoms in an order.

    Args:
        design: The numbers.
        order: ``grouped``: as the design has it, each phantom as few times as its mounts say;
            ``each_trial``: the same in training, and every trial of estimation on a mounting of its own;
            ``block_randomised``: in each block every phantom is put on once, for one trial of estimation, or
            in training once for every ring; or a file of a list.
    """
    if order == GROUPED:
        return design
    if order in MOUNTINGS:
        return dataclasses.replace(
            design,
            training_mounts=max(1, design.repeats) if order == BLOCKS else design.training_mounts,
            estimation_mounts=max(1, design.trials_per_phantom),
        )
    return dataclasses.replace(design, listed=listed(Path(order), design))


def listed(path: Path, design: ExperimentDesign) -> tuple[ListedMounting, ...]:
    """Return the mountings of a list."""
    try:
        lines = csv.DictReader(io.StringIO(read_whole(path).decode("utf-8-sig"), newline=""))
        rows = [(lines.line_num, row) for row in lines]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise PerceptionError(
            f"{path}: the list of trials cannot be read: {error}; use {', '.join(MOUNTINGS)} or a CSV"
        ) from error
    if not rows:
        raise PerceptionError(f"{path}: the list has no trial; give lines of phase, phantom and ring_mm")
    checked = [_checked(path, number, row, design) for number, row in rows]
    phases = [phase for phase, *_ in checked]
    if phases != sorted(phases, reverse=True):  # training comes before estimation
        raise PerceptionError(f"{path}: all of training comes before estimation")
    return tuple(
        ListedMounting(phase, phantom, tuple(one[3] for one in trials))
        for (phase, phantom, _), trials in groupby(checked, key=lambda one: one[:3])
    )


def _checked(path: Path, number: int, row: dict[str, Any], design: ExperimentDesign) -> tuple[Any, ...]:
    """Return phase, phantom, mount and ring of a line."""
    where, phase, code = (
        f"{path}:{number}",
        (row.get("phase") or "").strip(),
        (row.get("phantom") or "").strip(),
    )
    if phase not in ("training", "estimation"):
        raise PerceptionError(f"{where}: phase is '{phase}'; it must be training or estimation")
    codes = [phantom.code for phantom in design.phantoms_of(phase)]
    if code not in codes:
        raise PerceptionError(f"{where}: no phantom '{code}' in {phase}; there are {', '.join(codes)}")
    ring_m = 0.0
    if phase == "training":
        text = (row.get("ring_mm") or "").strip()
        try:
            ring_m = float(text) / 1e3
        except ValueError:
            raise PerceptionError(
                f"{where}: ring_mm is '{text}'; training needs a ring position in mm"
            ) from None
        if all(abs(ring_m - known) > 1e-9 for known in design.rings_m):
            raise PerceptionError(f"{where}: ring_mm is {text}, which is not in rings_mm")
    return phase, code, (row.get("mount") or "").strip(), ring_m
