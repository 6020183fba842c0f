"""The data dictionary: every column of every table, with unit and meaning. All formats and the docs have it.

::

    trials       a row per trial
    iterations   a row per palpation
    sweeps       a row per sample of torque
    emg          a row per sample of EMG

and of a session with a person::

    human_trials      a row per trial
    human_recordings  a row per stretch of EMG: at rest, in the MVC, in a trial
    human_emg         a row per sample of these
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

Kind = Literal["integer", "number", "text", "flag"]
"""Of a column: int64; float64, NaN where there is none; UTF-8; yes, no or missing."""

FLAG_MISSING = -1
"""What a flag is in formats that know integers only, where it is neither 1 nor 0."""

PER_CLASS = "<class>"
"""Stands in a column's name for the depth, as 2mm or 2p5mm: there is such a column for every class."""


@dataclass(frozen=True)
class ExportColumn:
    """A column."""

    name: str  # letters, digits and underscores, as every format takes them
    kind: Kind
    unit: str  # SI; ``1`` of what has none, empty of texts and flags
    meaning: str  # what it says; where it may be missing, when


def _of(*lines: tuple[str, Kind, str, str]) -> tuple[ExportColumn, ...]:
    return tuple(ExportColumn(*line) for line in lines)


_WHO = _of(
    ("session", "text", "", "policy and seed of the session"),
    ("subject", "text", "", "code of the subject, from the session's sheet; none where nobody is measured"),
)
_WHAT = _of(
    ("phase", "text", "", "training, estimation, or a condition of the plan repeatability"),
    ("trial", "integer", "1", "number of the trial in its phase, from 1"),
)
_TOUCHED = _of(
    ("phantom", "text", "", "code of the phantom"),
    ("remount", "integer", "1", "number of the mounting, from 0"),
    ("depth_m", "number", "m", "true depth of the nodule"),
)

