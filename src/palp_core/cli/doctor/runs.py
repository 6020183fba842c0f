"""What earlier runs have left: processes without a supervisor, run directories of runs that are over."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import psutil

from palp_core.cli.doctor.diagnostic import Diagnostic, error, fine, warning
from palp_core.counted import counted
from palp_core.graph.discovery.run_directory import KEEP_ENDED, KEEP_ENDED_BYTES, runs
from palp_core.user_folders import folder_mistake, runtime_folder


def examine_runs() -> Iterator[Diagnostic]:
    """Yield findings about the runs of this user."""
    over = {str(folder): record.graph for folder, record, lives in runs() if not lives}
    orphans = list(_orphans(over))
    yield from orphans
    yield from _foreign()
    if not orphans:
        yield fine("processes", "no orphans: every process of a run has its launcher")
    if over:
        names = ", ".join(sorted(Path(folder).name for folder in over))
        yield fine(
            str(runtime_folder()),
            f"{counted(len(over), 'run directory', 'run directories')} of runs that are over; the "
            f"latest {KEEP_ENDED} are kept: {names} "
            f"({KEEP_ENDED_BYTES >> 20} MiB of logs at most)",
        )


def _foreign() -> Iterator[Diagnostic]:
    """Find what stands among the run directories and may be another user's: no verb looks into it."""
    base = runtime_folder()
    for folder in sorted(base.iterdir()) if base.is_dir() else ():
        with contextlib.suppress(FileNotFoundError):  # a run has just ended
            if mistake := folder_mistake(folder):
                yield warning(str(base), f"{mistake}; it is passed over", "find out who put it there")


def _orphans(over: dict[str, str]) -> Iterator[Diagnostic]:
    """Find living processes that hold a file in the directory of a run that is over."""
    for process in psutil.process_iter(["uids"]) if over else ():
        try:
            if process.pid == os.getpid() or process.info["uids"].real != os.getuid():
                continue
            held = next((folder for folder in _held(process.pid) if folder in over), None)
            if held is None or process.status() == psutil.STATUS_ZOMBIE:
                continue
            name = " ".join(process.cmdline()[:4])
        except (psutil.Error, OSError, TypeError, AttributeError):
            continue
        yield error(
            f"process {process.pid}",
            f"an orphan of graph '{over[held]}' ({held}): its launcher is gone ({name})",
            f"if it is still there in a few seconds: kill {process.pid}",
        )


def _held(pid: int) -> Iterator[str]:
    """Yield the folders, and folders of folders, of the files that a process has open."""
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = Path(str(link.readlink()).removesuffix(" (deleted)"))
        except OSError:
            continue
        if target.is_absolute():
            yield from map(str, (target, *target.parents[:2]))
