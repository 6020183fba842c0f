"""Settings of bursts and levels, with the defaults of the command, the node and ``emg fit-policy``.

None of it was published. The reasons are of muscles and of the RMS, none is fitted to a recording.
"""

import math
from dataclasses import dataclass, fields
from typing import Literal

from palp_core.errors import PerceptionError

MvcRule = Literal["plateau", "maximum_of_sum", "sum_of_maxima"]
"""What the MVC comes to; see :func:`palp_core.palpation.perception.emg.calibration.calibrate`."""

LevelRule = Literal["plateau", "peak"]
"""Where a peak's level is read: its top as a whole, rest taken off, or its largest value as it is."""

WINDOW_S = 0.15
"""RMS window: surface EMG scatters by 6 to 12 % of its value there, and by 18 to 20 % at 50 ms."""

LOOK_S = 0.01
"""Bursts, peaks and the MVC are looked for at steps of this time, a fifteenth of the window."""


@dataclass(frozen=True)
class BurstSettings:
    """Two thresholds with hysteresis, and what is one burst.

    Attributes:
        on_share: A burst begins this far above rest, as a share of the way from rest to MVC: half the lowest
            level of the strategy.
        off_share: It ends below this far above rest, likewise.
        rest_spreads: Both thresholds are at least this many standard deviations of the rest's envelope above
            it (``off`` half as many): what a noisy rest asks for; the usual 3 (Hodges and Bui, 1996) are
            exceeded some times a minute.
        gap_s: A burst that sinks below ``off`` for less, s, is one: fingers do not move faster than some
            five times a second.
        least_s: What is shorter, s, is dropped: an artefact of one sample lasts a whole RMS window.
        valley_share: Within a burst a peak ends where co-contraction without the power of rest sinks below
            this share of it, and another begins where it rises by as much again. The scatter of EMG is in
            proportion to its strength; that of two muscles, 8 %, takes a held contraction from 1.24 to 0.76
            at three standard deviations.
        top_share: The top of a peak, through which a parabola gives its level, is what exceeds this share of
            its largest value, rest taken off likewise.
        shelf_s: After a peak, what is held for so long without a rise, s, nothing of it below ``top_share``
            of its largest, is a peak as well: a lower level, to which no valley leads. Half a second, as of
            an MVC; a contraction that fades from 0.6 of itself stays within a quarter for as long only if it
            lasts some ten seconds. 0: none is.

    Raises:
        PerceptionError: A setting is out of range.
    """

    on_share: float = 0.05
    off_share: float = 0.025
    rest_spreads: float = 5.0
    gap_s: float = 0.1
    least_s: float = 0.2
    valley_share: float = 0.6
    top_share: float = 0.75
    shelf_s: float = 0.5

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if not (value >= 0.0 and math.isfinite(value)):
                raise PerceptionError(f"burst rule: {one.name} is {value}; it must be 0 or more, and finite")
        if not 0.0 < self.off_share <= self.on_share < 1.0:
            raise PerceptionError(
                f"burst rule: off at {self.off_share:g} and on at {self.on_share:g} of MVC above rest; need "
                "0 < off <= on < 1"
            )
        for name in ("valley_share", "top_share"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise PerceptionError(f"burst rule: {name} is {getattr(self, name):g}; it is between 0 and 1")


BURSTS = BurstSettings()
"""The defaults."""
