"""The table of traces against whole sweeps, and the slopes of a filter against the table."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.world import latent_spread
from palp_core.methods import find
from palp_core.palpation.mechanics import Bead, Phantom, Scene
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.scene.choice import choose_rung, rung_model
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.session.filters import height_slope
from palp_core.palpation.session.trace_settings import TraceSettings
from palp_core.palpation.studies.plan import Gel, sweep_torque
from palp_core.palpation.studies.trace_table import TraceTable, ring_and_height, tabulate_traces
from palp_core.palpation.world.drag import drag
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.model import LAB, PAPER
from palp_core.palpation.world.slopes import trace_slopes
from palp_core.palpation.world.texture import track
from palp_core.palpation.world.touch import touch

GEL = Gel(depths_m=(0.002, 0.004), rings_m=(0.008, 0.016), reading="trace")
FINE_M = np.linspace(-0.03, 0.05, 321)


@pytest.fixture(scope="module")
def table() -> TraceTable:
    return tabulate_traces(GEL)


def of_the_lab(count: int, scale: float = 1.0) -> np.ndarray:
    mean, sd = latent_spread(LAB, 0.004, ring_sd_m=0.3e-3 / np.sqrt(3.0), height_sd_m=0.1e-3)
    rows = mean + scale * sd * np.random.default_rng(11).standard_normal((count, len(LATENTS)))
    rows[:, 5] = np.abs(rows[:, 5])
    return np.clip(rows, LOWEST, REACH)


def whole(table: TraceTable, i: int, j: int, rows: np.ndarray) -> np.ndarray:
    """Means over the bins of sweeps solved every quarter of a millimetre, without the table's splines."""
    scene = table.gel.scene(table.gel.depths_m[i])
    rings_m = np.full(len(rows), table.gel.rings_m[j])
    found = drag(touch(scene.phantom, scene.probe, table.rungs[i]), rows, rings_m, 0.004, FINE_M)
    torque = found.torque_n_m
    weights = np.full(9, 1 / 8)
    weights[[0, -1]] /= 2
    return np.stack([torque[:, 8 * k : 8 * k + 9] @ weights for k in range(40)], axis=1)


@pytest.mark.parametrize(
    ("cell", "rms", "most"),
    [((0, 0), 0.01e-3, 0.1e-3), ((0, 1), 0.055e-3, 0.5e-3), ((1, 1), 0.012e-3, 0.13e-3)],
)
def test_the_table_is_the_sweep_it_stands_for(
    table: TraceTable, cell: tuple[int, int], rms: float, most: float
) -> None:
    """Within the lab's spread; a texture is 0.2 N mm. Worst is the flank behind a shallow bead."""
    rows = of_the_lab(24)
    error = table.traces(np.full(24, cell[0]), np.full(24, cell[1]), rows) - whole(table, *cell, rows)
    assert np.sqrt(np.square(error).mean()) < rms
    assert np.abs(error).max() < most


@pytest.mark.parametrize(("error_m", "height_m"), [(0.0, 0.0), (0.25e-3, -0.3e-3), (-0.6e-3, 0.9e-3)])
def test_a_table_of_landing_and_height_alone_is_the_sweep_too(error_m: float, height_m: float) -> None:
    gel = Gel(depths_m=(0.004,), rings_m=(0.004, 0.016))
    plain = tabulate_traces(gel, basis=ring_and_height(1.5e-3), run_in=False)
    one = np.ones(1, dtype=np.int64)
    found = plain.traces(0 * one, one, latents(ring_m=error_m, height_m=height_m))[0]
    torque = sweep_torque(gel, 0.004, 0.016 + error_m, height_m)
    whole = torque.reshape(-1, 100).mean(axis=1)
    np.testing.assert_allclose(found[1:], whole[1:], atol=4e-5)


def test_slopes_of_the_scene_file_alone_are_those_of_the_table(table: TraceTable) -> None:
    known = trace_slopes(GEL.scene(0.004), GEL.depths_m[1:], GEL.rings_m)
    step = 0.05 * REACH
    for latent in range(len(LATENTS)):
        up, down = latents(1), latents(1)
        up[0, latent] = step[latent]
        down[0, latent] = -step[latent] if LOWEST[latent] < 0.0 else 0.0
        at = np.array([1]), np.array([0])
        found = (table.traces(*at, up) - table.traces(*at, down))[0] / (up - down)[0, latent]
        np.testing.assert_allclose(
            known.slope[0, 0, :, latent] * REACH[latent], found * REACH[latent], atol=0.05e-3
        )


def test_what_a_filter_knows_of_traces_is_of_a_contact_model_that_is_right_in_them() -> None:
    scene, _ = TraceSettings().of_rig(scene=GEL.scene(0.004, "peak"))
    assert scene == GEL.scene(0.004)
    assert choose_rung(scene).rung == "l4"


