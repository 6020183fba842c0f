"""What the viewer itself costs: until its first page, in memory, on disk, to import."""

from __future__ import annotations

import importlib.metadata
import re
import resource
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.view_bench.running import (
    ROOT,
    Launched,
    browser,
    emulated,
    end,
    memory_mib,
    spread,
    two_viewers,
    wait,
)
from palp_core.graph.clock import monotonic_ns
from tests.support.view.browser import Viewing

IMPORT = "from nicegui import ui"


@contextmanager
def shown_rig(*, beside: bool) -> Iterator[tuple[Launched, Any]]:
    """The emulated rig and a browser that is open."""
    with (
        tempfile.TemporaryDirectory() as name,
        emulated() as run,
        browser(Path(name), beside=beside) as found,
    ):
        yield run, found


def first_page(rounds: int, *, beside: bool) -> dict[str, Any]:
    """Return wall seconds from ``palp view`` to the graph on its page, in a browser that is open already.

    Of palp as ``pip install`` leaves it, its modules compiled: a first time, not counted, compiles them.
    """
    took_s: list[float] = []
    with tempfile.TemporaryDirectory() as compiled, shown_rig(beside=beside) as (run, chrome):
        run.palp.environment.pop("PYTHONDONTWRITEBYTECODE", None)
        run.palp.environment["PYTHONPYCACHEPREFIX"] = compiled
        for _ in range(1 + rounds):
            begun_ns = monotonic_ns()
            viewing = Viewing(chrome, run.view())
            viewing.page.wait_for_selector("[data-node]")
            took_s.append((monotonic_ns() - begun_ns) / 1e9)
            viewing.page.close()
            end(viewing.process)
    return {"seconds": spread(took_s[1:], 2)}


def memory(minutes: float, every_s: float, *, beside: bool) -> dict[str, Any]:
    """Return how the memory of two viewers goes on while they show the emulated rig.

    Of a page: what is in use on its heap once its garbage is gone. A page that loads itself anew, as it does
    when the viewer has forgotten it, begins again; how often that was is told.
    """
    rows: list[list[float]] = []
    loads: list[str] = []
    with shown_rig(beside=beside) as (run, chrome), two_viewers(run, chrome) as viewers:
        for one in viewers:
            one.page.on("load", lambda page: loads.append(str(page.url)))
        begun_ns = monotonic_ns()
        while (at_s := (monotonic_ns() - begun_ns) / 1e9) < minutes * 60 or len(rows) < 3:
            sizes = [memory_mib(one.process.pid) for one in viewers]
            rows.append([at_s, *sizes, *(_heap_mib(one.page) for one in viewers)])
            said = " ".join(f"{size:.1f}" for size in rows[-1][1:])
            print(f"memory: {at_s / 60:.1f} min: {said} MiB", file=sys.stderr, flush=True)
            wait(every_s)
    table = np.array(rows)
    table = table[len(table) // 5 :]  # after it has filled what it keeps
    names = ("viewer of the graph", "viewer of torque", "page of the graph", "page of torque")
    return {
        "minutes": round(float(table[-1, 0]) / 60, 1),
        "loaded_anew": len(loads),
        **{
            name: {
                "mib": spread(table[:, column].tolist(), 1),
                "mib_per_minute": round(float(np.polyfit(table[:, 0], table[:, column], 1)[0]) * 60, 3),
            }
            for column, name in enumerate(names, 1)
        },
    }


def _heap_mib(page: Any) -> float:
    """Return what a page's heap holds after a collection."""
    speaking = page.context.new_cdp_session(page)
    try:
        speaking.send("HeapProfiler.collectGarbage")
        return float(speaking.send("Runtime.getHeapUsage")["usedSize"]) / 2**20
    finally:
        speaking.detach()


def extra(rounds: int) -> dict[str, Any]:
    """Return what the extra ``view`` adds: MiB on disk, packages, seconds of wall and CPU to import it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    alone, whole = set[str](), set[str]()
    for line in project["dependencies"]:
        alone = _needed(_name(line), alone)
    for line in project["optional-dependencies"]["view"]:
        whole = _needed(_name(line), alone)
    brought = sorted(whole - alone)
    size = sum(
        path.stat().st_size
        for name in brought
        for file in importlib.metadata.files(name) or ()
        if (path := Path(str(file.locate()))).is_file()
    )
    took = [
        [after - before for before, after in zip(_run("pass"), _run(IMPORT), strict=True)]
        for _ in range(rounds)
    ]
    wall_s, cpu_s = zip(*took, strict=True)
    return {
        "mib_on_disk": round(size / 2**20, 1),
        "packages": brought,
        "import_wall_s": spread(wall_s, 2),
        "import_cpu_s": spread(cpu_s, 2),
    }


def _name(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[\s\[(<>=!~;]", requirement, maxsplit=1)[0]).lower()


def _needed(name: str, known: set[str]) -> set[str]:
    """Return a package and all that it needs, and those known already; what is optional is left out."""
    try:
        lines = importlib.metadata.requires(name) or []
    except importlib.metadata.PackageNotFoundError:  # for another platform
        return known
    found = {*known, name}
    for line in lines:
        if "extra ==" not in line and _name(line) not in found:
            found = _needed(_name(line), found)
    return found


def _run(code: str) -> tuple[float, float]:
    """Run Python; return how long it took by the wall, and of CPU."""
    before, begun_ns = resource.getrusage(resource.RUSAGE_CHILDREN), monotonic_ns()
    subprocess.run([sys.executable, "-c", code], check=True)
    took_s, after = (monotonic_ns() - begun_ns) / 1e9, resource.getrusage(resource.RUSAGE_CHILDREN)
    return took_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
