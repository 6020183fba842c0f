"""The report of a session as one page that needs no other file, for reading and for printing."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from typing import Any

from palp_core.palpation.reporting.charts import Chart
from palp_core.palpation.session.published import FIXED, HUMAN_STRATEGY_TEXT
from palp_core.palpation.session.result_json import policy_label

_CSS = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif;
  color: #222; background: #fff; max-width: 54rem; margin: 2.5rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; } h2 { font-size: 1.2rem; margin: 2.4rem 0 .5rem;
  border-bottom: 1px solid #ddd; padding-bottom: .2rem; }
.lead { font-size: 1.12rem; border-left: 4px solid #0072B2; padding: .5rem 1rem; background: #f3f8fb; }
.meta, figcaption, .note { color: #555; font-size: .9rem; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; font-size: .93rem; }
th, td { text-align: left; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid #e6e6e6;
  vertical-align: top; }
th { font-weight: 600; border-bottom: 2px solid #bbb; } td.n, th.n { text-align: right; }
tr.total td { font-weight: 600; border-top: 2px solid #bbb; } td.node { font-weight: 600; }
td.assumed { color: #9a3d00; } code { font-size: .9em; }
figure { margin: 1rem 0 1.6rem; } img { max-width: 100%; height: auto; display: block; }
@media print { body { margin: 0; max-width: none; font-size: 11pt; } figure, tr { break-inside: avoid; }
  h2 { break-after: avoid; } .lead { background: none; } }
"""


def headline(result: dict[str, Any]) -> str:
    """Return the session in a sentence."""
    overall = result["accuracy"]["overall"]
    if not overall["of"]:
        return f"{result['palpations']} palpations were recorded and no trial of estimation came to an end."
    low, high = (100.0 * bound for bound in overall["ci"])
    return (
        f"The policy “{policy_label(result)}” found the right depth in {overall['right']} of {overall['of']} "
        f"trials: {100.0 * overall['value']:.1f} % (95 % interval {low:.1f} to {high:.1f} %, this session "
        f"only), with {result['probes_mean']:.1f} palpations a trial; "
        f"chance is {100.0 * result['chance']:.1f} %."
    )


def page(result: dict[str, Any], charts: Sequence[tuple[Chart, bytes]]) -> str:
    """Return the page.

    Args:
        result: As of ``result.json``.
        charts: Each chart with its PNG.
    """
    simulated = result["mechanics"] is not None
    parts = [
        f"<h1>Palpation session, policy: {escape(policy_label(result))}</h1>",
        f'<p class="meta">Seed {result["seed"]} · {result["trials_done"]} trials of estimation · '
        f"{result['palpations']} palpations · {'simulated rig' if simulated else 'rig with devices'}</p>",
        f'<p class="lead">{escape(headline(result))}</p>',
        _results(result),
        *(_figure(chart, image) for chart, image in charts),
        _confusion(result),
        _mechanics(result),
        _protocol(result),
        _speed(result),
        _versions(result),
    ]
    title = f"Palpation session, {escape(policy_label(result))}"
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{title}</title>\n'
        f"<style>{_CSS}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body>\n</html>\n"
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], numeric: int = 0, total: bool = False) -> str:
    """Return a table of plain text; columns from ``numeric`` on align right, a total is the last row."""

    def line(tag: str, cells: Sequence[str], kind: str = "") -> str:
        inner = "".join(
            f"<{tag}{' class=n' if i >= numeric else ''}>{escape(cell)}</{tag}>"
            for i, cell in enumerate(cells)
        )
        return f"<tr{kind}>{inner}</tr>"

    last = len(rows) - 1
    body = [line("td", row, " class=total" if total and i == last else "") for i, row in enumerate(rows)]
    return f"<table><thead>{line('th', head)}</thead><tbody>{''.join(body)}</tbody></table>"


def _results(result: dict[str, Any]) -> str:
    accuracy = result["accuracy"]
    if not accuracy["overall"]["of"]:
        return "<h2>Results</h2><p>No trial of estimation was ended, so there is no accuracy to report.</p>"
    probes = result["probes_mean_per_depth_mm"]
    rows = [
        _result_row(
            f"{depth} mm",
            share,
            probes[depth],
            FIXED.get(depth),
            "better than fixed" if depth in FIXED else "",
        )
        for depth, share in accuracy["per_depth_mm"].items()
    ]
    rows.append(
        _result_row(
            "overall", accuracy["overall"], result["probes_mean"], FIXED["overall"], HUMAN_STRATEGY_TEXT
        )
    )
    head = [
        "depth",
        "right",
        "accuracy",
        "95 % interval",
        "palpations",
        "paper, fixed",
        "paper, human strategy",
    ]
    verdicts, rule = result["verdicts"], result["stop_rule"]
    settings = ", ".join(f"{name} {value:g}" for name, value in rule["settings"].items()) if rule else ""
    unfinished = result["trials_unfinished"]
    return (
        "<h2>Results</h2>"
        + _table(head, rows, numeric=1, total=True)
        + '<p class="note">Intervals are Wilson’s over the trials of one training and one set of phantoms, '
        f"with {result['mounts']['estimation']} mounting(s) in estimation. "
        "Such trials are not independent of each other: the intervals speak for this session only, and "
        "policies are compared over many independent sessions. The paper’s fixed figures average five ring "
        "positions.</p>"
        + f"<p>{verdicts['decided']} trials ended decided, {verdicts['undecided']} undecided at the largest "
        "number of palpations; an undecided trial counts with its last estimate."
        + (f" Stop rule: <code>{escape(rule['name'])}</code> ({escape(settings)})." if rule else "")
        + (f" Trials that the record does not see end: {unfinished}, left out." if unfinished else "")
        + "</p>"
    )


