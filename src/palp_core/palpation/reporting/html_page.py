"""A page for a study: what was asked, what came out, charts and tables; no other file needed."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from palp_core.palpation.reporting.charts import Chart, save
from palp_core.whole_file import write_whole

_CSS = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif;
  color: #222; background: #fff; max-width: 60rem; margin: 2.5rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin: 0 0 .3rem; } h2 { font-size: 1.2rem; margin: 2.4rem 0 .5rem;
  border-bottom: 1px solid #ddd; padding-bottom: .2rem; }
.lead { font-size: 1.08rem; border-left: 4px solid #0072B2; padding: .5rem 1rem; background: #f3f8fb; }
figcaption { color: #555; font-size: .9rem; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; font-size: .93rem; }
th, td { text-align: left; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid #e6e6e6;
  vertical-align: top; } th { font-weight: 600; border-bottom: 2px solid #bbb; }
figure { margin: 1rem 0 1.6rem; } img { max-width: 100%; height: auto; display: block; }
"""


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of plain text."""
    return f"<p{f' class={kind}' if kind else ''}>{escape(text)}</p>"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of plain text."""

    def line(tag: str, cells: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line("td", row) for row in rows)
    return f"<table><thead>{line('th', head)}</thead><tbody>{body}</tbody></table>"


def figure(chart: Chart, folder: Path, *, svg: bool = True) -> str:
    """Save a chart as PNG, CSV and, unless told not to, SVG; return it as part of a page."""
    data = base64.b64encode(save(chart, folder, svg=svg)).decode("ascii")
    files = [
        f"<code>{escape(chart.name)}.{kind}</code>" for kind in ("png", *(["svg"] if svg else []), "csv")
    ]
    return (
        f"<h2>{escape(chart.title)}</h2><figure><img alt={escape(chart.title)!r} "
        f'src="data:image/png;base64,{data}"><figcaption>{escape(chart.caption)} '
        f"Files: {', '.join(files)}.</figcaption></figure>"
    )


def write_page(folder: Path, title: str, parts: Sequence[str]) -> Path:
    """Write ``index.html`` into the folder; it appears under its name only when complete."""
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "index.html"
    write_whole(
        target,
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        f"<style>{_CSS}</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n",
    )
    return target
