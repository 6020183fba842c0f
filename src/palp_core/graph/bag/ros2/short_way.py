"""Readers and writers of ROS 2's bytes (CDR), each written out as a Python function for its type.

They take and make the same maps and the same bytes as :mod:`palp_core.graph.bag.ros2.values`, in a fraction
of the time, as long as nothing is the matter: of anything else (big-endian bytes, a value of another kind)
they raise one of :data:`OTHERWISE`, and the long way, which says what it is, has its turn.

What lies side by side is packed and unpacked at once. A number lies where its size divides its place, counted
from the end of the four bytes of encapsulation; after a text or a list that is known only while reading.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from palp_core.graph.bag.ros2.definitions import BYTES, PACKED, Definitions, FieldType

OTHERWISE = (ValueError, TypeError, LookupError, AttributeError, OverflowError, struct.error)
HEAD = b"\0\1\0\0"
_BEFORE = len(HEAD)
_FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "float32": "f", "float64": "d",
    "int8": "b", "int16": "h", "int32": "i", "int64": "q",
    "uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q",
}  # fmt: skip
_LARGEST = 8
_PAD_BYTES = 3
"""So many bytes may follow a message, as some writers fill up to a multiple of four."""


class _Unsupported(Exception):
    """A type has something that only the long way knows."""


def quick_reader(definitions: Definitions, name: str) -> Callable[[bytes], dict[str, Any]] | None:
    """Return the function from a message's bytes to its map; None if only the long way knows the type."""
    try:
        code = _Reader(definitions, name)
    except _Unsupported:
        return None
    made: Callable[[bytes], dict[str, Any]] = code.made("read")
    return made


def quick_writer(definitions: Definitions, name: str) -> Callable[[Mapping[str, Any]], bytes] | None:
    """Return the function from a map to the message's bytes; None if only the long way knows the type."""
    try:
        code = _Writer(definitions, name)
    except _Unsupported:
        return None
    made: Callable[[Mapping[str, Any]], bytes] = code.made("write")
    return made


class _Code:
    """A function that is being written: its lines, the names it knows, and numbers that lie side by side."""

    def __init__(self, definitions: Definitions) -> None:
        self.definitions = definitions
        self.lines: list[str] = []
        self.known: dict[str, Any] = {
            "HEAD": HEAD,
            "np": np,
            "pack": struct.pack,
            "unpack": struct.unpack_from,
        }
        self.count = 0
        self.indent = "    "
        self.begin(_LARGEST)

    def begin(self, aligned: int) -> None:
        """Begin a run of numbers at a place that a number of so many bytes divides; 0: at any."""
        self.aligned, self.offset, self.format = aligned, 0, ""
        self.values: list[str] = []

    def say(self, line: str) -> None:
        self.lines.append(self.indent + line)

    def name(self, stem: str) -> str:
        self.count += 1
        return f"{stem}{self.count}"

    def number(self, base: str, value: str) -> None:
        """Add a number to the run, or begin another."""
        if base not in _FORMATS:
            raise _Unsupported(base)
        size = struct.calcsize(_FORMATS[base])
        if size > self.aligned:
            self.end()
            self.align(size)
            self.begin(size)
        pad = -self.offset % size
        self.format += "x" * pad + _FORMATS[base]
        self.offset += pad + size
        self.values.append(value)

    def packer(self) -> str:
        """Return what the struct of the run is called."""
        name = self.name("run")
        self.known[name] = struct.Struct("<" + self.format)
        return name

    def end(self) -> None:
        raise NotImplementedError

    def align(self, size: int) -> None:
        raise NotImplementedError

    def fields(self, name: str) -> dict[str, FieldType]:
        found = self.definitions.fields(name)
        if not found:
            raise _Unsupported(name)
        return found

    def made(self, name: str) -> Any:
        exec(compile("\n".join(self.lines), f"<{type(self).__name__}>", "exec"), self.known)
        return self.known[name]


