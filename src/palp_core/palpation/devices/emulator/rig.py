"""All emulated devices of a rig, with their addresses and their faults."""

import shutil
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator.aerotech import Aerotech
from palp_core.palpation.devices.emulator.emg import Noraxon
from palp_core.palpation.devices.emulator.event_loop import EmulatorLoop
from palp_core.palpation.devices.emulator.faults import CHECKED_FAULTS, WIRE_FAULTS, Faults
from palp_core.palpation.devices.emulator.http import Http
from palp_core.palpation.devices.emulator.lsl import LslOutlet
from palp_core.palpation.devices.emulator.maestro import Maestro
from palp_core.palpation.devices.emulator.netcanoem import Netcanoem, SocketCand
from palp_core.palpation.devices.emulator.ports import PtyPort, Speaker, TcpPort
from palp_core.palpation.devices.emulator.settings import RigSettings
from palp_core.palpation.devices.emulator.world import World
from palp_core.palpation.devices.wire import aerotech as aerotech_wire
from palp_core.user_folders import own_folder

DEVICES = ("aerotech", "maestro", "ati", "noraxon", "lsl")
_FOR_EVER = 1 << 60
_DEVICE_FAULTS = {
    "aerotech": ("limit", "e-stop", "stuck"),
    "maestro": (*CHECKED_FAULTS, "stalled"),
    "ati": ("saturated", "status"),
}


class Plug(Protocol):
    """What can be plugged in and pulled out."""

    def plug(self) -> None: ...
    def unplug(self) -> None: ...


