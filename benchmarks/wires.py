"""How fast palp's wires are compared with raw pyzmq, in interleaved rounds.

palp is the real thing: nodes in processes of their own, started by ``palp launch``, with accounts, heartbeats
and order records. ``raw`` is pyzmq and msgpack, one frame without a topic. Both carry the same array, stamp
it just before the publish call and again when the reader holds a numpy array, on the host's monotonic clock.
A ratio is palp over the other within one round, the order turned from round to round; stated are the median
over rounds, the least and the largest. CPU time is user and system time of all ends per message published.
The machine should be otherwise idle. ``--peer ros2`` adds ROS 2 (rclpy over Fast DDS), of the extra
``ros2``.

Run: .venv/bin/python benchmarks/wires.py [--quick] [--json] [--only latency] [--peer ros2]
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Iterable
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from wire_bench.contenders import HERE, Outcome, first_message_s, run_palp, run_scripts
from wire_bench.figures import PALP, Measure, Results
from wire_bench.plan import Phase

ALONE = (("latency",), ("64k",), ("trip", "call"), ("rate",), ("1mib",))
TOGETHER = (("latency", "64k", "trip", "call"), ("rate", "1mib"))
KINDS = (*(kind for kinds in ALONE for kind in kinds), "fan", "startup")
OF_PALP = ("call",)  # the peers have no services
PEERS = ("raw", "ros2")
"""Scripts of both ends in ``wire_bench``."""
Runner = Callable[[list[Phase], int], Outcome]


def runners(peers: Iterable[str]) -> dict[str, Runner]:
    """Return palp and peers, by name."""
    return {PALP: run_palp} | {name: partial(run_scripts, HERE / f"{name}.py") for name in peers}


def measures(quick: bool) -> dict[str, Measure]:
    """Return what can be measured over an edge."""
    fine = 1.06 if quick else 1.03
    trip_s, stage_s = (0.3, 0.1) if quick else (2.0, 0.4)
    return {
        "latency": Measure("latency", Phase("stream", 48, 1000.0, 1.0 if quick else 5.0)),
        "64k": Measure("64k", Phase("stream", 1 << 16, 100.0, 0.7 if quick else 5.0)),
        "trip": Measure("trip", Phase("echo", 48, 1000.0, trip_s)),
        "call": Measure("call", Phase("call", 48, 1000.0, trip_s)),
        "rate": Measure("rate", Phase("search", 48, 16000.0, stage_s, resolution=fine)),
        "1mib": Measure("1mib", Phase("search", 1 << 20, 400.0, stage_s, 512, fine)),
        "fan": Measure("fan", Phase("stream", 48, 1000.0, 0.7 if quick else 5.0)),
    }


def bundles(only: set[str], quick: bool) -> list[tuple[int, list[Measure]]]:
    """Return (readers, measures) of each run of a round; the quick form puts several into one."""
    found = measures(quick)
    together = TOGETHER if quick else ALONE
    runs = [(1, [found[kind] for kind in kinds if kind in only]) for kinds in together]
    runs.append((5, [found["fan"]] if "fan" in only else []))
    return [(readers, chosen) for readers, chosen in runs if chosen]


def measure(only: set[str], rounds: int, quick: bool, run_by_name: dict[str, Runner]) -> Results:
    """Run all rounds, the order of the contenders turned from round to round."""
    results = Results()
    for number in range(rounds):
        for readers, chosen in bundles(only, quick):
            for name in list(run_by_name) if number % 2 == 0 else reversed(run_by_name):
                mine = [entry for entry in chosen if name == PALP or entry.name not in OF_PALP]
                if mine:
                    report(f"round {number + 1}/{rounds}: {name}: {', '.join(e.name for e in mine)}")
                    results.add(name, mine, run_by_name[name]([entry.phase for entry in mine], readers))
        if "startup" in only:
            results.startup_s.append(first_message_s())
            report(f"round {number + 1}/{rounds}: ten nodes in {results.startup_s[-1]:.2f} s")
    return results


def report(text: str) -> None:
    """Show progress."""
    print(text, file=sys.stderr, flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="short runs, two rounds: some 40 s")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    parser.add_argument("--only", action="append", choices=KINDS, help="measure only this; may be repeated")
    parser.add_argument("--rounds", type=int, help="interleaved rounds (2 if quick, else 7)")
    parser.add_argument("--peer", action="append", default=["raw"], choices=PEERS, help="measure this, too")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no contender is left behind
    rounds = options.rounds or (2 if options.quick else 7)
    results = measure(set(options.only or KINDS), rounds, options.quick, runners(options.peer))
    print(json.dumps(results.summary()) if options.json else results.table())


if __name__ == "__main__":
    main()
