"""Run jobs here, on local processes, or on a Dask cluster: the same results in the same order.

A run that Ctrl-C, an error or a signal ends leaves no process behind. Results can be kept in a file of JSON
lines, from which the next run goes on.
"""

import hashlib
import importlib
import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

from palp_core import palpation
from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.supervision.fork_child import die_with_parent
from palp_core.whole_file import append_whole

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
        checkpoint: "Checkpoint | None" = None,
    ) -> list[R]:
        """Return ``function`` of every job, in the order of the jobs."""
        if self.workers < 1 and not self.dask:
            raise PalpError(f"--workers {self.workers}: at least one process is needed")
        found: dict[int, Any] = {}
        if checkpoint is not None:
            found |= {number: checkpoint[job] for number, job in enumerate(jobs) if job in checkpoint}
        left = {number: job for number, job in enumerate(jobs) if number not in found}
        done: Generator[tuple[int, R]]
        if self.dask:
            done = _on_dask(function, left, self.dask)
        elif self.workers == 1 or len(left) < 2:
            done = ((number, function(job)) for number, job in left.items())
        else:
            done = _on_processes(function, left, self.workers)
        with progress(label, len(jobs), done=len(found)) as advance, closing(done):
            for number, result in done:
                found[number] = result if checkpoint is None else checkpoint.add(jobs[number], result)
                advance()
        return [found[number] for number in range(len(jobs))]


def _run_session(session: Callable[[C, Seed], R], job: tuple[C, Seed]) -> R:
    return session(*job)


def seeds(stream: int, seed: int, count: int) -> Sequence[Seed]:
    """Return the seeds of sessions."""
    return [(stream, seed, number) for number in range(count)]


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


def read_lines(file: Path) -> list[str]:
    """Return the lines of a file, none if there is no such file."""
    return file.read_text(encoding="utf-8", errors="replace").splitlines() if file.exists() else []


@cache
def source_digest() -> str:
    """Return a digest of the source that results come from: changed code never reads an old result."""
    total = hashlib.sha256()
    root = Path(palpation.__file__).parent
    for path in sorted(root.rglob("*.py")):
        total.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


class Checkpoint:
    """Results of jobs in a file of JSON lines, by the job's ``repr`` and the source it was run with."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._found = dict(_known(read_lines(file)))

    def __contains__(self, job: object) -> bool:
        return _key(job) in self._found

    def __len__(self) -> int:
        return len(self._found)

    def __getitem__(self, job: object) -> Any:
        return self._found[_key(job)]

    def add(self, job: object, result: Any) -> Any:
        """Keep a result, and return it as it will be read: plain dicts, lists and numbers."""
        line = json.dumps({"code": source_digest(), "job": _key(job), "result": result})
        self.file.parent.mkdir(parents=True, exist_ok=True)
        append_whole(self.file, f"{line}\n")
        self._found[_key(job)] = json.loads(line)["result"]
        return self[job]


def _key(job: object) -> str:
    return hashlib.sha256(repr(job).encode()).hexdigest()


def _known(lines: Iterable[str]) -> Iterable[tuple[str, Any]]:
    """Give job and result of every line that is whole and of this source."""
    for line in lines:
        try:
            kept = json.loads(line)
            if kept["code"] == source_digest():
                yield kept["job"], kept["result"]
        except (ValueError, KeyError, TypeError):
            continue


@contextmanager
def progress(
    label: str, count: int, *, done: int = 0, now_ns: Callable[[], int] = monotonic_ns
) -> Iterator[Callable[[], None]]:
    """Give what is called whenever one more is done: a bar on a terminal, a line every 20 s in a log."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(label, count, done, now_ns)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=count, completed=done)
        yield lambda: bar.advance(task)


def _lines(label: str, count: int, before: int, now_ns: Callable[[], int]) -> Callable[[], None]:
    start_ns = last_ns = now_ns()
    done = before

    def advance() -> None:
        nonlocal done, last_ns
        done += 1
        here_ns = now_ns()
        if here_ns - last_ns < _EVERY_NS:
            return
        last_ns = here_ns
        left_s = (here_ns - start_ns) / 1e9 * (count - done) / (done - before)
        left = f"{left_s:.0f} s" if left_s < 100.0 else f"{left_s / 60.0:.0f} min"
        sys.stderr.write(f"{label}: {done} of {count} done, about {left} to go\n")
        sys.stderr.flush()

    return advance
