"""What differs each time a phantom is put back under the probe."""

from dataclasses import dataclass

import numpy as np

from palp_core.palpation.devices.limits import check_range


@dataclass(frozen=True)
class Mounting:
    """One mounting: the phantom's surface above its nominal height, and its slope along the sweep.

    Attributes:
        height_m: Offset of the height; positive means deeper indentation.
        tilt_rad: Slope; positive means rising along y.
    """

    height_m: float
    tilt_rad: float


@dataclass(frozen=True)
class MountVariation:
    """Spread of the mountings, normal and independent.

    Attributes:
        height_sd_m: Standard deviation of the height, drawn anew at each remount.
        tilt_sd_rad: Standard deviation of the tilt, drawn anew at each remount.

    Raises:
        DeviceError: A spread is negative or not finite.
    """

    height_sd_m: float = 0.0
    tilt_sd_rad: float = 0.0

    def __post_init__(self) -> None:
        check_range("mount", "height_sd_m", self.height_sd_m, 0.0, 0.1)
        check_range("mount", "tilt_sd_rad", self.tilt_sd_rad, 0.0, 0.5)

    def draw(self, rng: np.random.Generator) -> Mounting:
        """Return a new mounting; two numbers are drawn, whatever the spreads are."""
        height, tilt = rng.standard_normal(2)
        return Mounting(self.height_sd_m * float(height), self.tilt_sd_rad * float(tilt))


ALWAYS_THE_SAME = MountVariation()
"""The phantom never differs: the case the paper's filter takes for granted."""

BY_HAND = MountVariation(height_sd_m=0.1e-3, tilt_sd_rad=2e-3)
"""Set down by hand against a stop: 0.1 mm and 2 mrad, both assumed."""
