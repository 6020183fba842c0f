"""Run jobs here, on local processes, or on a Dask cluster: the same results in the same order.

On a terminal a bar shows how many are done.
"""

from __future__ import annotations

import importlib
import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from palp_core.errors import PalpError

__all__ = ["spread"]

J = TypeVar("J")
R = TypeVar("R")


def spread(
    function: Callable[[J], R], jobs: Sequence[J], *, workers: int = 1, dask: str = "", label: str = ""
) -> list[R]:
    """Return ``function`` of every job, in the order of the jobs.

    A job carries its own seed, so it does not matter where or in which order it runs.

    Args:
        function: Of a module's top level.
        jobs: What to run it on; they must pickle.
        workers: Local processes; 1 runs here.
        dask: Address of a Dask scheduler, as ``tcp://host:8786``; empty for local work.
        label: What the bar says; empty for none.

    Raises:
        PalpError: ``workers`` is less than 1, Dask is not installed, or its scheduler does not answer.
    """
    with _bar(label, len(jobs)) as shown:
        if dask:
            return _on_dask(function, jobs, dask, shown)
        if workers < 1:
            raise PalpError(f"--workers {workers}: at least one process is needed")
        if workers == 1 or len(jobs) < 2:
            return list(shown(function(job) for job in jobs))
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            return list(shown(pool.map(function, jobs, chunksize=max(1, len(jobs) // (8 * workers)))))


@contextmanager
def _bar(label: str, count: int) -> Iterator[Callable[[Iterable[R]], Iterable[R]]]:
    """Give what passes things through and moves a bar on standard error; no bar where nobody looks."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    hidden = not label or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        task = progress.add_task(label, total=count)

        def shown(things: Iterable[R]) -> Iterable[R]:
            for thing in things:
                progress.advance(task)
                yield thing

        yield shown


def _on_dask(
    function: Callable[[J], R],
    jobs: Sequence[J],
    address: str,
    shown: Callable[[Iterable[Any]], Iterable[Any]],
) -> list[R]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise PalpError(
            "--dask needs the package 'distributed', which is not installed; run: pip install 'palp[dask]'"
        ) from error
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise PalpError(f"--dask {address}: no scheduler answers there ({error}); start one first") from error
    with client:
        futures = client.map(function, list(jobs), pure=False)
        for _ in shown(distributed.as_completed(futures)):
            pass  # moves the bar
        return list(client.gather(futures))
