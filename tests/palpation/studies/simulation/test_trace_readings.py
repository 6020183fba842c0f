"""Readings off whole sweeps of the table are those of the sweeps themselves, through the same chain."""

from dataclasses import replace

import numpy as np
import pytest

from palp_core.palpation.studies.simulation.reading_table import Gel, measured, read
from palp_core.palpation.studies.simulation.trace_readings import STAGE_M, readings, whole_sweeps
from palp_core.palpation.studies.simulation.trace_table import TraceTable, scene_of, tabulate_traces
from palp_core.palpation.world.latents import latents
from palp_core.palpation.world.model import LAB, PAPER
from palp_core.palpation.world.texture import track
from palp_core.palpation.world.touch import touch
from palp_core.palpation.world.trace import trace

GEL = Gel(depths_m=(0.004,), rings_m=(0.012,))
ROWS = latents(3, height_m=[0.0, 0.2e-3, -0.1e-3], modulus=[0.05, -0.05, 0.0], along_m=[0.5e-3, 0.0, -1e-3])
LUCK = track(np.random.default_rng(3), 3)
CELL = np.zeros(3, dtype=np.int64)


def swept(table: TraceTable, world: object = LAB, noise_sd_n_m: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(4)
    return whole_sweeps(
        table,
        world,  # type: ignore[arg-type]
        CELL,
        CELL,
        ROWS,
        LUCK,
        np.zeros(3),
        rng,
        noise_sd_n_m=noise_sd_n_m,
    )


@pytest.mark.parametrize("forward", [True, False], ids=["forward", "back"])
@pytest.mark.parametrize("feature", ["peak", "contrast"])
@pytest.mark.parametrize(("texture_sd_n_m", "most"), [(0.0, 0.02e-3), (0.2e-3, 0.065e-3)])
def test_a_reading_is_that_of_the_whole_sweep(
    forward: bool, feature: str, texture_sd_n_m: float, most: float
) -> None:
    """Solved one by one at every sample, and read by the chain of the simulated rig.

    The table meets the surface where the ball is on the nominal sweep, a few tenths of a millimetre away.
    """
    world = replace(
        LAB,
        static_friction_excess=0.0,
        bias_walk_n_m_per_sqrt_s=0.0,
        tare_sd_n_m=0.0,
        texture_sd_n_m=texture_sd_n_m,
    )
    table = tabulate_traces(GEL, forward=forward)
    found = readings(swept(table, world), feature)
    scene = scene_of(GEL, 0.004)
    felt = touch(scene.phantom, scene.probe, "l2")
    for i, row in enumerate(ROWS):
        ends = (-0.03, 0.05) if forward else (0.05, -0.03)
        one = trace(felt, world, row, LUCK[i], 0.012, 0.004, *ends)
        torque = np.abs(one.torque_n_m(STAGE_M if forward else STAGE_M[::-1]))
        assert found[i] == pytest.approx(read(torque, replace(GEL, feature=feature)), abs=most)


def test_without_a_world_it_is_the_rigs_own_noise() -> None:
    table = tabulate_traces(GEL, run_in=False)
    quiet, noisy = swept(table, PAPER), swept(table, PAPER, noise_sd_n_m=1e-3 / 64)
    own = measured(quiet[0], GEL, np.random.default_rng(5)) - quiet[0]
    assert (noisy - quiet).std() == pytest.approx(own.std(), rel=0.05)


def test_stick_slip_makes_the_peak_higher() -> None:
    """At 16 mm the tip hums; what is left of it after de-noising stands on the bead's own peak."""
    table = tabulate_traces(replace(GEL, rings_m=(0.016,)))
    still = swept(table, replace(LAB, static_friction_excess=0.0))
    assert (readings(swept(table)) - readings(still) > 0.1e-3).all()
