"""Probe, ring, stage and phantom to scale: lengths for the drawing, and how the tip leans."""

from __future__ import annotations

import math
from typing import Any

from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import StagePath

LIFT_M = 0.020


def lengths_mm(from_m: float, to_m: float, lift_m: float = LIFT_M) -> dict[str, float]:
    """Return what the drawing needs, in mm; gel and probe as published, indentation as assumed."""
    probe, path, phantom = Probe(), StagePath(), Phantom()
    return {
        "base": 1e3 * probe.base_m,
        "tip": 1e3 * probe.tip_m,
        "ball": 1e3 * probe.tip_radius_m,
        "pivot": 1e3 * probe.pivot_radius_m,
        "slab": 1e3 * phantom.height_m,
        "bead": 1e3 * Bead(depth_m=0.002).radius_m,
        "indentation": 1e3 * path.indentation_m,
        "from": 1e3 * from_m,
        "to": 1e3 * to_m,
        "lift": 1e3 * lift_m,
    }


def lean_rad(torque_n_m: float, ring_m: float, probe: Probe | None = None) -> float:
    """Return the angle of the tip link at rest by the torque at the sensor: the joint bears its share of it.

    The ball cannot lean further than to where it leaves the gel.
    """
    probe = probe or Probe()
    farthest = math.acos(1.0 - StagePath().indentation_m / probe.lever_m)
    share = probe.lever_m / (probe.base_m + probe.lever_m)
    holds_n_m = probe.spring_n_m(ring_m) + probe.weight_n_m
    sine = torque_n_m * share / holds_n_m if holds_n_m > 0.0 else math.copysign(1.0, torque_n_m)
    return max(-farthest, min(farthest, math.asin(max(-1.0, min(1.0, sine)))))


def parameters_of(launch: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters of a launched graph's nodes; of one that several have, the first node's."""
    found: dict[str, Any] = {}
    for params in launch.get("params", {}).values():
        found = params | found
    return found


def path_of(launch: dict[str, Any]) -> tuple[float, float]:
    """Return where sweeps begin and end, by the launch file; the published path where it does not say."""
    path, given = StagePath(), parameters_of(launch)
    found = []
    for name, usual in (("from_m", path.from_m), ("to_m", path.to_m)):
        value = given.get(name, usual)
        found.append(float(value) if isinstance(value, int | float) else usual)
    return found[0], found[1]
