"""Several sessions side by side, as a table for a terminal or a README."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from palp_core.palpation.session.result import SessionResult, read_result

__all__ = ["compare"]


def compare(outs: Sequence[str | Path]) -> str:
    """Return a Markdown table, one row per session, in the order given.

    Args:
        outs: Folders of sessions that have a result.

    Raises:
        PalpError: A folder has no result.
    """
    results = [read_result(out) for out in outs]
    depths = sorted({d for r in results for d in r.accuracy.per_depth_mm}, key=float)
    head = [
        "policy",
        "seed",
        "trials",
        "accuracy (95 %)",
        *(f"{depth} mm" for depth in depths),
        "probes",
        "undecided",
        "calibration error",
        "over-confidence",
    ]
    table = [head, *(_row(result, depths) for result in results)]
    widths = [max(len(line[column]) for line in table) for column in range(len(head))]
    lines = [
        "| " + " | ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)) + " |"
        for line in table
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    note = "Intervals are Wilson's over the trials of one session each; they do not span sessions."
    return "\n".join([*lines, "", note, ""])


def _row(result: SessionResult, depths: Sequence[str]) -> list[str]:
    overall, calibration = result.accuracy.overall, result.calibration
    interval = f" ({_percent(overall.ci[0])} to {_percent(overall.ci[1])})" if overall.ci else ""
    at_depth = [result.accuracy.per_depth_mm.get(depth) for depth in depths]
    return [
        result.policy_label(),
        str(result.seed),
        str(result.trials_done),
        _percent(overall.value) + interval,
        *(_percent(share.value if share else None) for share in at_depth),
        _number(result.probes_mean, "{:.1f}"),
        str(result.verdicts.undecided),
        _number(calibration.expected_error if calibration else None, "{:.3f}"),
        _number(calibration.overconfidence if calibration else None, "{:+.3f}"),
    ]


def _percent(value: float | None) -> str:
    return _number(None if value is None else 100.0 * value, "{:.1f}")


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(round(value, 3) + 0.0)  # + 0.0: no "-0.000"
