"""A simulated world by name or file: every number by which it is less tidy than the paper's own design.

::

    base: lab
    texture_sd_n_m: 1.0e-4
    friction_mounting_sd: 0.1

``base`` is ``paper`` (the default, in which all is 0) or ``lab``; what is left out has its value there.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from palp_core.errors import MechanicsError, OutOfRange
from palp_core.palpation.mechanics.limits import require
from palp_core.palpation.mechanics.scene.file import read_mapping


def _quantity(unit: str, high: float, basis: str, low: float = 0.0, *, latent: bool = False) -> float:
    """Declare a parameter that is 0 in the paper's design: unit, bounds, basis, whether it moves latents."""
    about = {"unit": unit, "low": low, "high": high, "basis": basis, "latent": latent}
    made: float = field(default=0.0, metadata=about)
    return made


@dataclass(frozen=True, kw_only=True)
class WorldModel:
    """What differs between sweeps, mountings, phantoms and sessions, SI; 0 is the paper's own design.

    Spreads are standard deviations of normal numbers, relative where they have the unit 1. :func:`basis`
    has the source of each value of a world.

    Attributes:
        name: ``paper``, ``lab``, or the file that it was read from.
        run_in: 1: a sweep begins with an upright probe whose tip sticks to the gel until the joint lags
            enough to drag it. 0: it begins with the joint lagging already.
        texture_sd_n_m: Of the torque that the surface adds along a mounting's track.
        texture_length_m: Distance over which its correlation falls to 0.61: exp(-x^2 / 2 l^2).
        texture_reversing_share: Share of its variance that changes sign with the sweep's direction, as
            friction does; the rest is shape.
        friction_mounting_sd: Of the friction, between mountings (surface cleaned, powdered, aged).
        friction_wear_per_m: Relative change of the friction per metre of path.
        bead_along_specimen_sd_m: Of the bead's place along the path, between phantoms (casting).
        bead_along_mounting_sd_m: The same, between mountings (set down by hand).
        bead_beside_specimen_sd_m: Of the bead's distance beside the path, between phantoms.
        bead_beside_mounting_sd_m: The same, between mountings.
        modulus_batch_sd: Of the gel's modulus, between sessions (batch mixed, temperature).
        modulus_specimen_sd: Of the gel's modulus, between phantoms of a batch (mixed, cured).
        layer_modulus_sd: Of the modulus of the layer over the bead against that of the layer under it,
            between phantoms: the two are poured one after the other.
        indentation_session_sd_m: Of the nominal indentation, between sessions (zero found by hand); the
            height of a mounting comes on top.
        tip_radius_session_sd_m: Of the ball's radius, between sessions (what is printed or turned).
        tip_wear_per_m: Change of the ball's radius per metre of path; a worn ball is blunter.
        bias_walk_n_m_per_sqrt_s: Random walk of the sensor's zero, added to the trace.
        tare_sd_n_m: Of the zero that a tare leaves.
        static_friction_excess: Static friction over sliding friction, minus 1: what stick-slip is made of.
    """

    name: str = "paper"
    run_in: float = _quantity("1", 1.0, "mechanics: no lag without drag; a probe is lowered upright")
    texture_sd_n_m: float = _quantity("N m", 5e-3, "assumed: cast silicone adds 0.05 to 0.5 N mm")
    texture_length_m: float = _quantity("m", 0.05, "assumed: about the contact's radius, which smooths it")
    texture_reversing_share: float = _quantity("1", 1.0, "assumed: half friction, half shape")
    friction_mounting_sd: float = _quantity(
        "1", 0.3, "assumed: a surface that is cleaned by hand", latent=True
    )
    friction_wear_per_m: float = _quantity(
        "1/m", 0.01, "assumed: a twentieth in 100 m, a session", -0.01, latent=True
    )
    bead_along_specimen_sd_m: float = _quantity(
        "m", 5e-3, "assumed: a bead laid by hand on cured gel", latent=True
    )
    bead_along_mounting_sd_m: float = _quantity(
        "m", 5e-3, "assumed: a phantom set down against a stop", latent=True
    )
    bead_beside_specimen_sd_m: float = _quantity("m", 5e-3, "assumed, as for `along`", latent=True)
    bead_beside_mounting_sd_m: float = _quantity("m", 5e-3, "assumed, as for `along`", latent=True)
    modulus_batch_sd: float = _quantity(
        "1", 0.2, "assumed: two parts weighed to a percent, cured for a day", latent=True
    )
    modulus_specimen_sd: float = _quantity("1", 0.2, "assumed: one batch, several moulds", latent=True)
    layer_modulus_sd: float = _quantity(
        "1", 0.3, "assumed; how it is felt: Gao, Chiu and Lee 1992", latent=True
    )
    indentation_session_sd_m: float = _quantity("m", 1e-3, "assumed: a touch found by hand or by force")
    tip_radius_session_sd_m: float = _quantity("m", 5e-4, "assumed: tolerance of a printed ball", latent=True)
    tip_wear_per_m: float = _quantity(
        "m/m", 1e-4, "assumed: 0.02 mm in 100 m; silicone wears plastic", -1e-4, latent=True
    )
    bias_walk_n_m_per_sqrt_s: float = _quantity("N m/s^0.5", 1e-3, "assumed: a step of resolution in 10 s")
    tare_sd_n_m: float = _quantity(
        "N m", 1e-3, "assumed: what half a second of samples leaves, and hysteresis"
    )
    static_friction_excess: float = _quantity("1", 1.0, "assumed: powdered silicone; dry, 0.1 to 0.5")

    def __post_init__(self) -> None:
        for item in _quantities():
            bounds = item.metadata
            advice = f"give it in {bounds['unit']}" if bounds["unit"] != "1" else "give a share, as in 0.05"
            require(item.name, getattr(self, item.name), bounds["low"], bounds["high"], advice)
        if self.run_in not in (0.0, 1.0):
            raise OutOfRange("run_in", f"{self.run_in:g} is neither 0 nor 1; the tip sticks at first or not")
        if self.texture_sd_n_m > 0.0 and self.texture_length_m < LEAST_LENGTH_M:
            raise OutOfRange(
                "texture_length_m",
                f"a texture needs a correlation length of at least {LEAST_LENGTH_M:g} m, not "
                f"{self.texture_length_m:g}; the contact smooths what is finer",
            )

    @cached_property
    def plain(self) -> bool:
        """Whether it is the paper's own design: nothing is on, whatever its name."""
        return all(getattr(self, item.name) == 0.0 for item in _quantities())

    @cached_property
    def shifts_latents(self) -> bool:
        """Whether sweeps differ by more than the ring's landing and the surface's height."""
        return any(getattr(self, item.name) != 0.0 for item in _quantities() if item.metadata["latent"])

    def values(self) -> dict[str, float]:
        """Return its parameters by name, SI."""
        return {item.name: getattr(self, item.name) for item in _quantities()}


