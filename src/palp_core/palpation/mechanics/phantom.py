"""What is touched: a slab of soft gel on a rigid floor, with or without a rigid bead in it."""

from dataclasses import dataclass

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.limits import require


@dataclass(frozen=True, kw_only=True)
class Bead:
    """A rigid sphere bonded in the gel: the stand-in for a nodule.

    Attributes:
        depth_m: From the exposed surface to the top of the bead.
        radius_m: Half of the published 15 mm diameter.
        beside_m: Distance from the path of the sweep to the bead's centre, seen from above.

    Raises:
        OutOfRange: A length is out of range or not a number.
    """

    depth_m: float
    radius_m: float = 0.0075
    beside_m: float = 0.0

    def __post_init__(self) -> None:
        require("depth_m", self.depth_m, 1e-6, 1.0, "give the metres of gel over the bead, as in 0.004")
        require("radius_m", self.radius_m, 1e-6, 1.0, "give the bead's radius in metres, as in 0.0075")
        require("beside_m", self.beside_m, 0.0, 1.0, "give metres from the path, as in 0.003")

    @property
    def centre_depth_m(self) -> float:
        """Depth of the bead's centre under the exposed surface."""
        return self.depth_m + self.radius_m


@dataclass(frozen=True, kw_only=True)
class Phantom:
    """An elastic slab bonded to a rigid floor.

    Attributes:
        bead: The bead under offset 0, or None for bare gel.
        modulus_pa: Young's modulus of the gel; assumed (soft silicones lie between 5 and 30 kPa).
        poisson: Poisson's ratio; assumed, nearly incompressible.
        height_m: Thickness of the slab; published.

    Raises:
        OutOfRange: A value is not a number or not physical, or the bead reaches below the floor.
    """

    bead: Bead | None = None
    modulus_pa: float = 20e3
    poisson: float = 0.49
    height_m: float = 0.030

    def __post_init__(self) -> None:
        require("modulus_pa", self.modulus_pa, 1.0, 1e9, "give Young's modulus in Pa, as in 20e3")
        require("poisson", self.poisson, 0.0, 0.5, "a passive isotropic gel lies between 0 and 0.5")
        require("height_m", self.height_m, 1e-6, 10.0, "give the slab's thickness in metres, as in 0.030")
        if self.bead is not None:
            lowest_m = self.bead.depth_m + 2.0 * self.bead.radius_m
            if lowest_m > self.height_m * (1.0 + 1e-12):
                raise OutOfRange(
                    "depth_m",
                    f"the bead reaches {lowest_m:g} m down, below the floor at {self.height_m:g} m; "
                    "use a smaller depth or bead, or a higher slab",
                )

    @property
    def shear_modulus_pa(self) -> float:
        """Shear modulus of the isotropic gel, E / (2 (1 + nu))."""
        return self.modulus_pa / (2.0 * (1.0 + self.poisson))

    def scene(self, tip_radius_m: float | None = None) -> dict[str, float]:
        """Return the quantities by which a contact rung is chosen; bare gel names no depth.

        Args:
            tip_radius_m: Radius of the ball that touches it, if that is known: it is a quantity too, and so
                is the gel over the bead in such radii, ``depth_per_tip``.
        """
        scene = {"modulus_pa": self.modulus_pa, "poisson": self.poisson, "height_m": self.height_m}
        scene["beads"] = 0.0 if self.bead is None else 1.0
        if self.bead is not None:
            scene |= {"depth_m": self.bead.depth_m, "bead_radius_m": self.bead.radius_m}
            scene["beside_m"] = self.bead.beside_m
        if tip_radius_m is not None:
            scene["tip_radius_m"] = tip_radius_m
            if self.bead is not None:
                scene["depth_per_tip"] = self.bead.depth_m / tip_radius_m
        return scene
