"""When bytes arrived, as the kernel has stamped them: an emulator that is late itself is no late wire."""

import socket
import struct
import time

_SO_TIMESTAMPNS = 35  # of asm-generic/socket.h; the module `socket` does not name it
_TIMESPEC = struct.Struct("@qq")
_OLDEST_NS = 1_000_000_000  # an older stamp says that the wall clock was set, not that bytes waited


def stamp_arrivals(connection: socket.socket) -> None:
    """Have the kernel stamp what arrives from now on."""
    connection.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def receive(connection: socket.socket, size: int) -> tuple[bytes, int]:
    """Return what is there and the monotonic time in ns at which its last byte arrived.

    Raises:
        OSError: The connection is lost.
    """
    data, ancillary, _, _ = connection.recvmsg(size, socket.CMSG_SPACE(_TIMESPEC.size))
    now_ns, wall_ns = time.monotonic_ns(), time.clock_gettime_ns(time.CLOCK_REALTIME)
    for level, kind, stamp in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(stamp) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(stamp)
            age_ns = wall_ns - (seconds * 1_000_000_000 + nanoseconds)
            if 0 <= age_ns < _OLDEST_NS:
                return data, now_ns - age_ns
    return data, now_ns
