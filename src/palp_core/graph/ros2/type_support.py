"""Message types for rclpy without a compiler: name and hash of a type, made while the bridge runs.

Only bytes (CDR) go through such a type, made and read by palp: rclpy asks it for nothing but its name, its
hash and its description. ROS 2's own nodes see the real type. Made for Fast DDS, whose support has this form
(ROS 2's ``rosidl_runtime_c`` and ``rosidl_typesupport_fastrtps_c``); an installed type is taken as it is.
"""

from __future__ import annotations

import ctypes
from importlib import import_module
from typing import Any

from palp_core.errors import GraphError
from palp_core.graph.bag.ros2.definitions import Definitions

_IDENTIFIER = b"rosidl_typesupport_fastrtps_c"
_UNBOUNDED = b"\0"
_HASH_BYTES = 32
_VERSION = 1


class _Text(ctypes.Structure):
    _fields_ = [("data", ctypes.c_char_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t)]


class _Several(ctypes.Structure):
    _fields_ = [("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t)]


class _Description(ctypes.Structure):
    """A type's name, fields, and the types that they need; without fields, for which the hash stands."""

    _fields_ = [("name", _Text), ("fields", _Several), ("referenced", _Several)]


class _Hash(ctypes.Structure):
    _fields_ = [("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * _HASH_BYTES)]


_Convert = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)
_Size = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)
_LargestSize = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.POINTER(ctypes.c_char))
_Get = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)


class _Callbacks(ctypes.Structure):
    _fields_ = [
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("serialize", _Convert),
        ("deserialize", _Convert),
        ("size", _Size),
        ("largest_size", _LargestSize),
        ("key", ctypes.c_void_p),
    ]


class _Support(ctypes.Structure):
    _fields_ = [
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("handle", ctypes.c_void_p),
        ("hash", _Get),
        ("description", _Get),
        ("sources", _Get),
    ]


_kept: dict[str, tuple[type, Any]] = {}
"""Types by name, with all that rclpy holds pointers to: for as long as the process lives."""


def message_type(definitions: Definitions, name: str) -> type:
    """Return the class by which rclpy publishes and reads a type's bytes: an installed one, else a made one.

    Raises:
        GraphError: None is installed, and the middleware is another than Fast DDS.
    """
    package, _, title = name.split("/")
    try:
        installed: type = getattr(import_module(f"{package}.msg"), title)
    except (ImportError, AttributeError):
        from rclpy.utilities import get_rmw_implementation_identifier

        rmw = get_rmw_implementation_identifier()
        if not rmw.startswith("rmw_fastrtps"):
            raise GraphError(
                f"{name} is not installed for Python, and with {rmw} it must be: build {package} and source "
                "its workspace, or set RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
            ) from None
        return _made(definitions, name)
    return installed


def _made(definitions: Definitions, name: str) -> type:
    if name not in _kept:
        support, kept = _support(definitions, name)
        new = ctypes.pythonapi.PyCapsule_New
        new.restype, new.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
        unused = object()  # rclpy wants them there; for bytes it calls none of them
        body = {
            "_TYPE_SUPPORT": new(ctypes.addressof(support), None, None),
            **dict.fromkeys(("_CREATE_ROS_MESSAGE", "_DESTROY_ROS_MESSAGE"), unused),
            **dict.fromkeys(("_CONVERT_FROM_PY", "_CONVERT_TO_PY"), unused),
            "__import_type_support__": classmethod(lambda _: None),
        }
        title = name.rpartition("/")[2]
        made = type(f"Metaclass_{title}", (type,), body)(title, (), {})
        _kept[name] = (made, (support, kept))
    return _kept[name][0]


def _support(definitions: Definitions, name: str) -> tuple[_Support, Any]:
    """Return a type's support, and what it points to."""
    package, _, title = name.split("/")
    digest = bytes.fromhex(definitions.store.hash_rihs01(name).partition("_")[2])
    hashed = _Hash(_VERSION, (ctypes.c_uint8 * _HASH_BYTES)(*digest))
    text = name.encode()
    description = _Description(_Text(text, len(text), len(text) + 1), _Several(), _Several())
    sources = _Several()

    def largest(bounds: Any) -> int:
        bounds[0] = _UNBOUNDED
        return 0

    callbacks = _Callbacks(
        f"{package}::msg".encode(),
        title.encode(),
        _Convert(lambda _message, _cdr: False),  # of objects: there are none
        _Convert(lambda _cdr, _message: False),
        _Size(lambda _message: 0),
        _LargestSize(largest),
        None,
    )
    library = ctypes.CDLL("librosidl_runtime_c.so")
    support = _Support(
        _IDENTIFIER,
        ctypes.cast(ctypes.pointer(callbacks), ctypes.c_void_p),
        ctypes.cast(library.get_message_typesupport_handle_function, ctypes.c_void_p),
        _Get(lambda _support: ctypes.addressof(hashed)),
        _Get(lambda _support: ctypes.addressof(description)),
        _Get(lambda _support: ctypes.addressof(sources)),
    )
    return support, (hashed, text, description, sources, callbacks, library)


def forget_error() -> None:
    """Take back what Fast DDS notes when it finds no introspection of a made type, and does without.

    Left as it is, the next error of any kind is told with pages about this one.
    """
    ctypes.CDLL("librcutils.so").rcutils_reset_error()
