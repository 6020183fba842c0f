"""The page of a run's results: its report, and every file of its folder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import PurePosixPath
from urllib.parse import quote

from fastapi import Response
from fastapi.responses import FileResponse
from nicegui import app, ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import said, table
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.results import KINDS, ResultFile, ResultsSource

POLICY = (
    "sandbox; default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; frame-ancestors 'self'"
)
"""A file of results runs nothing, asks for nothing but its pictures, and only our page frames it."""


def results_page(viewer: Viewer, source: ResultsSource) -> None:
    """Put up the page."""
    with frame(viewer):
        files = source.files()
        if report := report_of(files):
            with ui.element("div").classes("row-of"):
                said("h2", "Report")
                ui.link("in a tab of its own", _way(report), new_tab=True)
            shown = ui.element("iframe").classes("report").props('sandbox="" loading="lazy"')
            shown.props["src"] = _way(report).lstrip("/")  # below this page's own address
            shown.props["title"] = report
        said("h2", "Files" if files else "there is nothing in it to show")
        with ui.element("div").classes("files"):
            table(
                ("File", "In these forms"), [(name, partial(_links, forms)) for name, forms in named(files)]
            )


def report_of(files: Sequence[ResultFile]) -> str | None:
    """Return the page that tells what came out, of those in the folder itself; None if there is none.

    >>> report_of([ResultFile("a.html", 1), ResultFile("report.html", 1)])
    'report.html'
    """
    pages = [one.name for one in files if one.name.endswith(".html") and "/" not in one.name]
    return next((name for name in ("report.html", "index.html", *pages) if name in pages), None)


def named(files: Sequence[ResultFile]) -> list[tuple[str, list[ResultFile]]]:
    """Return files by their names without endings, in the order they have.

    >>> [(name, len(of)) for name, of in named([ResultFile(f"charts/a.{end}", 1) for end in ("csv", "png")])]
    [('charts/a', 2)]
    """
    found: dict[str, list[ResultFile]] = {}
    for one in files:
        found.setdefault(str(PurePosixPath(one.name).with_suffix("")), []).append(one)
    return list(found.items())


def _links(forms: Sequence[ResultFile]) -> None:
    with ui.element("div").classes("row-of"):
        for one in forms:
            ui.link(PurePosixPath(one.name).suffix.lstrip("."), _way(one.name), new_tab=True)
            said("span", f"{one.size_bytes / 1e3:.1f} kB", "quiet")


def _way(name: str) -> str:
    return f"/files/{quote(name)}"


def serve_files(source: ResultsSource) -> None:
    """Answer for the files of a folder, and for nothing outside it."""

    @app.get("/files/{name:path}")  # type: ignore[untyped-decorator]
    def file(name: str) -> Response:
        path = source.path_of(name)
        if path is None:
            return Response("no such file\n", status_code=404, media_type="text/plain")
        headers = {
            "content-security-policy": POLICY,
            "x-frame-options": "SAMEORIGIN",
            "cache-control": "no-store",
        }
        return FileResponse(path, media_type=KINDS[path.suffix], headers=headers)
