"""What a simulated world does to a sweep: run-in and stick-slip by ring, the table of traces, and a picture.

Run: .venv/bin/python benchmarks/world.py [--out docs] [--count 100000]

Seconds are of CPU, of one core.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from time import process_time_ns
from typing import TYPE_CHECKING

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from palp_core.palpation.mechanics.tip import contact_radius_m
from palp_core.palpation.reporting.charts import BLUE, GREY, VERMILION, Chart, save, tidy
from palp_core.palpation.studies.plan import Gel
from palp_core.palpation.studies.trace_table import TraceTable, tabulate_traces
from palp_core.palpation.world.drag import drag, joints_of
from palp_core.palpation.world.draws import layer_weight
from palp_core.palpation.world.latents import LATENTS, LOWEST, REACH, latents
from palp_core.palpation.world.model import LAB, PAPER, WorldModel
from palp_core.palpation.world.stick_slip import stick_slip
from palp_core.palpation.world.texture import track
from palp_core.palpation.world.touch import touch
from palp_core.palpation.world.trace import trace
from palp_core.units import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGE_M = np.linspace(-0.03, 0.05, 321)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of the picture")
    parser.add_argument("--count", type=int, default=100_000, help="traces that are timed")
    given = parser.parse_args()
    by_ring()
    start_ns = process_time_ns()
    table = tabulate_traces(Gel(reading="trace"))
    print(f"\ntable of traces: {(process_time_ns() - start_ns) * 1e-9:.1f} s")
    timed(table, given.count)
    errors(table)
    picture(given.out)


def by_ring() -> None:
    """Print how far a probe lags before it drags, and where the tip sticks and slips."""
    gel = Gel()
    rings_m = np.asarray(gel.rings_m)
    scene = gel.scene(0.004)
    felt = touch(scene.phantom, scene.probe, "l2", tips=False)
    rows = latents(len(rings_m))
    found = drag(felt, rows, rings_m, gel.indentation_m, STAGE_M)
    joints = joints_of(felt, rows, rings_m, gel.indentation_m, 1.0)
    lag_m = scene.probe.lever_m * np.sin(found.angle_rad[:, -1])
    print("ring_m  stage_until_loose_mm  tip_lags_mm  stick-slip: hertz and N mm from least to largest")
    for j, ring_m in enumerate(rings_m):
        words = []
        for excess in (0.02, LAB.static_friction_excess, 0.1, 0.3):
            cycles = stick_slip(joints, found, excess, 0.02)
            hertz, swing = cycles.hertz[j, 120], cycles.swing_n_m[j, 120] * 1e3
            words.append(f"{excess:g}: " + (f"{hertz:.0f} Hz {swing:.1f}" if hertz else "none"))
        print(f"{ring_m:6.3f}  {found.loose_m[j] * 1e3:20.2f}  {lag_m[j] * 1e3:11.2f}  {', '.join(words)}")


def latent_spread(
    world: WorldModel, depth_m: float = 0.004, *, ring_sd_m: float = 0.0, height_sd_m: float = 0.0
) -> tuple[Float64Array, Float64Array]:
    """Return mean and standard deviation of a sweep's latents over sessions, each of shape (7,).

    The square of a normal distance of variance v has the mean v and the standard deviation sqrt(2) v.
    """
    contact_m = contact_radius_m(0.006, 0.5 * 0.004)
    layer = world.layer_modulus_sd * layer_weight(depth_m, contact_m)
    beside = world.bead_beside_specimen_sd_m**2 + world.bead_beside_mounting_sd_m**2
    at = LATENTS.index
    mean, sd = np.zeros(len(LATENTS)), np.zeros(len(LATENTS))
    mean[at("beside_m2")] = beside
    sd[at("ring_m")], sd[at("beside_m2")], sd[at("tip_radius_m")] = (
        ring_sd_m,
        np.sqrt(2.0) * beside,
        world.tip_radius_session_sd_m,
    )
    sd[at("height_m")] = np.hypot(height_sd_m, world.indentation_session_sd_m)
    sd[at("modulus")] = np.linalg.norm([world.modulus_batch_sd, world.modulus_specimen_sd, layer])
    sd[at("friction")] = world.friction_mounting_sd
    sd[at("along_m")] = np.hypot(world.bead_along_specimen_sd_m, world.bead_along_mounting_sd_m)
    return mean, sd


def of_the_lab(count: int, scale: float, rng: np.random.Generator) -> Float64Array:
    """Return latents as the lab's world spreads them, or so many times wider."""
    mean, sd = latent_spread(LAB, 0.004, ring_sd_m=0.3e-3 / np.sqrt(3.0), height_sd_m=0.1e-3)
    rows = mean + scale * sd * rng.standard_normal((count, len(LATENTS)))
    beside = LATENTS.index("beside_m2")
    rows[:, beside] = np.abs(rows[:, beside])
    return np.clip(rows, LOWEST, REACH)


