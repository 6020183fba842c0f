"""How the devices of an emulated rig are set up."""

from dataclasses import dataclass, field

from palp_core.palpation.devices.emulator.axis import AxisSettings
from palp_core.palpation.devices.emulator.contact import ContactSettings
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.torque import SimTorque
from palp_core.palpation.nano17 import FORCE_RESOLUTION_N


@dataclass(frozen=True)
class RigSettings:
    """How the emulated devices are set up.

    Attributes:
        contact: What the probe touches.
        y_axis: The axis along the sweep.
        z_axis: The axis that lifts the probe.
        ring: The actuator; its speed is the controller's.
        torque: Noise and drift of the sensor; steps and range are those of its gauges.
        force_noise_sd_n: Noise of each force (assumed: one step of the sensor's resolution).
        seed: Of every random number.
        stage_serial: Whether the stage is on a terminal instead of TCP.
        stage_baud: Of that terminal; 0 for no pacing.
        maestro_baud: Of the ring's terminal; 0 for no pacing (USB).
        can_bitrate: Of the sensor's bus; 0 for no pacing.
        aerotech_port: TCP port; 0 for a free one, as for the next three.
        aerotech_stop_port: The controller's second TCP port, for the safety process.
        can_port: TCP port of socketcand.
        noraxon_port: TCP port of HTTP.
        host: Address of every TCP port.
        folder: Where the terminals are; empty for one of its own.
    """

    contact: ContactSettings = field(default_factory=ContactSettings)
    y_axis: AxisSettings = field(default_factory=AxisSettings)
    z_axis: AxisSettings = field(default_factory=lambda: AxisSettings(soft_low_m=-0.001))
    ring: SimRing = field(default_factory=SimRing)
    torque: SimTorque = field(default_factory=SimTorque)
    force_noise_sd_n: float = FORCE_RESOLUTION_N
    seed: int = 1
    stage_serial: bool = False
    stage_baud: int = 115200
    maestro_baud: int = 115200
    can_bitrate: int = 500_000
    aerotech_port: int = 0
    aerotech_stop_port: int = 0
    can_port: int = 0
    noraxon_port: int = 0
    host: str = "127.0.0.1"
    folder: str = ""
