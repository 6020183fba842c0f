"""How fast palp's wires are beside raw pyzmq and other graph systems, in interleaved rounds.

palp is the real thing: nodes in processes of their own, started by ``palp launch``, with accounts, heartbeats
and order records. All contenders carry the same array, stamp it just before the publish call and again when
the reader holds a numpy array, on the host's monotonic clock. A ratio is palp over one contender within one
round, the order turned from round to round; stated are the median over rounds, the least and the largest.
CPU time is user and system time of all ends per message published. The machine should be otherwise idle.

``raw`` is one frame without a topic, and no socket has a receive timeout; ``raw_timeout`` is the same where
each socket that reads has one, as a node needs it that must look at its clock, too. Both are measured unless
``--without`` leaves one out; ``--peer`` adds others, each from the package index in a virtual environment of
its own. One that cannot be installed, or that fails, is left out by name, with the reason.

Run: .venv/bin/python benchmarks/wires.py [--quick] [--json] [--only latency] [--out DIR]
     .venv/bin/python benchmarks/wires.py --peer all      beside raw_three, zenoh, ros2, ezmsg and iceoryx2
     .venv/bin/python benchmarks/wires.py --peer ros2     beside ROS 2, installed from PyPI (Python 3.11)
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rich.console import Console
from wire_bench.contenders import first_message_s
from wire_bench.figures import Measure, Results, write_csv
from wire_bench.peers import DEFAULT, PALP, PEERS, Contenders, contenders, versions
from wire_bench.plan import Phase

QUICK_S = 34.0  # of 40; starting, ending and a run that takes longer than the one before have the rest
ALONE = (("latency",), ("64k",), ("trip", "call"), ("rate",), ("1mib",))
TOGETHER = (("latency", "64k", "trip", "call"), ("rate", "1mib"))
KINDS = (*(kind for kinds in ALONE for kind in kinds), "fan", "startup")
OF_PALP = ("call",)  # others have nothing of the kind
CACHE = Path.home() / ".cache" / "palp-peers"


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


def say(text: str) -> None:
    """Show progress."""
    print(text, file=sys.stderr, flush=True)


def run(name: str, found: Contenders, chosen: list[Measure], readers: int, results: Results) -> None:
    """Let one contender do what is measured, and enter it.

    Raises:
        RuntimeError: palp or raw pyzmq failed. Another that fails is left out from here on.
    """
    mine = [entry for entry in chosen if name == PALP or entry.name not in OF_PALP]
    if not mine:
        return
    try:
        results.add(name, mine, found.runners[name]([entry.phase for entry in mine], readers))
    except RuntimeError as error:
        if name == PALP or not PEERS[name].packages:
            raise
        say(f"{name} is left out: {error}")
        found.left_out[name] = str(error)
        del found.runners[name]
        results.drop(name)


def measure(only: set[str], rounds: int, quick: bool, found: Contenders, budget_s: float) -> Results:
    """Run all rounds, each contender beside the others, the order turned from round to round.

    The first round is whole; of the later ones, a run that would not end within ``budget_s`` is left out.
    """
    results, took_s = Results(), dict[str, float]()
    begin_s = time.monotonic()

    def fits(what: str) -> bool:
        return time.monotonic() - begin_s + took_s.get(what, 0.0) <= budget_s

    for number in range(rounds):
        for readers, chosen in bundles(only, quick):
            what = ", ".join(entry.name for entry in chosen)
            if number and not fits(what):
                continue
            started_s = time.monotonic()
            for name in list(found.runners) if number % 2 == 0 else list(reversed(found.runners)):
                say(f"round {number + 1}/{rounds}: {name}: {what}")
                run(name, found, chosen, readers, results)
            took_s[what] = time.monotonic() - started_s
        if "startup" in only and (number == 0 or fits("startup")):
            took_s["startup"] = first_message_s()
            results.startup_s.append(took_s["startup"])
            say(f"round {number + 1}/{rounds}: ten nodes in {took_s['startup']:.2f} s")
    return results


def write(out: Path, name: str, found: dict[str, Any]) -> None:
    """Write an object as JSON."""
    (out / f"{name}.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="within 40 s")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    parser.add_argument("--only", action="append", choices=KINDS, help="measure only this; may be repeated")
    parser.add_argument("--rounds", type=int, help="interleaved rounds (up to 3 if quick, else 7)")
    parser.add_argument("--out", type=Path, help="write CSV and JSON to this folder")
    parser.add_argument(
        "--peer",
        action="append",
        default=[],
        choices=(*PEERS, "all"),
        help="measure this contender, too, or all; may be repeated",
    )
    parser.add_argument(
        "--without", action="append", default=[], choices=tuple(PEERS), help="not this one; may be repeated"
    )
    parser.add_argument(
        "--cache",
        type=Path,
        default=CACHE,
        help="folder of the contenders' virtual environments, made if they are not there (%(default)s)",
    )
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no contender is left behind
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    chosen = PEERS if "all" in options.peer else (*DEFAULT, *options.peer)
    who = contenders((name for name in chosen if name not in options.without), options.cache, say)
    rounds = options.rounds or (3 if options.quick else 7)
    budget_s = QUICK_S if options.quick and not options.rounds else math.inf
    results = measure(set(options.only or KINDS), rounds, options.quick, who, budget_s)
    found = results.summary()
    found["contenders"] = {name: PEERS[name].about for name in who.runners if name != PALP}
    found["versions"] = versions(who.runners, options.cache)
    found["left_out"] = who.left_out
    if options.out is not None:
        write_csv(results, options.out / "wires.csv")
        write(options.out, "wires", found)
    if options.json:
        print(json.dumps(found))
    else:
        from wire_bench.tables import show_wires

        show_wires(Console(), results, found)


if __name__ == "__main__":
    main()
