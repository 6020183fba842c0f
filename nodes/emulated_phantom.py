"""Stand in for the laboratory: emulated devices over one phantom, put on as the experiment asks."""

import sys
from typing import Annotated, Literal

import msgspec

from msgs.experiment import Mount
from nodes.phantom import MARGIN_M, PhantomParams, SimulatedPhantom
from palp_core import ReadOnly, Sub, every, on
from palp_core.graph.messages.builtin import MethodUse
from palp_core.palpation.devices.emulator import EmulatedRig, RigSettings
from palp_core.palpation.devices.emulator.axis import AxisSettings
from palp_core.palpation.devices.emulator.contact import ContactSettings, GuardMet
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.torque import SimTorque
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.session.methods.reporter import MethodReporterState
from palp_core.palpation.session.methods.used import rig_uses
from palp_core.units import (
    Count,
    CountPositive,
    HertzPositive,
    MillimetresNonNegative,
    MillimetresPositive,
    NewtonMillimetresNonNegative,
)

Port = Annotated[int, msgspec.Meta(ge=0, le=65535)]


class EmulatedPhantomParams(PhantomParams):
    """Set in the launch file, in addition to what is touched.

    ``host``, the ports and ``folder`` (of the ring's terminal) are where the drivers find the devices;
    ``lift_mm`` is where the lifting axis has its reference. Ring and sensor are as in the simulated rig: a
    noise file in ``noise`` (plan ``repeatability``) has their spreads.
    ``guard_hz`` is how often it looks whether the contact has met a region in which its rung fails.
    """

    host: ReadOnly[str] = "127.0.0.1"
    stage_port: ReadOnly[Port] = 8000
    stop_port: ReadOnly[Port] = 8001
    can_port: ReadOnly[Port] = 29536
    emg_port: ReadOnly[Port] = 9220
    folder: ReadOnly[str] = ""
    can_bitrate: ReadOnly[CountPositive] = 500_000
    ring_error: ReadOnly[Literal["uniform", "normal"]] = "uniform"
    repeatability_mm: ReadOnly[MillimetresNonNegative] = 0.3
    noise_sd_n_mm: ReadOnly[NewtonMillimetresNonNegative] = RESOLUTION_N_M * 1e3
    seed: ReadOnly[Count] = 1
    lift_mm: ReadOnly[MillimetresPositive] = 20.0
    guard_hz: ReadOnly[HertzPositive] = 5.0


class EmulatedPhantomState(MethodReporterState):
    """What a replacement inherits."""

    code: str = ""
    remount: int = 0


class EmulatedPhantom(SimulatedPhantom):
    """Start stage, ring, sensor and amplifier as their wires show them, and change the phantom."""

    params: EmulatedPhantomParams
    state: EmulatedPhantomState
    mount = Sub(Mount)

    def on_configure(self) -> None:
        super().on_configure()
        p, noise, (low_m, high_m) = self.params, self.noise, sorted((self.params.from_m, self.params.to_m))
        settings = RigSettings(
            contact=ContactSettings(
                touch=p.touch,
                from_m=low_m - MARGIN_M,
                to_m=high_m + MARGIN_M,
                world=self.world,
                lands_m=(low_m, high_m),
            ),
            z_axis=AxisSettings(soft_low_m=-0.001, home_m=p.lift_mm * 1e-3),
            ring=SimRing(
                repeatability_m=2.0 * noise.ring_sd_m.value if noise else p.repeatability_mm * 1e-3,
                distribution="normal" if noise else p.ring_error,
            ),
            torque=SimTorque(
                noise_sd_n_m=noise.sample_sd_n_m.value if noise else p.noise_sd_n_mm * 1e-3,
                bias_drift_n_m_per_sqrt_s=self.world.bias_walk_n_m_per_sqrt_s,
            ),
            seed=p.seed,
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

    def uses(self) -> list[MethodUse]:
        self.reported_m_s = self.rig.contact.swept_m_s
        return rig_uses(self.rig.contact.rig, self.reported_m_s or None, self.world)

    def on_deactivate(self) -> None:
        self.publish_guards()

    def on_shutdown(self) -> None:
        self.rig.stop()

    @on(mount)
    def put_on(self, mount: Mount) -> None:
        self.publish_guards()  # they are of the phantom that is taken off
        height_m = self.draw_height_m()
        self.rig.call(lambda _: self.rig.contact.mount(mount.code, height_m))
        self.state.code, self.state.remount = mount.code, mount.remount
        self.publish_truth(mount, self.rig.contact.rig, height_m)
        if not self.world.plain:
            self.publish_offsets(mount, self.rig.call(lambda _: self.rig.contact.latents()))

    @every("guard_hz")
    def publish_guards(self) -> None:
        """Publish what the contacts since the last look have met: once per mounting, ring and speed."""
        if self.rig.contact.swept_m_s not in (0.0, self.reported_m_s):
            self.publish_methods(self.uses())
        for met in self.rig.call(self._taken):
            self.publish_guard(met.code, self.state.remount, met.ring_m, met.words)

    def _taken(self, _: int) -> list[GuardMet]:
        guards = self.rig.contact.guards
        return [guards.popleft() for _ in range(len(guards))]
