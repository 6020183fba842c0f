"""Probe where the next reading is expected to tell most about the depth."""

from __future__ import annotations

import numpy as np

from nodes.policy import Policy
from palp_core import Params
from palp_core.perception import policies
from palp_core.perception.offsets import landing_model
from palp_core.perception.policies_informed import InformationGainLatent
from palp_core.units import Millimetres


class InformationParams(Params):
    """Set in the launch file.

    ``ring_sd_mm`` is the spread of a landing that the policy knows to stay until the ring moves; 0 takes all
    readings for independent. ``per_second`` weighs bits by the time of move and sweep. ``start_mm`` is where
    it probes as long as nothing was learnt (assumed: the stiffest).
    """

    ring_sd_mm: Millimetres = 0.17
    per_second: bool = False
    start_mm: Millimetres = 16.0


class Information(Policy):
    """Greedy, one probe ahead, with what training left and what stays in the trial."""

    params: InformationParams

    def choose(self) -> policies.Policy:
        kept = self.state.primitives
        if not kept:
            return policies.Fixed(round(self.params.start_mm * 1e-3, 9))
        shape = (len(kept["depths_m"]), len(kept["rings_m"]))
        rings_m = np.array(kept["rings_m"])
        mean, sd = (np.reshape(kept[name], shape) for name in ("mean_n_m", "sd_n_m"))
        model = landing_model(mean, sd, rings_m, self.params.ring_sd_mm * 1e-3)
        state = self.state
        levels = [int(np.argmin(np.abs(rings_m - ring_m))) for ring_m in state.tried_m]
        return InformationGainLatent(
            model,
            tuple(rings_m.tolist()),
            per_second=self.params.per_second,
            history=tuple(zip(levels, state.landed, state.readings_n_m, strict=False)),
        )

    def refreshed(self) -> policies.Policy:
        return self.choose()