def _quantities() -> list[dataclasses.Field[float]]:
    return [item for item in dataclasses.fields(WorldModel) if item.metadata]


LEAST_LENGTH_M = 1.5e-3
"""Shortest correlation length of a texture: half of the contact's radius, which smooths what is finer."""

PAPER = WorldModel()
"""The paper's own design: nothing but the ring's error and the height of a mounting."""

LAB = WorldModel(
    name="lab",
    run_in=1.0,
    texture_sd_n_m=0.2e-3,
    texture_length_m=3e-3,
    texture_reversing_share=0.5,
    friction_mounting_sd=0.05,
    friction_wear_per_m=5e-4,
    bead_along_specimen_sd_m=0.5e-3,
    bead_along_mounting_sd_m=0.5e-3,
    bead_beside_specimen_sd_m=0.5e-3,
    bead_beside_mounting_sd_m=0.5e-3,
    modulus_batch_sd=0.05,
    modulus_specimen_sd=0.03,
    layer_modulus_sd=0.05,
    indentation_session_sd_m=0.1e-3,
    tip_radius_session_sd_m=0.05e-3,
    tip_wear_per_m=2e-7,
    bias_walk_n_m_per_sqrt_s=5e-6,
    tare_sd_n_m=5e-6,
    static_friction_excess=0.05,
)
"""All of it on. A texture of 0.2 N mm is in the middle (geometric) of 0.05 to 0.5 N mm: thirteen steps of the
sensor, a fifth of the difference between 4 and 8 mm of gel at a ring of 16 mm."""

WORLDS = {world.name: world for world in (PAPER, LAB)}


def basis() -> dict[str, str]:
    """Return on what each parameter of a world rests, by name: a source, or the word assumed."""
    return {item.name: str(item.metadata["basis"]) for item in _quantities()}


def units() -> dict[str, str]:
    """Return the unit of each parameter, by name."""
    return {item.name: str(item.metadata["unit"]) for item in _quantities()}


def read_world(name: str | Path) -> WorldModel:
    """Return a world by name, or from a YAML file."""
    if str(name) in WORLDS:
        return WORLDS[str(name)]
    if not Path(name).suffix and not Path(name).exists():
        raise MechanicsError(f"no world '{name}'; use {' or '.join(WORLDS)}, or name a YAML file")
    root = read_mapping(name, "world")
    known = [item.name for item in _quantities()]
    fields = root.items("the world", ("base", *known))
    base = fields.pop("base").text if "base" in fields else "paper"
    if base not in WORLDS:
        at = root.items("the world")["base"]
        raise at.error(f"base must be {' or '.join(WORLDS)}, not '{base or 'a collection'}'")
    given: dict[str, Any] = {key: node.number(key) for key, node in fields.items()}
    try:
        return replace(WORLDS[base], name=str(name), **given)
    except OutOfRange as error:
        raise fields.get(error.quantity, root).error(str(error)) from error
