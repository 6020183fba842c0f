"""How the devices of an emulated rig are set up."""

from dataclasses import dataclass, field

from palp_core.palpation.devices.emulator.maestro import MaestroSettings
from palp_core.palpation.devices.emulator.world import WorldSettings


@dataclass(frozen=True)
class RigSettings:
    """How the emulated devices are set up.

    Attributes:
        world: What the rig is made of.
        maestro: The ring's controller.
        stage_serial: Whether the stage is on a terminal instead of TCP.
        stage_baud: Of that terminal; 0 for no pacing.
        stage_always_ends: Whether a bare acknowledgement ends with a line feed.
        maestro_baud: Of the ring's terminal; 0 for no pacing (USB).
        can_bitrate: Of the sensor's bus; 0 for no pacing.
        emg_rate_hz: Rate of Noraxon and LSL.
        clock_ppm: How much faster than the host's the clocks of EMG run, in millionths.
        aerotech_port: TCP port; 0 for a free one, as for the next three.
        aerotech_stop_port: The controller's second TCP port, for the safety process.
        can_port: TCP port of socketcand.
        noraxon_port: TCP port of HTTP.
        host: Address of every TCP port.
        folder: Where the terminals are; empty for one of its own.
    """

    world: WorldSettings = field(default_factory=WorldSettings)
    maestro: MaestroSettings = field(default_factory=MaestroSettings)
    stage_serial: bool = False
    stage_baud: int = 115200
    stage_always_ends: bool = True
    maestro_baud: int = 115200
    can_bitrate: int = 500_000
    emg_rate_hz: float = 1500.0
    clock_ppm: float = 0.0
    aerotech_port: int = 0
    aerotech_stop_port: int = 0
    can_port: int = 0
    noraxon_port: int = 0
    host: str = "127.0.0.1"
    folder: str = ""
