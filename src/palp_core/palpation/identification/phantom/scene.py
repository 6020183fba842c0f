"""From stored sessions to a fitted scene: the noise, the fit, and the file that the simulation takes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import yaml

from palp_core.palpation.identification.phantom.cells import gather
from palp_core.palpation.identification.phantom.fit import PhantomFit, fit_phantom
from palp_core.palpation.mechanics.scene.scene import Scene
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.rig_noise import Component, RigNoise
from palp_core.palpation.session.recorded_sweeps import RecordedSweeps
from palp_core.palpation.session.repeatability import sample_noise

ASSUMED = RigNoise(
    sample_sd_n_m=Component(RESOLUTION_N_M),
    sweep_sd_n_m=Component(RESOLUTION_N_M),
    ring_sd_m=Component(0.3e-3 / 3.0**0.5),
    height_sd_m=Component(1e-4),
    basis="data sheet of the ring, +-0.3 mm all alike; height assumed",
)
"""How far ring and height may be off where no noise file says."""


def fit_sources(
    sessions: Sequence[RecordedSweeps], *, start: Scene | None = None, noise: RigNoise | None = None
) -> tuple[PhantomFit, Component, RigNoise]:
    """Return the fit, the noise of a sample with its interval, and the priors that were used.

    Args:
        sessions: Stored sweeps.
        start: Where the search starts, and what is not fitted; None: the default scene.
        noise: How far ring and height may be off; None: :data:`ASSUMED`.

    Raises:
        PalpError: As :func:`gather` and :func:`fit_phantom`.
    """
    given, priors = start or Scene(), noise or ASSUMED
    sample = sample_noise([sweep for session in sessions for sweep in session.sweeps])
    direction = 1.0 if given.path.to_m > given.path.from_m else -1.0
    cells = gather(
        sessions,
        from_m=given.path.from_m,
        speed_m_s=direction * given.path.speed_m_s,
        sample_sd_n_m=float(np.hypot(sample.value, RESOLUTION_N_M / 12.0**0.5)),
    )
    return fit_phantom(cells, given, priors), sample, priors


def record_of(found: tuple[PhantomFit, Component, RigNoise]) -> dict[str, Any]:
    """Return a fit's numbers, ready for JSON."""
    fit, sample, priors = found
    parameters = {name: vars(one) for name, one in fit.parameters.items()}
    parameters["sample_sd_n_m"] = {"value": sample.value, "low": sample.low, "high": sample.high}
    if fit.ring_sd_m is not None:
        parameters["ring_sd_m"] = vars(fit.ring_sd_m)
    return {
        "parameters": parameters,
        "correlation": fit.correlation.tolist(),
        "rung": fit.rung,
        "misfit": fit.misfit,
        "cells": fit.cell_count,
        "priors": {
            "ring_sd_m": priors.ring_sd_m.value,
            "height_sd_m": priors.height_sd_m.value,
            "basis": priors.basis,
        },
        "warnings": list(fit.warnings),
    }


def scene_text(found: tuple[PhantomFit, Component, RigNoise]) -> str:
    """Return the fitted scene as a file for ``palp scene`` and ``scene:=``, intervals as comments."""
    fit = found[0]
    scene = fit.scene
    bead = scene.phantom.bead
    phantom: dict[str, Any] = {
        "modulus_pa": scene.phantom.modulus_pa,
        "poisson": scene.phantom.poisson,
        "height_m": scene.phantom.height_m,
        "bead": dict(vars(bead)) if bead else "none",
    }
    content = {
        "phantom": phantom,
        "probe": dict(vars(scene.probe)),
        "path": dict(vars(scene.path)),
        "ring_m": list(scene.ring_m),
        "tolerance": {
            "output": scene.tolerance.output,
            "relative": scene.tolerance.relative,
            "strain": scene.tolerance.strain,
        },
    }
    heads = [
        f"# {name}: {one.value:.6g}, 95 % {one.low:.6g} to {one.high:.6g}"
        for name, one in fit.parameters.items()
    ]
    heads += [f"# warning: {words}" for words in fit.warnings]
    lead = f"# Fitted to {fit.cell_count} mean sweeps with rung {fit.rung}; the rest is the start's."
    return "\n".join([lead, *heads]) + "\n" + yaml.safe_dump(content, sort_keys=False)
