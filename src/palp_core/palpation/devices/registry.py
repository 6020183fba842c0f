"""Devices by kind and name, as packages publish them: each is that of a class, imported on use."""

import inspect
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Literal, get_type_hints, overload

import msgspec

from palp_core.errors import DeviceError, in_words
from palp_core.foreign import catch_foreign, import_foreign
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.protocols import (
    EmgDevice,
    RingDevice,
    StageDevice,
    StageOptions,
    StopLink,
    TorqueSensor,
)
from palp_core.published import DEVICES, published

KINDS: Mapping[str, type] = {
    "stage": StageDevice,
    "ring": RingDevice,
    "torque": TorqueSensor,
    "emg": EmgDevice,
}
"""What a device of each kind must be able to do."""

_KIND_BY_METHOD = {"sweep": "stage", "command": "ring", "tare": "torque", "drain": "emg"}
"""Kind of a class by the first of these methods that it has."""


def drivers() -> list[tuple[str, str]]:
    """Return kind and name of every device that is no simulation."""
    return [(kind, name) for kind in KINDS for name in known_devices(kind) if name != "sim"]


def known_devices(kind: str) -> list[str]:
    """Return the names of the devices of a kind."""
    if kind not in KINDS:
        raise DeviceError(f"no kind of device '{kind}'; known: {', '.join(sorted(KINDS))}")
    if not (names := published(DEVICES)):  # a checkout that is newer than its installation
        raise DeviceError("devices: no package publishes any; install palp-core again")
    return [name.removeprefix(f"{kind}.") for name in names if name.startswith(f"{kind}.")]


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
        name: A known name, or ``package.module:Class`` for a device that has none.
        options: Parameters of that class, as a YAML file can say them: lists stand for tuples, and a mapping
            for a class of parameters (``limits: {y_m: [-0.02, 0.02]}``).

    Raises:
        DeviceError: The kind, the name or an option is unknown, and the message lists those there are; or an
            option has another type; or the class lacks an ability of its kind.
    """
    found = back_end(kind, name)
    signature = inspect.signature(found)
    handed = StageOptions.__struct_fields__ if kind == "stage" else ()
    if lacking := [option for option in handed if option not in signature.parameters]:
        raise DeviceError(
            f"{kind} device '{name}': {found.__name__} takes no {', no '.join(lacking)};"
            " give its constructor every field of palp_core.palpation.devices.protocols.StageOptions"
        )
    try:
        signature.bind(**options)
    except TypeError as error:
        raise DeviceError(
            f"{kind} device '{name}': {error}; its options are {', '.join(signature.parameters)}"
        ) from error
    hints = get_type_hints(found)
    given = {
        option: _converted(f"{kind} device '{name}': {option}", value, hints[option])
        if option in hints
        else value
        for option, value in options.items()
    }
    with catch_foreign(f"{kind} device '{name}'", DeviceError):
        made = found(**given)
    _require_members(made, KINDS[kind], f"{kind} device '{name}': {found.__name__}")
    return made


def find_device_mistakes(
    kind: Literal["stage", "ring", "torque", "emg"],
    name: str,
    options: Mapping[str, Any] | None,
    mistakes: Mistakes,
) -> None:
    """Add what is wrong with the parameters ``device`` and ``options`` of a node; no link is opened."""
    with mistakes.of("device"):
        back_end(kind, name)
    if options is not None:
        with mistakes.of("options"):
            open_device(kind, name, **options)


def back_end(kind: str, name: str) -> Any:
    """Return the class behind a name; errors as for :func:`open_device`."""
    known = known_devices(kind)
    where = published(DEVICES)[f"{kind}.{name}"] if name in known else name
    if ":" not in where:
        raise DeviceError(
            f"no {kind} device '{name}'; known: {', '.join(known)}, or give package.module:Class"
        )
    return import_foreign(where, f"{kind} device", DeviceError)


def kind_of(name: str) -> str:
    """Return the kind of a device that is no simulation, by its name, or of a class by its methods."""
    kinds = {known: kind for kind, known in drivers()}
    if name in kinds:
        return kinds[name]
    if ":" not in name:
        raise DeviceError(f"no device '{name}'; known: {', '.join(kinds)}, or give package.module:Class")
    found = import_foreign(name, "your device", DeviceError)
    kind = next((kind for method, kind in _KIND_BY_METHOD.items() if hasattr(found, method)), None)
    if kind is None:
        wanted = ", ".join(f"{method} ({kind})" for method, kind in _KIND_BY_METHOD.items())
        raise DeviceError(f"{name} is not a device: it lacks {wanted}; see palp_core.palpation.devices")
    return kind


def require_stop_link(name: str) -> None:
    """Refuse a stage's back end without a second link to its controller."""
    if getattr(back_end("stage", name), "stop_link", None) is None:
        raise DeviceError(f"stage device '{name}' has no second link to its controller; give stop_link: none")


def open_stop_link(
    name: str,
    options: Mapping[str, Any],
    url: str,
    *,
    timeout_s: float,
    look_hz: float,
    clock: Callable[[], int],
) -> StopLink:
    """Open the second link to a stage's controller, with that stage's own axes."""
    require_stop_link(name)
    stage = open_device("stage", name, **{**msgspec.structs.asdict(StageOptions()), **options})
    assert stage.stop_link is not None
    link = stage.stop_link(url, timeout_s=timeout_s, look_hz=look_hz, clock=clock)
    _require_members(link, StopLink, f"stage device '{name}': {type(link).__name__}")
    return link


def _require_members(thing: object, protocol: type, who: str) -> None:
    """Refuse what lacks a member of a protocol."""
    names = {
        name for line in protocol.__mro__ for name in (*vars(line), *vars(line).get("__annotations__", {}))
    }
    if lacking := sorted(name for name in names if not name.startswith("_") and not hasattr(thing, name)):
        raise DeviceError(
            f"{who} has no {', no '.join(lacking)};"
            " see palp_core.palpation.devices.protocols for what its kind can do"
        )


def _converted(where: str, value: Any, wanted: Any) -> Any:
    """Return a value as the type of its parameter; a whole number, as YAML reads digits, may be a text."""
    try:
        return msgspec.convert(value, wanted)
    except msgspec.ValidationError as error:
        with suppress(msgspec.ValidationError):
            return msgspec.convert(_digits_as_text(value), wanted)
        raise DeviceError(f"{where} = {value!r}: {in_words(error)}") from error
    except TypeError:  # a type that is not plain data, as an array is
        return value


def _digits_as_text(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_digits_as_text(item) for item in value]
    return str(value) if type(value) is int else value
