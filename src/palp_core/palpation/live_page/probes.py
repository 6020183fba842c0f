"""The belief of the trial under way: posterior now, gain and entropy after each of its palpations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec


class JudgedProbe(msgspec.Struct, frozen=True):
    """What is believed after a palpation.

    Attributes:
        iteration: Which palpation of the trial.
        gain_bits: Information gained over the flat prior, the sum of eq. (8).
        entropy_bits: What is still unknown.
    """

    iteration: int
    gain_bits: float
    entropy_bits: float


class TrialBelief:
    """The trial under way.

    Attributes:
        trial: Its number; None before the first.
        estimating: Whether it is one of estimation.
        depths_mm: What the belief is about.
        posterior: Now, within a sweep too where the estimator tells.
        within_sweep: Whether that is of a sweep under way.
        verdict: Of the last palpation.
        probes: One for each palpation.
    """

    def __init__(self) -> None:
        self.trial: int | None = None
        self.estimating = False
        self.depths_mm: list[float] = []
        self.posterior: list[float] = []
        self.within_sweep = False
        self.verdict = ""
        self.probes: list[JudgedProbe] = []

    def begin(self, trial: dict[str, Any]) -> None:
        """Take a ``Trial``."""
        if trial["trial"] == self.trial:
            return
        self.trial, self.estimating = trial["trial"], trial["phase"] == "estimation"
        self.posterior, self.probes, self.verdict = [], [], ""
        self.within_sweep = False

    def believe(self, belief: dict[str, Any]) -> None:
        """Take a ``Belief``."""
        self.begin({"trial": belief["trial"], "phase": "estimation"})
        self._show(belief)
        self.within_sweep, self.verdict = False, belief["verdict"]
        if all(probe.iteration != belief["iteration"] for probe in self.probes):
            gain = sum(belief["gain"]) / math.log(2.0)
            self.probes.append(JudgedProbe(belief["iteration"], gain, entropy_bits(belief["posterior"])))

    def look(self, outlook: dict[str, Any]) -> None:
        """Take an ``Outlook``: what the sweep under way says."""
        if outlook["trial"] == self.trial and outlook["iteration"] > len(self.probes):
            self._show(outlook)
            self.within_sweep = True

    def _show(self, message: dict[str, Any]) -> None:
        self.depths_mm = [round(1e3 * depth_m, 6) for depth_m in message["depths_m"]]
        self.posterior = list(message["posterior"])


def entropy_bits(probabilities: Sequence[float]) -> float:
    """Return Shannon's entropy.

    >>> entropy_bits([0.5, 0.25, 0.25, 0.0])
    1.5
    """
    return -sum(p * math.log2(p) for p in probabilities if p > 0.0) + 0.0