def timed(table: TraceTable, count: int) -> None:
    """Print what traces cost."""
    rng = np.random.default_rng(1)
    depth, ring = rng.integers(0, 3, count), rng.integers(0, 5, count)
    rows, surface = of_the_lab(count, 1.0, rng), track(rng, 1000)
    sensor = rng.standard_normal((count, 82))
    phase = rng.random(count)
    table.stick_slip(LAB, depth[:1], ring[:1], phase[:1])
    starts = [process_time_ns()]
    made = table.traces(depth, ring, rows)
    starts.append(process_time_ns())
    for part in np.array_split(np.arange(count), max(count // 1000, 1)):
        made[part] += table.texture(LAB, depth[part], ring[part], surface[: len(part)])
    starts.append(process_time_ns())
    made += table.stick_slip(LAB, depth, ring, phase) + table.sensor(LAB, sensor)
    starts.append(process_time_ns())
    spent = ", ".join(f"{b:.2f} s" for b in np.diff(starts) * 1e-9)
    print(f"{count} traces of {made.shape[1]} bins, their texture, stick-slip and sensor: {spent}")


def errors(table: TraceTable) -> None:
    """Print what the table misses of 120 whole sweeps, N mm: root of the mean square, and the most."""
    rng = np.random.default_rng(2)
    weights = np.full(9, 1 / 8)
    weights[[0, -1]] /= 2
    print("depth_m ring_m  spread of the lab, its double, its triple: rms / most, N mm")
    for i, depth_m in enumerate(table.gel.depths_m):
        scene = table.gel.scene(depth_m)
        felt = touch(scene.phantom, scene.probe, table.rungs[i])
        for j, ring_m in enumerate(table.gel.rings_m):
            words = []
            for scale in (1.0, 2.0, 3.0):
                rows = of_the_lab(120, scale, rng)
                found = drag(felt, rows, np.full(120, ring_m), table.gel.indentation_m, STAGE_M)
                whole = [found.torque_n_m[:, 8 * k : 8 * k + 9] @ weights for k in range(40)]
                missed = table.traces(np.full(120, i), np.full(120, j), rows) - np.stack(whole, axis=1)
                rms, most = np.sqrt(np.square(missed).mean()) * 1e3, np.abs(missed).max() * 1e3
                words.append(f"{rms:.4f} / {most:.2f}")
            print(f"{depth_m:7.3f} {ring_m:6.3f}  {'   '.join(words)}")


def picture(folder: Path) -> None:
    """Draw a sweep over 4 mm of gel in both worlds, on and back."""
    scene = Gel().scene(0.004)
    felt = touch(scene.phantom, scene.probe, "l2")
    luck = track(np.random.default_rng(3), 1)[0]
    fine_m = np.arange(-0.03, 0.05, 2e-5)

    def torque(world: WorldModel, ring_m: float, *, forward: bool) -> Float64Array:
        ends = (-0.03, 0.05) if forward else (0.05, -0.03)
        swept = trace(felt, world, latents()[0], luck, ring_m, 0.004, *ends)
        return (1e3 if forward else -1e3) * swept.torque_n_m(fine_m)

    lines = {
        (ring_m, name, way): trace_of
        for ring_m in (0.008, 0.016)
        for name, world in (("paper", PAPER), ("lab", LAB))
        for way, trace_of in (
            ("on", torque(world, ring_m, forward=True)),
            ("back", torque(world, ring_m, forward=False)),
        )
    }

    def draw(figure: Figure) -> None:
        for axes, ring_m in zip(figure.subplots(1, 2, sharex=True), (0.008, 0.016), strict=True):
            for name, colour in (("paper", GREY), ("lab", BLUE)):
                axes.plot(
                    fine_m * 1e3, lines[ring_m, name, "on"], color=colour, lw=0.9, label=f"{name}, towards +Y"
                )
            axes.plot(
                fine_m * 1e3,
                lines[ring_m, "lab", "back"],
                color=VERMILION,
                lw=0.7,
                ls="--",
                label="lab, back, mirrored",
            )
            tidy(axes, f"Ring at {ring_m * 1e3:g} mm", "stage, mm", "torque, N mm")
        axes.legend(loc="lower center")

    names = [f"{ring_m * 1e3:g} mm, {name}, {way}, N mm" for ring_m, name, way in lines]
    every = slice(None, None, 50)
    rows = np.column_stack([fine_m[every] * 1e3, *[line[every] for line in lines.values()]]).round(5).tolist()
    save(Chart("world", "A sweep in both worlds", "", 3.2, ["stage, mm", *names], rows, draw), folder)
    (folder / "world.csv").unlink()


if __name__ == "__main__":
    main()