class _Reader(_Code):
    def __init__(self, definitions: Definitions, name: str) -> None:
        super().__init__(definitions)
        self.lines = ["def read(data):"]
        self.say("if data[:4] != HEAD: raise ValueError(data[:4])")
        self.say("pos = 4")
        value = self.message(name)
        self.end()
        self.say(f"if not 0 <= len(data) - pos <= {_PAD_BYTES}: raise ValueError(pos)")
        self.say(f"return {value}")

    def message(self, name: str) -> str:
        """Read a message's fields; return the expression that makes its map of them."""
        return "{" + ", ".join(f"{f!r}: {self.field(kind)}" for f, kind in self.fields(name).items()) + "}"

    def field(self, kind: FieldType) -> str:
        if kind.many:
            return self.several(kind)
        if kind.is_message:
            return self.message(kind.base)
        if kind.base == "string":
            return self.text()
        value = self.name("v")
        self.number(kind.base, value)
        return value

    def text(self) -> str:
        size, value = self.name("n"), self.name("v")
        self.number("uint32", size)
        self.end()
        self.say(f"if data[pos + {size} - 1] or not {size}: raise ValueError(pos)")
        self.say(f"{value} = str(data[pos:pos + {size} - 1], 'utf-8')")
        self.say(f"pos += {size}")
        return value

    def several(self, kind: FieldType) -> str:
        value = self.name("v")
        size = str(kind.length)
        if not kind.length:
            size = self.name("n")
            self.number("uint32", size)
        self.end()
        if kind.is_message or kind.base == "string":
            item = self.name("i")
            before, self.indent = self.indent, self.indent + "    "
            at = len(self.lines)
            one = self.field(kind.element)
            self.end()
            self.say(f"{value}.append({one})")
            self.lines[at:at] = [f"{before}{value} = []", f"{before}for {item} in range({size}):"]
            self.indent = before
            return value
        if kind.base not in _FORMATS:
            raise _Unsupported(kind.base)
        form = _FORMATS[kind.base]
        width = struct.calcsize(form)
        if width > 1:
            self.say(f"if {size}: {self.aligned_to(width)}")
        end = self.name("e")
        self.say(f"{end} = pos + {width} * {size}")
        self.say(f"if {end} > len(data): raise ValueError(pos)")
        if kind.base in BYTES or kind.base == "float64":
            self.say(f"{value} = bytes(data[pos:{end}])")
        elif kind.base in PACKED:
            self.say(f"{value} = np.frombuffer(data, '<f4', {size}, pos).astype('<f8').tobytes()")
        else:
            self.say(f"{value} = list(unpack(f'<{{{size}}}{form}', data, pos))")
        self.say(f"pos = {end}")
        return value

    def end(self) -> None:
        if self.values:
            self.say(f"{', '.join(self.values)}, = {self.packer()}.unpack_from(data, pos)")
            self.say(f"pos += {self.offset}")
        self.begin(0)

    def align(self, size: int) -> None:
        if size > 1:
            self.say(self.aligned_to(size))

    @staticmethod
    def aligned_to(size: int) -> str:
        return f"pos = (pos + {size - 1 - _BEFORE} & -{size}) + {_BEFORE}"


class _Writer(_Code):
    def __init__(self, definitions: Definitions, name: str) -> None:
        super().__init__(definitions)
        self.known["EMPTY"] = {}
        self.lines = ["def write(message):"]
        self.say("out = bytearray(HEAD)")
        self.message(name, "message")
        self.end()
        self.say("return bytes(out)")

    def message(self, name: str, given: str) -> None:
        for field, kind in self.fields(name).items():
            self.field(kind, given, field)

    def field(self, kind: FieldType, given: str, field: str) -> None:
        if kind.many:
            self.several(kind, given, field)
        elif kind.is_message:
            inner = self.name("m")
            self.say(f"{inner} = {given}.get({field!r}, EMPTY)")
            self.message(kind.base, inner)
        elif kind.base == "string":
            self.text(f"{given}.get({field!r}, '')")
        else:
            self.number(kind.base, f"{given}.get({field!r}, 0)")

    def text(self, given: str) -> None:
        value = self.name("s")
        self.say(f"{value} = {given}.encode()")
        self.number("uint32", f"len({value}) + 1")
        self.end()
        self.say(f"out += {value}")
        self.say("out += b'\\0'")

    def several(self, kind: FieldType, given: str, field: str) -> None:
        value = self.name("v")
        of_parts = kind.is_message or kind.base == "string"
        if kind.base not in _FORMATS and not of_parts:
            raise _Unsupported(kind.base)
        unit = 1 if kind.base in BYTES else 8 if kind.base in PACKED else 0
        if kind.length and not unit:
            self.say(f"{value} = {given}[{field!r}]")
        else:
            zero = self.name("zero")
            self.known[zero] = bytes(unit * kind.length) if unit else ()
            self.say(f"{value} = {given}.get({field!r}, {zero})")
        size = f"len({value})" + f" // {unit}" * (unit > 1)
        if unit:
            self.say(f"if type({value}) is not bytes or len({value}) % {unit}: raise TypeError({value})")
        else:
            self.say(f"if type({value}) not in (list, tuple): raise TypeError({value})")
        if kind.length:
            self.say(f"if {size} != {kind.length}: raise ValueError({value})")
        else:
            self.number("uint32", size)
        self.end()
        if of_parts:
            item = self.name("i")
            self.say(f"for {item} in {value}:")
            self.indent += "    "
            if kind.is_message:
                self.message(kind.base, item)
            else:
                self.text(item)
            self.end()
            self.indent = self.indent[:-4]
            return
        self.say(f"if {value}:")
        self.indent += "    "
        self.align(struct.calcsize(_FORMATS[kind.base]))
        if kind.base == "float32":
            self.say(f"out += np.frombuffer({value}, '<f8').astype('<f4').tobytes()")
        elif unit:
            self.say(f"out += {value}")
        else:
            self.say(f"out += pack(f'<{{len({value})}}{_FORMATS[kind.base]}', *{value})")
        self.indent = self.indent[:-4]

    def end(self) -> None:
        if self.values:
            self.say(f"out += {self.packer()}.pack({', '.join(self.values)})")
        self.begin(0)

    def align(self, size: int) -> None:
        if size > 1:
            self.say(f"out += bytes(-(len(out) - {_BEFORE}) % {size})")
