"""How soon ``palp view`` shows a sample, and how soon its stop arrives.

Each viewer has a page of Chromium. Browsers get what time the host has left, as if they were on another one;
with ``--beside`` they have the graph's own priority. Each number is a median over rounds, with the least and
the largest. The machine should be otherwise idle.

Run: .venv/bin/python -m benchmarks.view [WHAT ...] [--quick] [--rounds N] [--beside] [--json]

screen: from sample to screen, and frames a second, the emulated rig at work. stop, stop-loaded: from a click
to ABORT on the wire; loaded: while swaps and page loads run.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Callable
from typing import Any

from benchmarks.rig_bench.host import host_words
from benchmarks.view_bench import screen, stop

Measure = Callable[[argparse.Namespace], dict[str, Any]]


def measures() -> dict[str, Measure]:
    """Return what can be measured, by its word."""
    return {
        "screen": lambda o: screen.to_screen(o.window, o.rounds, beside=o.beside),
        "stop": lambda o: stop.stops(o.clicks, loaded=False, beside=o.beside),
        "stop-loaded": lambda o: stop.stops(o.clicks, loaded=True, beside=o.beside),
    }


def main() -> None:
    """Measure and print."""
    known = measures()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="*", metavar="WHAT", help=f"{', '.join(known)}; default: all")
    parser.add_argument("--quick", action="store_true", help="a round or two of a few seconds")
    parser.add_argument("--rounds", type=int, help="5; quick: 2")
    parser.add_argument("--window", type=float, help="seconds of each measurement; 20, quick: 4")
    parser.add_argument("--clicks", type=int, help="on stop; 200, quick: 5")
    parser.add_argument("--beside", action="store_true", help="browsers with the graph's own priority")
    parser.add_argument("--json", action="store_true", help="one object for machines")
    options = parser.parse_args()
    if unknown := set(options.what) - known.keys():
        parser.error(f"there is no {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nothing is left behind
    small = {"rounds": 2, "window": 4.0, "clicks": 5}
    whole = {"rounds": 5, "window": 20.0, "clicks": 200}
    for name, value in (small if options.quick else whole).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    found: dict[str, Any] = {"host": host_words(), "browsers": "beside" if options.beside else "in idle time"}
    for name in options.what or known:
        print(f"{name} ...", file=sys.stderr, flush=True)
        found[name] = known[name](options)
        if not options.json:
            print(f"{name}: {json.dumps(found[name])}", flush=True)
    if options.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