def test_a_scene_whose_bead_is_beside_the_path_has_its_traces_there(table: TraceTable) -> None:
    scene = GEL.scene(0.004)
    aside = replace(scene, phantom=Phantom(bead=Bead(depth_m=0.004, beside_m=0.002)))
    known = trace_slopes(aside, GEL.depths_m[1:], GEL.rings_m, run_in=True)
    at = np.array([1, 1]), np.array([0, 1])
    found = table.traces(*at, latents(2, beside_m2=4e-6))
    np.testing.assert_allclose(known.mean_n_m[0], found, atol=0.04e-3)
    assert np.abs(found - table.traces(*at, latents(2))).max() > 0.15e-3


def test_traces_do_not_depend_on_who_is_asked_with_whom(table: TraceTable) -> None:
    rows = of_the_lab(6)
    depth, ring = np.array([0, 1, 0, 1, 1, 0]), np.array([0, 0, 1, 1, 0, 1])
    together = table.traces(depth, ring, rows)
    alone = np.concatenate([table.traces(depth[[i]], ring[[i]], rows[[i]]) for i in range(6)])
    np.testing.assert_allclose(together, alone, atol=1e-15)


def test_the_run_in_is_in_it_and_can_be_left_out(table: TraceTable) -> None:
    at = np.array([1]), np.array([1])
    only = replace(GEL, depths_m=GEL.depths_m[1:], rings_m=GEL.rings_m[1:])
    alone = tabulate_traces(only, run_in=False)
    dragged = alone.traces(np.array([0]), np.array([0]), latents())[0]
    felt = table.traces(*at, latents())[0]
    assert (np.abs(felt[:7]) < 0.8 * np.abs(dragged[:7])).all()
    np.testing.assert_allclose(felt[9:], dragged[9:], atol=1e-6)


def test_two_sweeps_of_a_mounting_feel_one_surface(table: TraceTable) -> None:
    """At two rings the ball lags differently: the same surface, shifted by a few millimetres."""
    luck = np.repeat(track(np.random.default_rng(12), 400), 2, axis=0)
    depth, ring = np.ones(800, dtype=np.int64), np.tile([0, 1], 400)
    made = table.texture(LAB, depth, ring, luck)
    assert made.std() == pytest.approx(LAB.texture_sd_n_m, rel=0.1)
    soft, stiff = made[::2, 20], made[1::2]
    correlation = [np.corrcoef(soft, stiff[:, k])[0, 1] for k in range(15, 26)]
    assert max(correlation) > 0.85
    assert not table.texture(PAPER, depth, ring, luck).any()


def test_the_sensor_adds_zero_and_noise_in_the_order_of_time(table: TraceTable) -> None:
    luck = np.random.default_rng(13).standard_normal((4000, 82))
    made = table.sensor(LAB, luck)
    assert made[:, 0].std() < 0.8 * made[:, -1].std()
    quiet = table.sensor(PAPER, luck)
    assert quiet.std() == pytest.approx(RESOLUTION_N_M * np.sqrt(1 + 1 / 12) / 10, rel=0.02)


def test_stick_slip_is_there_where_the_sweep_has_it(table: TraceTable) -> None:
    depth, ring = np.ones(32, dtype=np.int64), np.repeat([0, 1], 16)
    made = table.stick_slip(LAB, depth, ring, np.tile(np.arange(16) / 16, 2))
    assert not made[:16].any()  # at 8 mm the joint slides smoothly
    assert 0.03e-3 < made[16:, 12:].std(axis=0).mean() < 0.25e-3  # a bin holds a cycle and a half of 1.5 N mm
    assert not table.stick_slip(PAPER, depth, ring, np.zeros(32)).any()


def test_the_register_is_asked_with_the_rings_and_what_the_joint_gives_way() -> None:
    """A soft gel under a stiff joint: there L2's peak is as wrong as its force."""
    soft, usual = Gel(modulus_pa=8e3), Gel()
    asked = soft.scene(0.004).quantities()
    assert asked["ring_m"] == soft.rings_m
    assert asked["depth_per_tip"] == pytest.approx(0.004 / 0.006)
    assert np.min(asked["yielding"]) < 0.4
    bounds = [find("contact", "l2").bound("peak", gel.scene(0.004).quantities()) for gel in (usual, soft)]
    assert [bound is not None and bound <= 0.02 for bound in bounds] == [True, False]


@pytest.mark.parametrize(("reading", "rung"), [("peak", "l2"), ("contrast", "l4")])
def test_tables_and_slopes_are_of_the_contact_model_that_the_reading_needs(
    reading: str, rung: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[str] = []

    def note_rung(name: str, *given: Any) -> ContactModel:
        used.append(name)
        return rung_model(name, *given)

    for module in ("session.filters", "studies.plan"):
        monkeypatch.setattr(f"palp_core.palpation.{module}.rung_model", note_rung)
    gel = Gel(depths_m=(0.004,), rings_m=(0.016,), reading=reading)
    sweep_torque(gel, 0.004, 0.016)
    height_slope(gel.depths_m, gel.rings_m, reading, Scene(ring_m=gel.rings_m))
    assert used == [rung, rung]
    assert tabulate_traces(gel, basis=ring_and_height(1e-4), run_in=False).rungs == (rung,)
