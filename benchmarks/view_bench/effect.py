"""What viewers cost a graph: one run in which they come and go, window by window, by turns."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.view_bench.running import (
    Launched,
    browser,
    browsers_cpu_s,
    cpu_s,
    emulated,
    end,
    simulated,
    spread,
    two_viewers,
    wait,
)
from palp_core.graph.clock import monotonic_ns

TORQUE = "/torque/block"
READER = "estimator"
WHO = ("graph", "viewers", "browsers")
STRANGER = """
import os, sys, time
if sys.argv[2] == "idle":
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while True:
    end = time.monotonic() + 0.1 * float(sys.argv[1])
    while time.monotonic() < end:
        sum(range(2000))
    time.sleep(0.1 * (1 - float(sys.argv[1])))
"""
"""Computes for a share of a core, and knows nothing of any graph."""


def speed(rounds: int, window_s: float, *, compose: bool, beside: bool) -> dict[str, Any]:
    """Return how many blocks of torque, which come in sweeps only, a wall second has, viewed over alone.

    And over that alone, too, beside a stranger that computes for as long as viewers and browsers did: what
    the cores are short of, whoever takes it.

    Args:
        rounds: Of three windows each.
        window_s: Wall seconds of one.
        compose: The graph in one process.
        beside: The browsers have the priority of the graph.
    """
    with simulated(compose=compose) as run:
        alone, viewed, stranger = _by_turns(
            run, rounds, lambda viewers: _window(run, window_s, viewers), beside
        )
        edge = run.edge(READER, TORQUE)
    both = list(zip(viewed, alone, strict=True))
    return {
        "ratio": spread([one["blocks"] / other["blocks"] for one, other in both]),
        "ratio_beside_a_stranger": spread(
            [one["blocks"] / other["blocks"] for one, other in zip(stranger, alone, strict=True)]
        ),
        "blocks_per_wall_s_alone": spread([one["blocks"] for one in alone], 1),
        "blocks_per_wall_s_viewed": spread([one["blocks"] for one in viewed], 1),
        "graph_cpu_s_per_block_ratio": spread(
            [one["graph"] / one["blocks"] / (other["graph"] / other["blocks"]) for one, other in both]
        ),
        **{f"{who}_cpu_percent": spread([100 * row[who] for row in viewed], 1) for who in WHO},
        "lost": int(edge["lost"]),
    }


Rows = list[dict[str, float]]


def _by_turns(
    run: Launched, rounds: int, look: Callable[[list[int]], dict[str, float]], beside: bool
) -> tuple[Rows, Rows, Rows]:
    """Return what is seen alone, viewed, and beside a stranger, window by window.

    Args:
        run: The graph.
        rounds: Of three windows each.
        look: Measures a window, given the viewers' processes; ``share`` is what viewers and browsers took.
        beside: As of :func:`speed`.
    """
    found: dict[bool, Rows] = {False: [], True: []}
    stranger: Rows = []
    with tempfile.TemporaryDirectory() as name, browser(Path(name), beside=beside) as chrome:
        for number in range(rounds):
            for viewed in (False, True) if number % 2 == 0 else (True, False):
                if viewed:
                    with two_viewers(run, chrome) as viewers:
                        found[viewed].append(look([one.process.pid for one in viewers]))
                else:
                    found[viewed].append(look([]))
            with _stranger(found[True][-1]["share"], idle=not beside):
                stranger.append(look([]))
    return found[False], found[True], stranger


@contextmanager
def _stranger(share: float, *, idle: bool) -> Iterator[None]:
    words = [str(min(share, 1.0)), "idle" if idle else "beside"]
    process = subprocess.Popen([sys.executable, "-c", STRANGER, *words], stdout=subprocess.PIPE, text=True)
    try:
        yield
    finally:
        end(process)


def _window(run: Launched, window_s: float, viewers: list[int]) -> dict[str, float]:
    """Return blocks of torque, and CPU seconds of graph, viewers and browsers, each of a wall second."""

    def now() -> dict[str, float]:
        used = (cpu_s(run.process.pid), sum(cpu_s(pid) for pid in viewers), browsers_cpu_s())
        return {"blocks": run.published(TORQUE), **dict(zip(WHO, used, strict=True))}

    before, begun_ns = now(), monotonic_ns()
    wait(window_s)
    after, ended_ns = now(), monotonic_ns()
    found = {name: (after[name] - before[name]) * 1e9 / (ended_ns - begun_ns) for name in before}
    return {**found, "share": found["viewers"] + found["browsers"]}


def latency(rounds: int, window_s: float, *, beside: bool) -> dict[str, Any]:
    """Return p50 and p99 of the torque edge on the machine's clock, viewed over alone, and what was lost.

    And beside a stranger over alone, as of :func:`speed`.
    """
    with emulated() as run:
        alone, viewed, stranger = _by_turns(
            run, rounds, lambda viewers: _latency_ms(run, window_s, viewers), beside
        )
        lost = int(run.edge(READER, TORQUE)["lost"])

    def over_alone(rows: list[dict[str, float]], p: str) -> dict[str, Any]:
        return spread([row[p] / other[p] for row, other in zip(rows, alone, strict=True)])

    return {
        "lost": lost,
        **{f"{p}_ratio": over_alone(viewed, p) for p in ("p50", "p99")},
        **{f"{p}_ratio_beside_a_stranger": over_alone(stranger, p) for p in ("p50", "p99")},
        **{f"{p}_ms_alone": spread([row[p] for row in alone]) for p in ("p50", "p99")},
        **{f"{p}_ms_viewed": spread([row[p] for row in viewed]) for p in ("p50", "p99")},
        "viewers_and_browsers_cpu_percent": spread([100 * row["share"] for row in viewed], 1),
    }


def _latency_ms(run: Launched, window_s: float, viewers: list[int]) -> dict[str, float]:
    """Return p50 and p99 in ms, and the share of a core that viewers and browsers took."""

    def used_s() -> float:
        return sum(cpu_s(pid) for pid in viewers) + (browsers_cpu_s() if viewers else 0.0)

    before, before_s, begun_ns = int(run.edge(READER, TORQUE)["received"]), used_s(), monotonic_ns()
    wait(window_s)
    share = (used_s() - before_s) * 1e9 / (monotonic_ns() - begun_ns)
    count = int(run.edge(READER, TORQUE)["received"]) - before
    recent = run.edge(READER, TORQUE, window=max(count, 1))["recent_latency_s"]
    return {"share": share, **{name: 1e3 * float(recent[name]) for name in ("p50", "p99")}}
