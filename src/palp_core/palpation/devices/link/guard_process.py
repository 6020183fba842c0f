"""A guard's process: when its owner dies, it writes the owner's last words to the link that they share.

Run as ``python -I -S guard_process.py CHANNEL LINK MS:HEX ...``: descriptors of the channel to the owner and
of the link, and what to write how long after the owner's death. It imports nothing of palp, so that it is
ready in milliseconds.
"""

import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Iterable

READY = b"r"
NAME = "palp-guard"
_LINGER_S = (
    0.1  # a connection closed with unread answers is reset, and the device may drop what it had not read
)


def guard(channel: int, link: int, last_words: Iterable[tuple[float, bytes]]) -> None:
    """Wait until the owner lets go (a byte) or is gone (none); if it is gone, speak."""
    with contextlib.suppress(OSError):  # without a name it works as well
        _write_name()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with its owner, and only after it
    os.write(channel, READY)
    try:
        released = os.read(channel, 1) != b""
    except OSError:
        released = False
    if not released:
        _speak(link, last_words)


def _write_name() -> None:
    descriptor = os.open("/proc/self/comm", os.O_WRONLY)
    os.write(descriptor, NAME.encode("ascii"))
    os.close(descriptor)


def _speak(link: int, last_words: Iterable[tuple[float, bytes]]) -> None:
    began_s = time.monotonic()
    try:
        os.set_blocking(link, False)
        for after_s, words in last_words:
            _read_until(link, began_s + after_s)
            while words:
                select.select((), (link,), ())
                words = words[os.write(link, words) :]
        outcome = "its last words were written to the device"
    except OSError as error:
        outcome = f"its last words could not be written to the device: {error}"
    with contextlib.suppress(OSError):
        os.write(2, f"[WARNING] [{NAME}]: process {_OWNER} is gone: {outcome}\n".encode())
        _read_until(link, time.monotonic() + _LINGER_S)


def _read_until(link: int, end_s: float) -> None:
    """Throw away what is answered until a time."""
    while (left_s := end_s - time.monotonic()) > 0.0:
        if select.select((link,), (), (), left_s)[0] and not os.read(link, 4096):
            raise ConnectionResetError("the device has closed the connection")


def _parsed(argument: str) -> tuple[float, bytes]:
    after_ms, _, words = argument.partition(":")
    return float(after_ms) * 1e-3, bytes.fromhex(words)


if __name__ == "__main__":
    _OWNER = os.getppid()
    guard(int(sys.argv[1]), int(sys.argv[2]), [_parsed(argument) for argument in sys.argv[3:]])
