"""All emulated devices of a rig, with their addresses and their faults."""

import shutil
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator.aerotech import Aerotech
from palp_core.palpation.devices.emulator.axis import Axes, Axis, AxisSettings
from palp_core.palpation.devices.emulator.contact import ContactSettings, ProbeContact
from palp_core.palpation.devices.emulator.emg import EMG_HZ, Http, LslOutlet, Noraxon, load_filters
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import CHECKED_FAULTS, WIRE_FAULTS, Faults
from palp_core.palpation.devices.emulator.maestro import EmulatedRod, Maestro, MaestroSettings
from palp_core.palpation.devices.emulator.netcanoem import LoadedSensor, Netcanoem, SocketCand
from palp_core.palpation.devices.emulator.ports import DeviceSide, PtyPort, TcpPort
from palp_core.palpation.devices.sim.ring import SimRing
from palp_core.palpation.devices.sim.torque import SimTorque
from palp_core.palpation.devices.wire import aerotech as aerotech_wire
from palp_core.palpation.nano17 import FORCE_RESOLUTION_N
from palp_core.user_folders import own_folder

DEVICES = ("aerotech", "maestro", "ati", "noraxon", "lsl")
"""The devices that can be emulated."""

T = TypeVar("T")
_FOR_EVER = 1 << 60
_DEVICE_FAULTS = {
    "aerotech": ("limit", "e-stop", "stuck", "dropped", "short"),
    "maestro": (*CHECKED_FAULTS, "stalled"),
    "ati": ("saturated", "status"),
}


