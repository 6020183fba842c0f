"""The quality of recorded EMG as one page that needs no other file."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

COLUMNS = (
    "subject", "phase", "trial", "duration_s", "rate_hz", "unit", "burst_count", "cocontraction_mean",
    "lambda_2", "mvc_ratio", "clipped", "lost", "longest_gap_s", "above_mvc", "clamped", "flags", "error",
)  # fmt: skip
_MEANING = {
    "clipping": "samples at the converter's rails: the amplifier's gain was too high",
    "offset": "an offset larger than the signal, as of raw ADC counts; it was removed",
    "lost_samples": "samples missing or held at one value; bridged; no burst is taken there",
    "silent": "the signal never moves: an electrode is off, or it is the wrong column",
    "mvc_too_small": "the MVC is less than five times the rest: it was not maximal, or rest was not at rest",
    "no_rest": "rest is silent, so there is nothing to hold the MVC against",
    "above_mvc": "co-contraction above 1: the MVC was not maximal",
    "level_clamped": "bursts outside 0.05 to 0.55 of MVC, counted at the nearest level",
    "failed": "the trial could not be analysed; the table says why",
}
_CSS = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 80rem; margin: 2rem auto; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2rem; } .note { color: #555; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .88rem; }
th, td { text-align: left; padding: .25rem .7rem .25rem 0; border-bottom: 1px solid #e6e6e6; }
tr.bad td { background: #fff3ec; } img { max-width: 100%; } .scroll { overflow-x: auto; }
"""


def emg_page(
    title: str,
    records: Sequence[Mapping[str, Any]],
    by_phase: Mapping[str, Any],
    picture: tuple[str, bytes] | None,
) -> str:
    """Return the page.

    Args:
        title: Its heading.
        records: Trials, with the fields of ``COLUMNS`` where they have them.
        by_phase: Transitions per phase; empty for one trial.
        picture: Caption and PNG.
    """
    good = sum(not record["flags"] for record in records)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{good} of {len(records)} without a flag.</p>",
        _flags(records),
        _figure(picture),
        "<h2>Trials</h2><div class=scroll>" + _trials(records) + "</div>",
        _phases(by_phase),
        _settings(records),
    ]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_CSS}</style></head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _flags(records: Sequence[Mapping[str, Any]]) -> str:
    counts = Counter(flag for record in records for flag in record["flags"])
    lines = []
    for flag, count in counts.most_common():
        base = flag if flag in _MEANING else flag.removeprefix("mvc_")
        where = "" if flag == base else "in the MVC: "
        lines.append(f"<li><b>{escape(flag)}</b> ({count}): {where}{escape(_MEANING.get(base, ''))}</li>")
    return f"<ul>{''.join(lines)}</ul>" if lines else ""


def _figure(picture: tuple[str, bytes] | None) -> str:
    if picture is None:
        return ""
    data = base64.b64encode(picture[1]).decode("ascii")
    caption = escape(picture[0])
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _trials(records: Sequence[Mapping[str, Any]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in COLUMNS)
    body = []
    for record in records:
        cells = "".join(f"<td>{escape(_text(record.get(name)))}</td>" for name in COLUMNS)
        body.append(f"<tr{' class=bad' if record['flags'] else ''}>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"


def _phases(by_phase: Mapping[str, Any]) -> str:
    if not by_phase:
        return ""
    rows = "".join(
        f"<tr><td>{escape(phase)}</td><td>{one['transitions']}</td><td>{_text(one['lambda_2'])}</td></tr>"
        for phase, one in by_phase.items()
    )
    return (
        "<h2>Transitions between levels</h2><p class=note>Pooled over subjects and trials, none across a "
        "trial's end or a gap; lambda_2 is of the matrix with Jeffreys' prior, which pulls it down where "
        "transitions are few.</p>"
        f"<table><tr><th>phase</th><th>transitions</th><th>lambda_2</th></tr>{rows}</table>"
    )


def _settings(records: Sequence[Mapping[str, Any]]) -> str:
    first = next((record["settings"] for record in records if "settings" in record), None)
    if first is None:
        return ""
    text = ", ".join(f"{name} {_text(value)}" for name, value in first.items())
    return f"<p class=note>Settings: {escape(text)}. The published method states none of them.</p>"


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
