"""Run jobs here, on local processes, or on a Dask cluster: the same results in the same order.

A run that Ctrl-C, an error or a signal ends leaves no process behind.
"""

import importlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.supervision.fork_child import die_with_parent

C = TypeVar("C")
J = TypeVar("J")
R = TypeVar("R")
Seed = tuple[int, ...]

_EVERY_NS = 20_000_000_000


@dataclass(frozen=True)
class Runner:
    """Where sessions are run; results depend on the seed alone."""

    seed: int = 1  # of everything
    workers: int = 1  # local processes
    dask: str = ""  # address of a Dask scheduler instead

    def run(
        self, session: Callable[[C, Seed], R], cases: Sequence[C], count: int, *, stream: int, label: str
    ) -> list[list[R]]:
        """Return the results of every session of each case; sessions of one number share their seed."""
        jobs = [(case, seed) for case in cases for seed in seeds(stream, self.seed, count)]
        found = self.run_jobs(partial(_run_session, session), jobs, label=label)
        return [found[number * count : (number + 1) * count] for number in range(len(cases))]

    def run_jobs(
        self,
        function: Callable[[J], R],
        jobs: Sequence[J],
        *,
        label: str,
    ) -> list[R]:
        """Return ``function`` of every job, in the order of the jobs."""
        if self.workers < 1 and not self.dask:
            raise PalpError(f"--workers {self.workers}: at least one process is needed")
        found: dict[int, R] = {}
        done: Generator[tuple[int, R]]
        if self.dask:
            done = _on_dask(function, jobs, self.dask)
        elif self.workers == 1 or len(jobs) < 2:
            done = ((number, function(job)) for number, job in enumerate(jobs))
        else:
            done = _on_processes(function, jobs, self.workers)
        with progress(label, len(jobs)) as advance, closing(done):
            for number, result in done:
                found[number] = result
                advance()
        return [found[number] for number in range(len(jobs))]


def _run_session(session: Callable[[C, Seed], R], job: tuple[C, Seed]) -> R:
    return session(*job)


def seeds(stream: int, seed: int, count: int) -> Sequence[Seed]:
    """Return the seeds of sessions."""
    return [(stream, seed, number) for number in range(count)]


def _on_processes(function: Callable[[J], R], jobs: Sequence[J], workers: int) -> Generator[tuple[int, R]]:
    """Give results as they come; whatever ends it early ends the workers at once."""
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        min(workers, len(jobs)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=die_with_parent,
        initargs=(os.getpid(),),
    )
    try:
        with _children_without_ctrl_c():
            numbers = {pool.submit(function, job): number for number, job in enumerate(jobs)}
        for future in as_completed(numbers):
            yield numbers[future], future.result()
        pool.shutdown()
    except BaseException as error:
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        pool.shutdown(cancel_futures=True)
        if isinstance(error, BrokenProcessPool):
            raise PalpError(
                "a worker process died; was it killed, or is memory short? Try fewer --workers"
            ) from error
        raise


@contextmanager
def _children_without_ctrl_c() -> Iterator[None]:
    """Let processes started meanwhile never see Ctrl-C, which a terminal sends to all of a group.

    A signal that is blocked when a process starts stays so, from its first instruction on.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_dask(function: Callable[[J], R], jobs: Sequence[J], address: str) -> Generator[tuple[int, R]]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise PalpError(
            f"--dask needs the package 'distributed', which is not installed; run: {install_line('dask')}"
        ) from error
    try:
        client = distributed.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise PalpError(f"--dask {address}: no scheduler answers there ({error}); start one first") from error
    with client:
        futures = client.map(function, list(jobs), pure=False)
        numbers = {future.key: number for number, future in enumerate(futures)}
        for future, result in distributed.as_completed(futures, with_results=True):
            yield numbers[future.key], result


@contextmanager
def progress(
    label: str, count: int, *, now_ns: Callable[[], int] = monotonic_ns
) -> Iterator[Callable[[], None]]:
    """Give what is called whenever one more is done: a bar on a terminal, a line every 20 s in a log."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(label, count, now_ns)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=count)
        yield lambda: bar.advance(task)


def _lines(label: str, count: int, now_ns: Callable[[], int]) -> Callable[[], None]:
    start_ns = last_ns = now_ns()
    done = 0

    def advance() -> None:
        nonlocal done, last_ns
        done += 1
        here_ns = now_ns()
        if here_ns - last_ns < _EVERY_NS:
            return
        last_ns = here_ns
        left_s = (here_ns - start_ns) / 1e9 * (count - done) / done
        left = f"{left_s:.0f} s" if left_s < 100.0 else f"{left_s / 60.0:.0f} min"
        sys.stderr.write(f"{label}: {done} of {count} done, about {left} to go\n")
        sys.stderr.flush()

    return advance
