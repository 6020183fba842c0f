"""Hold a pendulum, and let another controller take over after four seconds: python swap.py [FOLDER]."""

import sys
from pathlib import Path

from palp_core import Graph

HERE = Path(__file__).parent

if __name__ == "__main__":
    out = sys.argv[1] if len(sys.argv) > 1 else "pendulum"
    with Graph(HERE / "launch" / "pendulum.yaml", compose=True, out=out) as graph:
        graph.plan_swap(4.0, "controller", "nodes.controller:GravityCompensated")
        summary = graph.run()
    print(f"{summary.clock_s:.0f} s in {summary.wall_s:.1f} s; {out}/pendulum.csv, {out}/pendulum.png")
