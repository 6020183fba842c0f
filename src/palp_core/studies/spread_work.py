"""Run jobs here, on local processes, or on a Dask cluster: the same results in the same order."""

from __future__ import annotations

import importlib
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from palp_core.errors import PalpError

__all__ = ["spread"]

J = TypeVar("J")
R = TypeVar("R")


def spread(function: Callable[[J], R], jobs: Sequence[J], *, workers: int = 1, dask: str = "") -> list[R]:
    """Return ``function`` of every job, in the order of the jobs.

    A job carries its own seed, so it does not matter where or in which order it runs.

    Args:
        function: Of a module's top level.
        jobs: What to run it on; they must pickle.
        workers: Local processes; 1 runs here.
        dask: Address of a Dask scheduler, as ``tcp://host:8786``; empty for local work.

    Raises:
        PalpError: ``workers`` is less than 1, Dask is not installed, or its scheduler does not answer.
    """
    if dask:
        return _on_dask(function, jobs, dask)
    if workers < 1:
        raise PalpError(f"--workers {workers}: at least one process is needed")
    if workers == 1 or len(jobs) < 2:
        return [function(job) for job in jobs]
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(function, jobs, chunksize=max(1, len(jobs) // (8 * workers))))


def _on_dask(function: Callable[[J], R], jobs: Sequence[J], address: str) -> list[R]:
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
        return list(client.gather(futures))