DICTIONARY: dict[str, tuple[ExportColumn, ...]] = {
    "trials": _WHO
    + _WHAT
    + _TOUCHED
    + _of(
        ("palpations", "integer", "1", "number of palpations"),
        ("estimate_m", "number", "m", "estimated depth at the end; missing in training"),
        (
            "confidence",
            "number",
            "1",
            "probability of the most probable depth at the end; missing in training",
        ),
        (
            "right",
            "flag",
            "",
            "whether of all trained depths the true one is next to the estimate; missing in training",
        ),
        (
            "verdict",
            "text",
            "",
            "decided, undecided at the most palpations, dropped, or continue where the record ends "
            "within the trial; empty in training",
        ),
        ("policy", "text", "", "policy that chose the last ring position"),
        ("seed", "integer", "1", "of every random number of the session"),
        ("start_s", "number", "s", "begin of the first sweep, on the run's clock"),
        ("end_s", "number", "s", "end of the last sweep, on the run's clock"),
        ("excluded", "flag", "", "whether it was decided later that the trial does not count"),
        ("excluded_why", "text", "", "what was decided and why; empty where it counts"),
    ),
    "iterations": _of(
        ("row", "integer", "1", "number of the palpation, from 0, over all phases; key of table sweeps"),
    )
    + _WHO
    + _WHAT
    + _of(("iteration", "integer", "1", "number of the palpation within its trial, from 1"))
    + _TOUCHED
    + _of(
        ("ring_m", "number", "m", "ring position r_a as commanded"),
        ("true_ring_m", "number", "m", "ring position as it was; missing where only a simulation would know"),
        ("true_height_m", "number", "m", "offset of the phantom's height; missing likewise"),
        (
            "peak_n_m",
            "number",
            "N m",
            "what was read off the sweep: its peak, or another feature if asked for",
        ),
        (
            f"posterior_{PER_CLASS}",
            "number",
            "1",
            "belief in this depth after the palpation; missing in training",
        ),
        (f"gain_{PER_CLASS}", "number", "nat", "P log(P / P_0) of this depth, eq. (8); missing in training"),
        ("gamma", "number", "1", "correlation distance of successive gains; missing where it is not defined"),
        ("verdict", "text", "", "decided, undecided, dropped or continue; empty in training"),
        ("estimate_m", "number", "m", "most probable depth; missing in training"),
        ("outlier", "flag", "", "whether the reading fits none of the depths"),
        ("policy", "text", "", "policy that chose the ring position"),
        ("seed", "integer", "1", "of every random number of the session"),
        ("start_s", "number", "s", "time of the first torque sample, on the run's clock"),
        ("end_s", "number", "s", "time of the last torque sample, on the run's clock"),
        ("landed", "flag", "", "whether the ring was moved or re-homed before"),
        ("guards", "text", "", "what the simulated sweep met in which its contact model may be wrong"),
        ("enter_s", "number", "s", "when the stage was to come over the path; missing where nobody told"),
        ("leave_s", "number", "s", "when the stage was to leave the path; missing where nobody told"),
    ),
    "sweeps": _of(
        ("row", "integer", "1", "number of the palpation; key of table iterations"),
        ("sample", "integer", "1", "number of the sample in its sweep, from 0"),
        ("time_s", "number", "s", "since the first sample of the sweep"),
        ("torque_n_m", "number", "N m", "torque at the probe's base as measured"),
    ),
    "emg": _of(
        ("time_s", "number", "s", "on the run's clock"),
        ("phase", "text", "", "rest, mvc (maximum voluntary contraction) or palpation; empty where lost"),
        ("fds_v", "number", "V", "flexor digitorum superficialis, raw; missing where samples were lost"),
        ("edc_v", "number", "V", "extensor digitorum communis, raw; missing where samples were lost"),
    ),
    "human_trials": _of(
        ("subject", "text", "", "code of the subject"),
        ("phase", "text", "", "training, in which the depth is told, or estimation"),
        ("trial", "integer", "1", "number of the trial in its phase, from 1"),
        ("attempt", "integer", "1", "from 1; what was spoilt is done again"),
        ("phantom", "text", "", "code of the phantom"),
        ("depth_m", "number", "m", "true depth of the nodule; missing where it is sealed"),
        ("told", "flag", "", "whether the subject was told the depth"),
        ("palpation_s", "number", "s", "from begin to end of the palpation"),
        ("ended_by", "text", "", "subject, limit (of time), or repeat where it was spoilt"),
        ("answer_s", "number", "s", "from the question to the answer; missing where nobody was asked"),
        ("answer_m", "number", "m", "depth as it was said; missing likewise"),
        ("estimate_m", "number", "m", "of the phantoms' depths the nearest to the answer; missing likewise"),
        ("recording", "integer", "1", "key of table human_recordings; -1 where no EMG came"),
        ("lost_count", "integer", "1", "samples of EMG that were lost"),
        ("clipped_count", "integer", "1", "samples of EMG at the amplifier's rails"),
        ("source", "text", "", "whose muscles: person, emulator, file or simulated"),
        ("answered_by", "text", "", "who typed the answers; script: nobody did"),
        ("order", "text", "", "paper (Tables 3 and 4) or counterbalanced"),
        ("subject_number", "integer", "1", "of the subject in the study, from 1; of the order"),
        ("seed", "integer", "1", "of the study's orders"),
        ("end_s", "number", "s", "when the trial was written, on the run's clock"),
        ("excluded", "flag", "", "whether the trial does not count: spoilt, or decided so later"),
        ("excluded_why", "text", "", "what was decided and why; empty where it counts"),
    ),
    "human_recordings": _of(
        ("recording", "integer", "1", "number of the recording, from 0"),
        ("file", "text", "", "in the session's folder"),
        ("subject", "text", "", "code of the subject"),
        ("phase", "text", "", "rest, mvc (maximum voluntary contraction), training or estimation"),
        ("trial", "integer", "1", "number of the trial in its phase; -1 of rest and mvc"),
        ("rate_hz", "number", "Hz", "samples a second"),
        ("samples", "integer", "1", "number of samples of each muscle"),
    ),
    "human_emg": _of(
        ("recording", "integer", "1", "key of table human_recordings"),
        ("sample", "integer", "1", "number of the sample in its recording, from 0"),
        ("time_s", "number", "s", "since the recording's begin"),
        ("fds_v", "number", "V", "flexor digitorum superficialis, raw; missing where samples were lost"),
        ("edc_v", "number", "V", "extensor digitorum communis, raw; missing where samples were lost"),
    ),
}
"""The columns of each table, in their order."""


def columns_of(table: str, depths_m: Sequence[float]) -> tuple[ExportColumn, ...]:
    """Return the columns of a table, those of a class for each depth.

    >>> [one.name for one in columns_of("iterations", [0.002, 0.0025]) if "posterior" in one.name]
    ['posterior_2mm', 'posterior_2p5mm']
    """
    found: list[ExportColumn] = []
    for one in DICTIONARY[table]:
        if PER_CLASS not in one.name:
            found.append(one)
            continue
        for depth_m in depths_m:
            name = one.name.replace(PER_CLASS, class_name(depth_m))
            meaning = one.meaning.replace("this depth", f"the depth {1e3 * depth_m:g} mm")
            found.append(replace(one, name=name, meaning=meaning))
    return tuple(found)


def class_name(depth_m: float) -> str:
    """Return a depth as names of columns have it.

    >>> class_name(0.0025), class_name(0.008)
    ('2p5mm', '8mm')
    """
    return f"{1e3 * depth_m:g}mm".replace(".", "p").replace("-", "m").replace("+", "")


def as_markdown() -> str:
    """Return the dictionary as a text of tables."""
    parts = []
    for name, columns in DICTIONARY.items():
        lines = [f"| `{one.name}` | {one.kind} | {one.unit} | {one.meaning} |" for one in columns]
        head = [f"#### `{name}`", "", "| column | kind | unit | meaning |", "|---|---|---|---|"]
        parts.append("\n".join([*head, *lines, ""]))
    return "\n".join(parts)
