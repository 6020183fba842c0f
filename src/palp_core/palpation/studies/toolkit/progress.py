"""How far long work has come, on standard error: a bar on a terminal, a line now and then in a log."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from palp_core.graph.clock import monotonic_ns

T = TypeVar("T")

EVERY_NS = 20_000_000_000


@contextmanager
def progress(
    label: str, count: int, *, done: int = 0, now_ns: Callable[[], int] = monotonic_ns
) -> Iterator[Callable[[], None]]:
    """Give what is called whenever one more is done.

    Where nobody watches, a line is written at most every 20 s, and none for work that takes less.

    Args:
        label: What there is so many of, as ``cells``.
        count: How many.
        done: How many of them are done before it begins.
        now_ns: Clock, in ns.
    """
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


def followed(label: str, things: Sequence[T]) -> Iterator[T]:
    """Give things one by one, and tell how many are done; the work on one is what is done until the next."""
    with progress(label, len(things)) as advance:
        for thing in things:
            yield thing
            advance()


def _lines(label: str, count: int, before: int, now_ns: Callable[[], int]) -> Callable[[], None]:
    start_ns = last_ns = now_ns()
    done = before

    def advance() -> None:
        nonlocal done, last_ns
        done += 1
        here_ns = now_ns()
        if here_ns - last_ns < EVERY_NS:
            return
        last_ns = here_ns
        left_s = (here_ns - start_ns) / 1e9 * (count - done) / (done - before)
        sys.stderr.write(f"{label}: {done} of {count} done, about {_duration(left_s)} to go\n")
        sys.stderr.flush()

    return advance


def _duration(time_s: float) -> str:
    return f"{time_s:.0f} s" if time_s < 100.0 else f"{time_s / 60.0:.0f} min"
