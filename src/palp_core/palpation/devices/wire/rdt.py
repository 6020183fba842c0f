"""ATI Net F/T's RDT datagrams: requests, records and status bits."""

import struct

import numpy as np
from numpy.typing import NDArray

from palp_core.errors import DeviceError

PORT = 49152
START, STOP = 2, 0
SATURATION = 0x00020000
RECORD_BYTES = 36
RECORD = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", (6,))])


def request(command: int, count: int = 0) -> bytes:
    """Return a request: header 0x1234, command, number of samples (0: without end)."""
    return struct.pack(">HHI", 0x1234, command, count)


def records(datagram: bytes) -> NDArray[np.void]:
    """Return the records of one or more datagrams, shape (n,).

    Raises:
        DeviceError: The length is no multiple of a record's.
    """
    if len(datagram) % RECORD_BYTES:
        raise DeviceError(f"netft: {len(datagram)} bytes are no multiple of {RECORD_BYTES}")
    return np.frombuffer(datagram, dtype=RECORD)