def _result_row(
    name: str, share: dict[str, Any], probes: float, fixed: float | None, human: str
) -> list[str]:
    low, high = (100.0 * bound for bound in share["ci"])
    return [
        name,
        f"{share['right']} of {share['of']}",
        f"{100.0 * share['value']:.1f} %",
        f"{low:.1f} to {high:.1f} %",
        f"{probes:.1f}",
        "" if fixed is None else f"{100.0 * fixed:.3g} %",
        human,
    ]


def _figure(chart: Chart, image: bytes) -> str:
    data = base64.b64encode(image).decode("ascii")
    return (
        f'<h2>{escape(chart.title)}</h2><figure><img alt="{escape(chart.title)}" '
        f'src="data:image/png;base64,{data}"><figcaption>{escape(chart.caption)} '
        f"Numbers: <code>charts/{escape(chart.name)}.csv</code>.</figcaption></figure>"
    )


def _confusion(result: dict[str, Any]) -> str:
    if not result["trials_done"]:
        return ""
    depths = [f"{depth:g} mm" for depth in result["confusion"]["depths_mm"]]
    counts = result["confusion"]["actual_by_estimated"]
    rows = [[depth, *map(str, line)] for depth, line in zip(depths, counts, strict=True)]
    head = ["true depth", *(f"estimated {depth}" for depth in depths)]
    return "<h2>Which depth was taken for which</h2>" + _table(head, rows, numeric=1)


def _mechanics(result: dict[str, Any]) -> str:
    mechanics = result["mechanics"]
    if mechanics is None:
        return ""
    phantoms: dict[tuple[str, str, str], list[str]] = {}
    for code, choice in mechanics["per_phantom"].items():
        alike = (choice["rung"], f"{100.0 * choice['bound']:.1f} %", choice["reason"])
        phantoms.setdefault(alike, []).append(code)
    rows = [[", ".join(codes), *alike] for alike, codes in phantoms.items()]
    return (
        f"<h2>Mechanics</h2><p>The touch is simulated. Asked for: the {escape(mechanics['output'])} within "
        f"{100.0 * mechanics['tolerance']:g} %; the cheapest contact model that vouches for it was used.</p>"
        + _table(["phantom", "model", "stated error", "why"], rows, numeric=4)
        + _scene(mechanics["scene"])
    )


def _scene(scene: dict[str, dict[str, dict[str, Any]]]) -> str:
    """Return the numbers of probe and phantoms; phantoms that share one share a line."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for thing, quantities in scene.items():
        for name, entry in quantities.items():
            alike.setdefault((name, _plain(entry["value"]), entry["basis"]), []).append(thing)
    lines = [
        f'<tr><td class="node">{escape(", ".join(things))}</td><td><code>{escape(name)}</code></td>'
        f"<td>{escape(value)}</td><td{_mark(basis)}>{escape(basis)}</td></tr>"
        for (name, value, basis), things in alike.items()
    ]
    return (
        "<table><thead><tr><th>of</th><th>quantity</th><th>value</th><th>basis</th></tr></thead><tbody>"
        + "".join(lines)
        + "</tbody></table>"
    )


def _mark(basis: str) -> str:
    return ' class="assumed"' if "assumed" in basis or "reconstruction" in basis else ""


def _protocol(result: dict[str, Any]) -> str:
    lines = []
    for node, parameters in result["protocol"].items():
        for i, (name, entry) in enumerate(parameters.items()):
            basis = entry["basis"]
            lines.append(
                f'<tr><td class="node">{escape(node) if i == 0 else ""}</td>'
                f"<td><code>{escape(name)}</code></td>"
                f"<td>{escape(_plain(entry['value']))}</td><td{_mark(basis)}>{escape(basis)}</td></tr>"
            )
    return (
        "<h2>Protocol</h2><p>Every node’s parameters as run, and what each rests on. What was assumed is in "
        "colour; what has no basis named is a choice of the run or the software.</p><table>"
        "<thead><tr><th>node</th><th>parameter</th><th>value</th><th>basis</th></tr></thead><tbody>"
        + "".join(lines)
        + "</tbody></table>"
    )


def _plain(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return "(none)" if value == "" else str(value)


def _speed(result: dict[str, Any]) -> str:
    rows = [
        ["sweeping", f"{result['sweep_s']:,.0f} s"],
        ["whole session on the rig’s clock", f"{result['sim_time_s']:,.0f} s"],
        ["wall time", f"{result['wall_time_s']:,.1f} s"],
        ["seconds of sweep per second of wall time", _rate(result["sweep_s_per_wall_s"])],
        ["palpations per second of wall time", _rate(result["palpations_per_wall_s"])],
    ]
    if result["clock"] == "sim":
        rows.append(["activations of nodes", f"{result['activations']:,}"])
        rows.append(["nodes", "all in one process" if result["composed"] else "a process each"])
    return "<h2>Speed</h2>" + _table(["what", "how much"], rows, numeric=1)


def _rate(value: float | None) -> str:
    return "–" if value is None else f"{value:,.1f}"


def _versions(result: dict[str, Any]) -> str:
    versions = " · ".join(f"{name} {version}" for name, version in result["versions"].items())
    return f'<p class="note">{escape(versions)}</p>'
