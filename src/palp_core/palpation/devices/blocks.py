"""How long a block of samples may be, and from which length on it is late for its reader.

A sensor's samples travel in blocks, since a message costs the same for one sample as for fifty. A block is
published when its last sample is there.
"""

from typing import Literal, NamedTuple

from palp_core.errors import DeviceError

Stream = Literal["torque", "sweep", "emg", "load"]


LONGEST_S = 1.0
"""No block is longer: of what came before, the estimator keeps a second for a sweep, the safety node for a
trip."""


class Wanted(NamedTuple):
    """What a stream's reader needs.

    Attributes:
        age_s: How old a sample may be when it is acted upon, in s; assumed.
        under_way_s: On the wall clock, from a block's last sample to what comes of it, with a third over the
            longest that was seen. In simulated time it is nothing.
    """

    age_s: float
    under_way_s: float


WANTED: dict[Stream, Wanted] = {
    # 27 ms were seen with blocks of 20, and the stage is long on its way back then
    "torque": Wanted(0.05, 0.0093),
    # torque that is read when its sweep is over; no block is longer
    "sweep": Wanted(LONGEST_S, 0.0093),
    # the same way; a burst lasts tenths of a second
    "emg": Wanted(0.1, 0.0093),
    # 4.4 ms were seen with a report each 1 ms; wanted are 0.15 mm of a sweep at 20 mm/s
    "load": Wanted(0.0075, 0.0046),
}
"""By what travels in the blocks."""


def check_block(block_samples: int, rate_hz: float) -> None:
    """Refuse blocks that are longer than :data:`LONGEST_S`.

    Raises:
        DeviceError: They are.
    """
    length_s = block_samples / rate_hz
    if length_s > LONGEST_S:
        most = max(1, int(LONGEST_S * rate_hz))
        raise DeviceError(
            f"a block of {block_samples} samples at {rate_hz:g} Hz lasts {length_s:g} s, and its samples are "
            f"known at its end; give {most} at most ({LONGEST_S:g} s)"
        )


def longest_s(stream: Stream, *, wall_clock: bool) -> float:
    """Return how long a stream's blocks can be so that none is late for its reader, in s."""
    wanted = WANTED[stream]
    return wanted.age_s - (wanted.under_way_s if wall_clock else 0.0)


def late_blocks(stream: Stream, length_s: float, *, wall_clock: bool) -> str:
    """Return a warning if a stream's blocks are longer than its reader can wait; "" if they are not."""
    wanted, most_s = WANTED[stream], longest_s(stream, wall_clock=wall_clock)
    if length_s <= most_s * (1.0 + 1e-9):
        return ""
    age_s = wanted.age_s + length_s - most_s
    return (
        f"the {stream} comes in blocks of {length_s:.3g} s: a sample is up to {age_s:.3g} s old when it is "
        f"acted upon, and {wanted.age_s:g} s are wanted"
    )