def _own(folder: Path) -> Path:
    """Return a folder that is there and this user's: a terminal in another's leads where that one likes.

    Raises:
        DeviceError: It is another user's, a link or no folder, or cannot be made.
    """
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
    """Start the devices named; stop them at the end of the ``with``.

    Args:
        settings: How they are set up.
        devices: Which of :data:`DEVICES`.

    Raises:
        DeviceError: There is no such device.
    """

    def __init__(self, settings: RigSettings | None = None, devices: Iterable[str] = DEVICES[:4]) -> None:
        self.settings = settings or RigSettings()
        self._devices = tuple(devices)
        unknown = set(self._devices) - set(DEVICES)
        if unknown:
            raise DeviceError(
                f"emulator: no device {', '.join(sorted(unknown))}; known: {', '.join(DEVICES)}"
            )
        self._plugs: dict[str, list[Plug]] = {}
        self._faults = {name: Faults(seed=i) for i, name in enumerate(self._devices)}
        self._unplugged: set[str] = set()
        self._second: TcpPort | None = None
        self.addresses: dict[str, str] = {}
        self.options: dict[str, dict[str, Any]] = {}

    def start(self) -> Self:
        """Plug everything in; afterwards ``addresses`` and ``options`` (of the drivers) are known."""
        with ExitStack() as undo:
            if self.settings.folder:
                self._folder = _own(Path(self.settings.folder))
            else:
                self._folder = Path(tempfile.mkdtemp(prefix="palp-emulator-"))
                undo.callback(shutil.rmtree, self._folder)
            self.world = World(self.settings.world)
            undo.callback(self.world.close)
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
        """Pull everything out.

        Raises:
            DeviceError: An emulated device failed on the way.
        """
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
        """Break something.

        Args:
            device: Which.
            name: A fault of the wire (``garbage``, ``truncation``, ``delay``, ``silence``, ``checksum``),
                ``disconnect``, or one of the device (:meth:`faults_of`).
            count: For how many replies, for a fault of the wire.
            value: Seconds of ``delay``; the bits of ``status``.

        Raises:
            DeviceError: The device does not know that fault.
        """
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
        for plug in self._plugs.get(device, []):
            self.loop.call(plug.unplug)

    def connect(self, device: str) -> None:
        """Plug a device in again, at the same address."""
        self.disconnect(device)
        self._unplugged.discard(device)
        for plug in self._plugs[device]:
            self.loop.call(plug.plug)

    def on_world(self, function: Callable[[World, int], Any]) -> Any:
        """Look at or change the truth, at a time, on the emulator's thread."""
        return self.loop.call(lambda: function(self.world, self.loop.now_ns()))

    def _unplug_all(self) -> None:
        for name in self._devices:
            self.disconnect(name)
        if self._second is not None:
            self.loop.call(self._second.unplug)

    def _start_device(self, name: str) -> None:
        make = getattr(self, f"_make_{name}")
        self._plugs[name] = make(self._faults[name])
        for plug in self._plugs[name]:
            plug.plug()
        address = getattr(self, f"_address_{name}", None)
        self.options[name] = address() if address else self.options[name]
        self.addresses[name] = str(next(iter(self.options[name].values())))

    def _tcp(self, port: int, speaker: Callable[[], Speaker], faults: Faults) -> TcpPort:
        return TcpPort(self.loop, port, speaker, faults, self.settings.host)

    def _make_aerotech(self, faults: Faults) -> list[Plug]:
        speaker = partial(Aerotech, self.world, always_end=self.settings.stage_always_ends)
        self._stage: PtyPort | TcpPort
        if self.settings.stage_serial:
            path = self._folder / "aerotech"
            self._stage = PtyPort(self.loop, path, speaker, faults, self.settings.stage_baud)
        else:
            self._stage = self._tcp(self.settings.aerotech_port, speaker, faults)
            self._second = self._tcp(self.settings.aerotech_stop_port, speaker, Faults())
            self._second.plug()
        return [self._stage]

    def _address_aerotech(self) -> dict[str, Any]:
        return {"url": self._stage.address, "verified": ("*",)}

    def _make_maestro(self, faults: Faults) -> list[Plug]:
        settings = self.settings.maestro
        path = self._folder / "maestro"
        self.options["maestro"] = {"url": str(path), "crc": settings.crc, "verified": ("*",)}

        def speaker() -> Maestro:
            return Maestro(self.world, settings, self.loop.now_ns())

        streams = settings.timeout_s > 0.0
        return [PtyPort(self.loop, path, speaker, faults, self.settings.maestro_baud, streams=streams)]

    def _make_ati(self, faults: Faults) -> list[Plug]:
        sensor = Netcanoem(self.world)
        bitrate = self.settings.can_bitrate
        self._can = self._tcp(self.settings.can_port, lambda: SocketCand(sensor, bitrate), faults)
        return [self._can]

    def _address_ati(self) -> dict[str, Any]:
        link = {"host": self._can.host, "port": self._can.port, "tcp_tune": True}
        return {"channel": "can0", "interface": "socketcand", "options": link, "verified": ("*",)}

    def _make_noraxon(self, faults: Faults) -> list[Plug]:
        amplifier = Noraxon(self.world, self.settings.emg_rate_hz, self.settings.clock_ppm)
        self._noraxon = self._tcp(
            self.settings.noraxon_port, lambda: Http(amplifier.page, "application/json"), faults
        )
        return [self._noraxon]

    def _address_noraxon(self) -> dict[str, Any]:
        link = {"host": self._noraxon.host, "port": self._noraxon.port}
        return {**link, "rate_hz": self.settings.emg_rate_hz, "verified": ("*",)}

    def _make_lsl(self, faults: Faults) -> list[Plug]:
        name = self._folder.name
        self.options["lsl"] = {"stream": name, "rate_hz": self.settings.emg_rate_hz}
        rate_hz, clock_ppm = self.settings.emg_rate_hz, self.settings.clock_ppm
        return [LslOutlet(self.loop, self.world, faults, name, rate_hz, clock_ppm)]

    def _inject_fault(self, name: str, value: float) -> None:
        world, now_ns = self.world, self.loop.now_ns()
        axes = world.axes.values()
        match name:
            case "limit":
                world.axes["y"].trip(aerotech_wire.Fault.CW_END_OF_TRAVEL, now_ns)
            case "e-stop":
                for axis in axes:
                    axis.estop = True
                    axis.trip(aerotech_wire.Fault.E_STOP, now_ns)
            case "stuck":
                for axis in axes:
                    axis.stuck = True
                    if axis.moving(now_ns):
                        axis.trip(aerotech_wire.Fault.POSITION_ERROR, now_ns)
            case "stalled":
                world.stall(now_ns)
            case "saturated":
                world.saturated_gauges = (2,)
            case "status":
                world.sensor_status = int(value) if value >= 1.0 else 0x8020

    def _undo_fault(self, device: str) -> None:
        if device == "aerotech":
            for axis in self.world.axes.values():
                axis.estop = axis.stuck = False
        elif device == "maestro":
            self.world.ring_stalled = False
        elif device == "ati":
            self.world.saturated_gauges, self.world.sensor_status = (), 0
