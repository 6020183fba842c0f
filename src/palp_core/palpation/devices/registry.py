"""Names of device back ends: kind and name stand for a class that is imported on use."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import Any, Literal, get_type_hints, overload

import msgspec

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import EmgDevice, RingDevice, StageDevice, TorqueSensor

_BACK_ENDS: Mapping[str, Mapping[str, str]] = {
    "stage": {
        "sim": "palp_core.palpation.devices.sim.stage:SimStage",
        "aerotech": "palp_core.palpation.devices.stage.aerotech:AerotechStage",
    },
    "ring": {
        "sim": "palp_core.palpation.devices.sim.ring:SimRing",
        "maestro": "palp_core.palpation.devices.ring.maestro:MaestroRing",
    },
    "torque": {
        "sim": "palp_core.palpation.devices.sim.torque:SimTorque",
        "ati": "palp_core.palpation.devices.torque.ati:AtiTorque",
        "netft": "palp_core.palpation.devices.torque.netft:NetFtTorque",
    },
    "emg": {
        "sim": "palp_core.palpation.devices.sim.emg:SimEmg",
        "noraxon": "palp_core.palpation.devices.emg.noraxon:NoraxonEmg",
        "lsl": "palp_core.palpation.devices.emg.lsl:LslEmg",
        "spikershield": "palp_core.palpation.devices.emg.spikershield:SpikerShieldEmg",
    },
}


def known_devices(kind: str) -> list[str]:
    """Return the names of the back ends of a kind.

    Raises:
        DeviceError: There is no such kind.
    """
    if kind not in _BACK_ENDS:
        raise DeviceError(f"no kind of device '{kind}'; known: {', '.join(sorted(_BACK_ENDS))}")
    return sorted(_BACK_ENDS[kind])


@overload
def open_device(kind: Literal["stage"], name: str, **options: Any) -> StageDevice[Any]: ...
@overload
def open_device(kind: Literal["ring"], name: str, **options: Any) -> RingDevice[Any]: ...
@overload
def open_device(kind: Literal["torque"], name: str, **options: Any) -> TorqueSensor[Any]: ...
@overload
def open_device(kind: Literal["emg"], name: str, **options: Any) -> EmgDevice[Any]: ...
def open_device(kind: str, name: str, **options: Any) -> Any:
    """Build a device back end; its link opens with the device's own ``open``.

    Args:
        kind: ``stage``, ``ring``, ``torque`` or ``emg``.
        name: A known name, or ``package.module:Class`` for a back end from elsewhere.
        options: Parameters of that class, as a YAML file can say them: lists stand for tuples, and a mapping
            for a class of parameters (``limits: {y_m: [-0.02, 0.02]}``).

    Raises:
        DeviceError: The kind, the name or an option is unknown, and the message lists those there are; or an
            option has another type.
    """
    found = back_end(kind, name)
    signature = inspect.signature(found)
    try:
        signature.bind(**options)
    except TypeError as error:
        raise DeviceError(
            f"{kind} device '{name}': {error}; its options are {', '.join(signature.parameters)}"
        ) from error
    hints = get_type_hints(found)
    return found(
        **{
            option: _converted(f"{kind} device '{name}': {option}", value, hints[option])
            if option in hints
            else value
            for option, value in options.items()
        }
    )


def device_mistakes(
    kind: Literal["stage", "ring", "torque", "emg"], name: str, options: Mapping[str, Any]
) -> dict[str, str]:
    """Return what is wrong with the device of a node, by the node's parameter; no link is opened.

    Args:
        kind: As for :func:`open_device`.
        name: The node's parameter ``device``.
        options: Its parameter ``options``, with what the node itself gives the device.
    """
    try:
        back_end(kind, name)
    except DeviceError as error:
        return {"device": str(error)}
    try:
        open_device(kind, name, **options)
    except DeviceError as error:
        return {"options": str(error)}
    return {}


def back_end(kind: str, name: str) -> Any:
    """Return the class behind a name; errors as for :func:`open_device`."""
    known = known_devices(kind)
    where = _BACK_ENDS[kind].get(name, name)
    if ":" not in where:
        raise DeviceError(
            f"no {kind} device '{name}'; known: {', '.join(known)}, or give package.module:Class"
        )
    return _load(kind, where)


def _converted(where: str, value: Any, wanted: Any) -> Any:
    """Return a value as the type of its parameter.

    Raises:
        DeviceError: It cannot be.
    """
    try:
        return msgspec.convert(value, wanted)
    except msgspec.ValidationError as error:
        raise DeviceError(f"{where} = {value!r}: {error}") from error
    except TypeError:  # a type that is not plain data, as an array is
        return value


def _load(kind: str, where: str) -> Any:
    module_name, _, class_name = where.partition(":")
    try:
        return getattr(import_module(module_name), class_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise DeviceError(
            f"{kind} device: cannot import '{where}': {error}; check the module and class"
        ) from error
