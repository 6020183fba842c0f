"""What setting up L4 and solving the joint cost: figures with their limits and peers.

Times are medians of repeats on one core, taken in turns with a peer where there is one: Brent's method
position by position for the joint. Run it on an idle machine.

Run: .venv/bin/python benchmarks/mechanics.py [--quick] [--json]
"""

from __future__ import annotations

import argparse
import functools
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from palp_core.graph.clock import monotonic_ns
from palp_core.palpation.mechanics import (
    Bead,
    Phantom,
    Probe,
    solve,
    sweep,
)
from palp_core.palpation.mechanics.contact.l4 import HarmonicContact
from palp_core.palpation.mechanics.equilibrium.finders import brent
from palp_core.palpation.mechanics.equilibrium.joint import Joint
from palp_core.palpation.mechanics.scene.choice import rung_model
from palp_core.palpation.studies.measures.mechanics import cold_cache

TIP_M = 0.006
NOMINAL_M = 0.004
DEPTHS_M = (0.002, 0.004, 0.008)
RINGS_M = (0.0, 0.004, 0.008, 0.016)
STAGE_M = np.linspace(-0.03, 0.05, 3000)
CORNERS: dict[str, tuple[Phantom, float]] = {
    **{f"d = {d * 1e3:g} mm": (Phantom(bead=Bead(depth_m=d)), TIP_M) for d in DEPTHS_M},
    "slab 60, bead 12, d 0.5, ball 12 mm": (
        Phantom(bead=Bead(depth_m=0.0005, radius_m=0.012), height_m=0.060, poisson=0.4999),
        0.012,
    ),
    "slab 24.5, bead 12, d 0.5, ball 2 mm": (
        Phantom(bead=Bead(depth_m=0.0005, radius_m=0.012), height_m=0.0245, poisson=0.4999),
        0.002,
    ),
    "slab 15, bead 2, d 0.5, ball 12 mm": (
        Phantom(bead=Bead(depth_m=0.0005, radius_m=0.002), height_m=0.015, poisson=0.3),
        0.012,
    ),
    "slab 60, bead 12, d 15, ball 12 mm": (
        Phantom(bead=Bead(depth_m=0.015, radius_m=0.012), height_m=0.060),
        0.012,
    ),
    "slab 60, bead 2, d 15, ball 2 mm": (
        Phantom(bead=Bead(depth_m=0.015, radius_m=0.002), height_m=0.060),
        0.002,
    ),
}


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes:
        name: What it is, with its unit.
        value: Measured.
        limit: What it is held against; None for a peer's own number.
        against: What the limit is.
    """

    name: str
    value: float
    limit: float | None = None
    against: str = "target"

    @property
    def ratio(self) -> float | None:
        """Value over limit; at most 1 is good."""
        return None if self.limit is None else self.value / self.limit


def over(depth_m: float) -> Phantom:
    """Return the default phantom with its bead at a depth."""
    return Phantom(bead=Bead(depth_m=depth_m))


def prepare(phantom: Phantom, tip_m: float) -> None:
    """Set up L4 at its usual cells, or read it from the cache."""
    HarmonicContact(phantom, tip_m).prepare()


def timed_s(action: Callable[[], object]) -> float:
    """Return the seconds that an action takes, once."""
    start_ns = monotonic_ns()
    action()
    return (monotonic_ns() - start_ns) / 1e9


def side_by_side(actions: dict[str, Callable[[], object]], repeats: int = 7) -> dict[str, list[float]]:
    """Return the times of each action, in s, taken in turns so that a busy machine slows all alike."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for action in actions.values():
        action()
    for _ in range(repeats):
        for name, action in actions.items():
            times[name].append(timed_s(action))
    return times


def medians_s(actions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return median times of actions taken in turns."""
    return {name: float(np.median(taken)) for name, taken in side_by_side(actions, repeats).items()}


def setups(quick: bool) -> list[Figure]:
    """Set-up of L4 at 1 mm with nothing cached, and its reading from the cache."""
    figures = []
    for name, (phantom, tip_m) in list(CORNERS.items())[: 3 if quick else None]:
        with cold_cache():
            cold_s = timed_s(functools.partial(prepare, phantom, tip_m))
            warm = side_by_side({"warm": functools.partial(prepare, phantom, tip_m)})["warm"]
        figures.append(Figure(f"L4 set-up, {name}, s", cold_s, 20.0))
        figures.append(Figure(f"L4 from the cache, {name}, ms", 1e3 * float(np.median(warm)), 50.0))
    return figures


def sweeps(quick: bool) -> list[Figure]:
    """The joint's equilibrium at 3000 positions, against Brent's method, and a solved sweep read again."""
    figures, repeats, few = [], 5 if quick else 25, STAGE_M[::30]
    for rung in ("l2", "l4"):
        worst, brent_us, residual, angles = ("", 0.0), [], 0.0, 0.0
        for depth_m in DEPTHS_M:
            model = rung_model(rung, over(depth_m), TIP_M)
            for ring_m in RINGS_M:
                joint = Joint(model, Probe(), ring_m, NOMINAL_M)
                run = functools.partial(sweep, model, Probe(), ring_m, NOMINAL_M, STAGE_M)
                taken = medians_s({"ours": run, "brent": functools.partial(brent, joint, few)}, repeats)
                each_us = 1e6 * taken["ours"] / STAGE_M.size
                brent_us.append(1e6 * taken["brent"] / few.size)
                solved = run()
                residual = max(residual, float(np.abs(joint.residual(STAGE_M, solved.angle_rad)).max()))
                angles = max(angles, float(np.abs(solved.angle_rad[::30] - brent(joint, few)).max()))
                if each_us > worst[1]:
                    worst = f"d = {depth_m * 1e3:g}, ring {ring_m * 1e3:g} mm", each_us
        name = rung.upper()
        figures += [
            Figure(f"equilibrium, {name}, slowest ({worst[0]}), us a position", worst[1], 1.0),
            Figure(f"the same against Brent, {name}, us a position", worst[1], max(brent_us), "Brent"),
            Figure(f"a sweep of 3000 positions, {name}, ms", 3.0 * worst[1], 5.0),
            Figure(f"largest residual, {name}, N m", residual, 1e-15, "round-off"),
            Figure(f"largest difference from Brent, {name}, rad", angles, 1e-12, "Brent"),
        ]
    table = solve(rung_model("l4", over(0.004), TIP_M), Probe(), 0.008, NOMINAL_M, -0.03, 0.05)
    read = side_by_side({"read": lambda: table.torque_n_m(STAGE_M)}, 4 * repeats)["read"]
    return [*figures, Figure("3000 positions of a solved sweep, ms", 1e3 * float(np.median(read)), 5.0)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats, the paper's depths only")
    parser.add_argument("--json", action="store_true", help="a list for machines")
    options = parser.parse_args()
    figures = [*setups(options.quick), *sweeps(options.quick)]
    if options.json:
        print(json.dumps([asdict(one) | {"ratio": one.ratio} for one in figures]))
        return
    for one in figures:
        bar = "" if one.limit is None else f"{one.ratio:8.2g} of {one.limit:.3g} ({one.against})"
        print(f"{one.name:<72} {one.value:10.3g} {bar}")


if __name__ == "__main__":
    main()
