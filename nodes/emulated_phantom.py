"""Stand in for the laboratory: emulated devices over one phantom, put on as the experiment asks."""

from __future__ import annotations

import sys
from typing import Literal

from msgs.experiment import Mount, PhantomTruth
from palp_core import Node, Params, Pub, ReadOnly, State, Sub, on
from palp_core.devices.emulator import EmulatedRig, RigSettings
from palp_core.devices.emulator.axis import AxisSettings
from palp_core.devices.emulator.world import WorldSettings
from palp_core.devices.sim.mount import MountVariation
from palp_core.mechanics.phantom_file import file_mistakes
from palp_core.perception.rig_noise import read_noise
from palp_core.units import Metres, Millimetres, Ratio

MARGIN_M = 0.002


class EmulatedPhantomParams(Params):
    """Set in the launch file.

    ``host``, the ports and ``folder`` (of the ring's terminal) are where the drivers find the devices;
    ``lift_mm`` is where the lifting axis has its reference; the others are as in the simulated rig: a noise
    file in ``noise`` (plan ``repeatability``) has the spreads of torque, ring and height of its own.
    """

    host: ReadOnly[str] = "127.0.0.1"
    stage_port: ReadOnly[int] = 8000
    stop_port: ReadOnly[int] = 8001
    can_port: ReadOnly[int] = 29536
    emg_port: ReadOnly[int] = 9220
    folder: ReadOnly[str] = ""
    can_bitrate: ReadOnly[int] = 500_000
    phantoms: ReadOnly[str] = ""
    scene: ReadOnly[str] = ""
    ring_error: ReadOnly[Literal["uniform", "normal"]] = "uniform"
    repeatability_mm: ReadOnly[Ratio] = 0.3
    noise_sd_n_mm: ReadOnly[Ratio] = 1.0 / 64.0
    seed: ReadOnly[int] = 1
    height_sd_mm: ReadOnly[Millimetres] = 0.1
    noise: ReadOnly[str] = ""
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    lift_mm: ReadOnly[Millimetres] = 20.0


class EmulatedPhantomState(State):
    """What a replacement inherits."""

    code: str = ""


class EmulatedPhantom(Node):
    """Start stage, ring, sensor and amplifier as their wires show them, and change the phantom."""

    simulates = True
    examine = staticmethod(file_mistakes)
    params: EmulatedPhantomParams
    state: EmulatedPhantomState
    mount = Sub(Mount)
    truth = Pub(PhantomTruth)

    def on_configure(self) -> None:
        p = self.params
        noise = read_noise(p.noise) if p.noise else None
        self.height_sd_m = noise.height_sd_m.value if noise else p.height_sd_mm * 1e-3
        world = WorldSettings(
            seed=p.seed,
            phantoms=p.phantoms,
            scene=p.scene,
            from_m=min(p.from_m, p.to_m) - MARGIN_M,
            to_m=max(p.from_m, p.to_m) + MARGIN_M,
            z_axis=AxisSettings(soft_low_m=-0.001, home_m=p.lift_mm * 1e-3),
            repeatability_m=2.0 * noise.ring_sd_m.value if noise else p.repeatability_mm * 1e-3,
            ring_error="normal" if noise else p.ring_error,
            torque_noise_sd_n_m=noise.sample_sd_n_m.value if noise else p.noise_sd_n_mm * 1e-3,
        )
        settings = RigSettings(
            world=world,
            can_bitrate=p.can_bitrate,
            aerotech_port=p.stage_port,
            aerotech_stop_port=p.stop_port,
            can_port=p.can_port,
            noraxon_port=p.emg_port,
            host=p.host,
            folder=p.folder,
        )
        sys.setswitchinterval(0.0005)  # the solver's thread must not hold up the wires
        self.rig = EmulatedRig(settings, ("aerotech", "maestro", "ati", "noraxon")).start()

    def on_shutdown(self) -> None:
        self.rig.stop()

    @on(mount)
    def put_on(self, mount: Mount) -> None:
        height_m = MountVariation(height_sd_m=self.height_sd_m).draw(self.rng).height_m
        self.rig.on_world(lambda world, _: world.mount(mount.code, height_m))
        touched, self.state.code = self.rig.world.rig, mount.code
        bead, choice = touched.phantoms[mount.code].bead, touched.choices[mount.code]
        self.truth.publish(
            PhantomTruth(
                stamp_ns=self.now_ns(),
                code=mount.code,
                remount=mount.remount,
                depth_m=bead.depth_m if bead is not None else 0.0,
                height_offset_m=height_m,
                rung=choice.method.name,
                bound=choice.bound or 0.0,
            )
        )
