"""Messages of the rig as tests of its nodes need them: what no test asks about has a default."""

from __future__ import annotations

from typing import Any

import numpy as np

from msgs.actuator import RingCommand, RingState
from msgs.emg import EmgBlock
from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import Mount, Trial
from msgs.torque import TorqueBlock
from palp_core.units import Float64Array

DEPTHS_M = np.array([0.002, 0.004, 0.008])
RINGS_M = np.array([0.0, 0.004, 0.008, 0.012, 0.016])
SLOPES_N = np.array([1.5, 1.4, 1.3])
"""Torque per ring position at each depth."""


def trial(number: int, phase: str = "estimation", depth_m: float = 0.0, **fields: Any) -> Trial:
    """Return the beginning of a trial; its depth is known in training."""
    given = {"number": 1, "code": "", "label_known": phase == "training", **fields}
    return Trial(stamp_ns=0, trial=number, phase=phase, depth_m=depth_m, **given)


def belief(number: int, iteration: int, verdict: str = "continue", **fields: Any) -> Belief:
    """Return a belief after a palpation, which has not decided."""
    posterior: Float64Array = np.asarray(fields.pop("posterior", (0.2, 0.5, 0.3)), dtype=np.float64)
    known = {"gain": np.zeros(len(posterior)), "gamma": 0.0, "gamma_defined": False, "outlier": False}
    best = int(np.argmax(posterior))
    known |= {"estimate_m": float(DEPTHS_M[best]), "confidence": float(posterior[best]), "depths_m": DEPTHS_M}
    return Belief(
        stamp_ns=0,
        trial=number,
        iteration=iteration,
        posterior=posterior,
        verdict=verdict,
        **known | fields,  # type: ignore[arg-type]
    )


def learnt(sd_n_m: float = 2.4e-4) -> PrimitivesLearnt:
    """Return what training leaves: torque grows with the ring, less at a greater depth."""
    return PrimitivesLearnt(
        stamp_ns=0,
        depths_m=DEPTHS_M,
        rings_m=RINGS_M,
        mean_n_m=(SLOPES_N[:, None] * RINGS_M).ravel(),
        sd_n_m=np.full(15, sd_n_m),
        count=np.full(15, 25.0),
        floor_n_m=4.5e-6,
    )


def ring_command(ring_m: float, number: int = 0, iteration: int = 1, *, rehome: bool = False) -> RingCommand:
    """Return a command of the ring; to re-home is palpation 0."""
    return RingCommand(
        stamp_ns=0, trial=number, iteration=0 if rehome else iteration, ring_m=ring_m, rehome=rehome
    )


def ring_state(ring_m: float, number: int = 0, iteration: int = 1, **fields: Any) -> RingState:
    """Return the state of a ring that rests where it was sent."""
    shown = {"rehome": False, "target_m": ring_m, "measured_m": ring_m, "settled": True, **fields}
    return RingState(stamp_ns=0, trial=number, iteration=iteration, **shown)


def mount(code: str, remount: int = 0) -> Mount:
    """Return a mounting of a phantom."""
    return Mount(stamp_ns=0, code=code, remount=remount)


def block(torque_n_m: Float64Array, start: int = 0, **fields: Any) -> TorqueBlock:
    """Return a block of torque over the phantom at 1 kHz, from a sample on."""
    shown: dict[str, Any] = {"start_ns": start * 1_000_000, "over_phantom": True, **fields}
    return TorqueBlock(stamp_ns=0, rate_hz=1000.0, saturated_count=0, torque_n_m=torque_n_m, **shown)


def emg_block(start_ns: int, phase: str, fds_v: Float64Array, edc_v: Float64Array, **fields: Any) -> EmgBlock:
    """Return a block of both muscles' EMG, at 1500 Hz unless another rate is given."""
    shown: dict[str, Any] = {"stamp_ns": start_ns, "rate_hz": 1500.0, **fields}
    return EmgBlock(start_ns=start_ns, phase=phase, fds_v=fds_v, edc_v=edc_v, **shown)