@dataclass(frozen=True)
class RigSettings:
    """How the emulated devices are set up.

    Attributes:
        contact: What the probe touches.
        y_axis: The axis along the sweep.
        z_axis: The axis that lifts the probe.
        x_axis: The axis across the sweep.
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
    x_axis: AxisSettings = field(default_factory=AxisSettings)
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


class Plug(Protocol):
    """What can be plugged in and pulled out."""

    def plug(self) -> None: ...
    def unplug(self) -> None: ...


Made = tuple[Plug, Callable[[], dict[str, Any]]]
"""An emulated device, and what returns the options of its driver once it is plugged in."""


def _own(folder: Path) -> Path:
    """Return a folder that is there and this user's: a terminal in another's leads where that one likes."""
    try:
        mistake = own_folder(folder)
    except OSError as error:
        mistake = f"{folder} cannot be made: {error.strerror}"
    if mistake is not None:
        raise DeviceError(
            f"emulator: {mistake}; choose another folder (of launch/emulated.yaml: another host:=)"
        )
    return folder


class EmulatedRig:
    """Start emulated devices by name, and stop them at the end of the ``with``."""

    def __init__(self, settings: RigSettings | None = None, devices: Iterable[str] = DEVICES[:4]) -> None:
        self.settings = settings or RigSettings()
        self._devices = tuple(devices)
        unknown = set(self._devices) - set(DEVICES)
        if unknown:
            raise DeviceError(
                f"emulator: no device {', '.join(sorted(unknown))}; known: {', '.join(DEVICES)}"
            )
        given = self.settings
        self.axes = Axes(Axis(given.y_axis), Axis(given.z_axis), Axis(given.x_axis))
        self.rod = EmulatedRod(given.ring, given.seed)
        self.contact = ProbeContact(
            given.contact, self.axes, self.rod, given.seed, ahead="ati" in self._devices
        )
        self.sensor = LoadedSensor(given.torque, given.force_noise_sd_n, self.contact, self.axes, given.seed)
        self._netcanoem = Netcanoem(self.sensor.wrench)
        self._plugs: dict[str, Plug] = {}
        self._faults = {name: Faults(seed=i) for i, name in enumerate(self._devices)}
        self._unplugged: set[str] = set()
        self._second: TcpPort | None = None
        self.addresses: dict[str, str] = {}
        self.options: dict[str, dict[str, Any]] = {}

    def start(self) -> Self:
        """Plug everything in; afterwards ``addresses`` and ``options`` (of the drivers) are known."""
        with ExitStack() as undo:
            undo.callback(self.contact.close)
            if self.settings.folder:
                self._folder = _own(Path(self.settings.folder))
            else:
                self._folder = Path(tempfile.mkdtemp(prefix="palp-emulator-"))
                undo.callback(shutil.rmtree, self._folder)
            if {"noraxon", "lsl"} & set(self._devices):
                load_filters()  # here, and not in the thread that serves the wires
            self.loop = EmulatorLoop()
            undo.callback(self.loop.stop)
            undo.callback(self._unplug_all)
            for name in self._devices:
                self.loop.call(lambda name=name: self._start_device(name))  # type: ignore[misc]
            self._undo = undo.pop_all()
        return self

    @property
    def stop_link(self) -> str:
        """Address of the controller's second TCP port, for the safety process; empty on a terminal."""
        return self._second.address if self._second is not None else ""

    def stop(self) -> None:
        """Pull everything out."""
        self._undo.close()
        failures = self.loop.failures
        if failures:
            raise DeviceError(
                f"emulator: {len(failures)} failures, the first: {failures[0]!r}"
            ) from failures[0]

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def fault(self, device: str, name: str, count: int = _FOR_EVER, value: float = 0.1) -> None:
        """Break something."""
        if name not in self.faults_of(device):
            raise DeviceError(
                f"emulator: {device} has no fault '{name}'; known: {', '.join(self.faults_of(device))}"
            )
        if name == "disconnect":
            self.disconnect(device)
        elif name in WIRE_FAULTS + CHECKED_FAULTS:
            self.loop.call(lambda: self._faults[device].inject(name, count, value))
        else:
            self.loop.call(lambda: self._inject_fault(name, value))

    def faults_of(self, device: str) -> list[str]:
        """Return the names of a device's faults."""
        if device not in self._devices:
            raise DeviceError(f"emulator: no device '{device}' here; there are {', '.join(self._devices)}")
        return [*WIRE_FAULTS, "disconnect", *_DEVICE_FAULTS.get(device, ())]

    def clear(self, device: str) -> None:
        """Mend a device: its wire, its plug and what broke inside; a latched fault stays latched."""
        self.faults_of(device)  # refuses an unknown device
        self.loop.call(self._faults[device].clear)
        self.loop.call(lambda: self._undo_fault(device))
        if device in self._unplugged:
            self.connect(device)

    def disconnect(self, device: str) -> None:
        """Pull a device's cable."""
        self._unplugged.add(device)
        if device in self._plugs:
            self.loop.call(self._plugs[device].unplug)

    def connect(self, device: str) -> None:
        """Plug a device in again, at the same address."""
        self.disconnect(device)
        self._unplugged.discard(device)
        self.loop.call(self._plugs[device].plug)

    def call(self, function: Callable[[int], T]) -> T:
        """Return what a function of the time says, on the emulator's thread: it may look at or change all."""
        return self.loop.call(lambda: function(self.loop.now_ns()))

    def truth(self, now_ns: int) -> dict[str, float]:
        """Return where everything is and the true torque, by name; on the emulator's thread."""
        return {
            "y_m": self.axes.y.position_m(now_ns),
            "z_m": self.axes.z.position_m(now_ns),
            "x_m": self.axes.x.position_m(now_ns),
            "ring_m": self.rod.ring_m(now_ns),
            "torque_n_m": self.contact.loads(now_ns)[2],
        }

    def _unplug_all(self) -> None:
        for name in self._devices:
            self.disconnect(name)
        if self._second is not None:
            self.loop.call(self._second.unplug)

    def _start_device(self, name: str) -> None:
        plug, options = getattr(self, f"_make_{name}")(self._faults[name])
        self._plugs[name] = plug
        plug.plug()
        self.options[name] = options()  # a port that was free is known now
        self.addresses[name] = str(next(iter(self.options[name].values())))

    def _tcp(self, port: int, make: Callable[[], DeviceSide], faults: Faults) -> TcpPort:
        return TcpPort(self.loop, port, make, faults, self.settings.host)

    def _make_aerotech(self, faults: Faults) -> Made:
        side = partial(Aerotech, self.axes)
        stage: PtyPort | TcpPort
        if self.settings.stage_serial:
            stage = PtyPort(self.loop, self._folder / "aerotech", side, faults, self.settings.stage_baud)
        else:
            stage = self._tcp(self.settings.aerotech_port, side, faults)
            self._second = self._tcp(self.settings.aerotech_stop_port, side, Faults())
            self._second.plug()
        return stage, lambda: {"url": stage.address, "verified": ("*",)}

    def _make_maestro(self, faults: Faults) -> Made:
        def side() -> Maestro:
            return Maestro(self.rod, MaestroSettings(), self.loop.now_ns())

        port = PtyPort(self.loop, self._folder / "maestro", side, faults, self.settings.maestro_baud)
        return port, lambda: {"url": port.address, "crc": True, "verified": ("*",)}

    def _make_ati(self, faults: Faults) -> Made:
        side = partial(SocketCand, self._netcanoem, self.settings.can_bitrate)
        port = self._tcp(self.settings.can_port, side, faults)
        return port, lambda: {
            "channel": "can0",
            "interface": "socketcand",
            "options": {"host": port.host, "port": port.port, "tcp_tune": True},
            "verified": ("*",),
        }

    def _make_noraxon(self, faults: Faults) -> Made:
        amplifier = Noraxon(seed=self.settings.seed)
        side = partial(Http, amplifier.page, "application/json")
        port = self._tcp(self.settings.noraxon_port, side, faults)
        return port, lambda: {"host": port.host, "port": port.port, "rate_hz": EMG_HZ, "verified": ("*",)}

    def _make_lsl(self, faults: Faults) -> Made:
        name = self._folder.name
        outlet = LslOutlet(self.loop, faults, name, self.settings.seed)
        return outlet, lambda: {"stream": name, "rate_hz": EMG_HZ}

    def _inject_fault(self, name: str, value: float) -> None:
        now_ns, axes = self.loop.now_ns(), (self.axes.y, self.axes.z, self.axes.x)
        match name:
            case "limit":
                self.axes.y.trip(aerotech_wire.Fault.CW_END_OF_TRAVEL, now_ns)
            case "e-stop":
                for axis in axes:
                    axis.estop = True
                    axis.trip(aerotech_wire.Fault.E_STOP, now_ns)
            case "stuck":
                for axis in axes:
                    axis.stuck = True
                    if axis.moving(now_ns):
                        axis.trip(aerotech_wire.Fault.POSITION_ERROR, now_ns)
            case "dropped":
                self.axes.z.slips = True
                if any(axis.moving(now_ns) for axis in (self.axes.y, self.axes.x)):
                    self.axes.z.fall(0.0, now_ns)
            case "short":
                self.axes.z.short = True
            case "stalled":
                self.rod.stall(now_ns)
            case "saturated":
                self._netcanoem.saturated = (2,)
            case "status":
                self._netcanoem.status = int(value) if value >= 1.0 else 0x8020

    def _undo_fault(self, device: str) -> None:
        if device == "aerotech":
            for axis in (self.axes.y, self.axes.z, self.axes.x):
                axis.estop = axis.stuck = axis.short = axis.slips = False
        elif device == "maestro":
            self.rod.stalled = False
        elif device == "ati":
            self._netcanoem.saturated, self._netcanoem.status = (), 0
