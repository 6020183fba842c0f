"""Run jobs here, on local processes, or on a Dask cluster: the same results in the same order.

What is stopped half way, by Ctrl-C, an error or a signal, leaves no process behind; what was done by then can
be kept for the next run.
"""

import importlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.graph.supervision.fork_child import die_with_parent
from palp_core.palpation.studies.toolkit.checkpoint import Checkpoint
from palp_core.palpation.studies.toolkit.progress import progress

C = TypeVar("C")
J = TypeVar("J")
R = TypeVar("R")


Seed = tuple[int, ...]


@dataclass(frozen=True)
class Runner:
    """Runs sessions of cases; results depend on the seed alone, not on where they are run.

    Attributes:
        seed: Of everything.
        workers: Local processes.
        dask: Address of a Dask scheduler instead.
    """

    seed: int = 1
    workers: int = 1
    dask: str = ""

    def run(
        self, session: Callable[[C, Seed], R], cases: Sequence[C], count: int, *, stream: int, label: str
    ) -> list[list[R]]:
        """Return what each session of each case gives; those of one number have one seed in all cases.

        Args:
            session: Of a module's top level, or a partial of one; called with a case and a seed.
            cases: What to run it on; they must pickle.
            count: Sessions of each case.
            stream: First number of the seeds; sessions of another stream share no luck.
            label: What the sessions are: how many are done is shown on standard error.
        """
        jobs = [(case, seed) for case in cases for seed in seeds(stream, self.seed, count)]
        found = self.run_jobs(partial(_run_session, session), jobs, label=label)
        return [found[number * count : (number + 1) * count] for number in range(len(cases))]

    def run_jobs(
        self,
        function: Callable[[J], R],
        jobs: Sequence[J],
        *,
        label: str,
        checkpoint: Checkpoint | None = None,
    ) -> list[R]:
        """Return ``function`` of every job, as :func:`run_jobs` does."""
        return run_jobs(
            function, jobs, label=label, workers=self.workers, dask=self.dask, checkpoint=checkpoint
        )


def _run_session(session: Callable[[C, Seed], R], job: tuple[C, Seed]) -> R:
    return session(*job)


def run_jobs(
    function: Callable[[J], R],
    jobs: Sequence[J],
    *,
    label: str,
    workers: int = 1,
    dask: str = "",
    checkpoint: Checkpoint | None = None,
) -> list[R]:
    """Return ``function`` of every job, in the order of the jobs.

    A job carries its own seed, so it does not matter where or in which order it runs.

    Args:
        function: Of a module's top level.
        jobs: What to run it on; they must pickle.
        label: What the jobs are, as ``cells``: how many are done is told on standard error.
        workers: Local processes; 1 runs here.
        dask: Address of a Dask scheduler, as ``tcp://host:8786``; empty for local work.
        checkpoint: Results of an earlier run, which are not worked out again; gets each new one at once.
    """
    if workers < 1 and not dask:
        raise PalpError(f"--workers {workers}: at least one process is needed")
    found: dict[int, Any] = {}
    if checkpoint is not None:
        found |= {number: checkpoint[job] for number, job in enumerate(jobs) if job in checkpoint}
    left = {number: job for number, job in enumerate(jobs) if number not in found}
    done: Generator[tuple[int, R]]
    if dask:
        done = _on_dask(function, left, dask)
    elif workers == 1 or len(left) < 2:
        done = ((number, function(job)) for number, job in left.items())
    else:
        done = _on_processes(function, left, workers)
    with progress(label, len(jobs), done=len(found)) as advance, closing(done):
        for number, result in done:
            found[number] = result if checkpoint is None else checkpoint.add(jobs[number], result)
            advance()
    return [found[number] for number in range(len(jobs))]


def seeds(study: int, seed: int, count: int) -> Sequence[Seed]:
    """Return the seeds of a study's sessions."""
    return [(study, seed, number) for number in range(count)]


def _on_processes(
    function: Callable[[J], R], jobs: Mapping[int, J], workers: int
) -> Generator[tuple[int, R]]:
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
            numbers = {pool.submit(function, job): number for number, job in jobs.items()}
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


def _on_dask(function: Callable[[J], R], jobs: Mapping[int, J], address: str) -> Generator[tuple[int, R]]:
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
        futures = client.map(function, list(jobs.values()), pure=False)
        numbers = {future.key: number for future, number in zip(futures, jobs, strict=True)}
        for future, result in distributed.as_completed(futures, with_results=True):
            yield numbers[future.key], result
