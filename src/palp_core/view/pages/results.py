"""The page of a run's results: its report, and every file of its folder."""

from __future__ import annotations

from functools import partial
from urllib.parse import quote

from fastapi import Response
from fastapi.responses import FileResponse
from nicegui import app, ui

from palp_core.view.pages.frame import frame
from palp_core.view.pages.parts import said, table
from palp_core.view.pages.viewer import Viewer
from palp_core.view.source.results import KINDS, ResultsSource

POLICY = "sandbox; default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'"
"""A file of results shows itself: it runs nothing, and asks for nothing but its pictures."""


def results_page(viewer: Viewer, source: ResultsSource) -> None:
    """Put up the page."""
    with frame(viewer):
        files = source.files()
        said("h2", "Files" if files else "there is nothing in it to show")
        rows = ((partial(_link, one.name), f"{one.size_bytes / 1e3:.1f} kB") for one in files)
        with ui.element("div").classes("files"):
            table(("File", "Size"), rows)


def _link(name: str) -> None:
    ui.link(name, f"/files/{quote(name)}", new_tab=True)


def serve_files(source: ResultsSource) -> None:
    """Answer for the files of a folder, and for nothing outside it."""

    @app.get("/files/{name:path}")  # type: ignore[untyped-decorator]
    def file(name: str) -> Response:
        path = source.path_of(name)
        if path is None:
            return Response("no such file\n", status_code=404, media_type="text/plain")
        headers = {"content-security-policy": POLICY, "cache-control": "no-store"}
        return FileResponse(path, media_type=KINDS[path.suffix], headers=headers)
