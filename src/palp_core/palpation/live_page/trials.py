"""The trial under way, and those so far: beliefs, what each came to, how many were right by depth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from palp_core.palpation.perception.statistics.statistics import Proportion, wilson


class JudgedProbe(msgspec.Struct, frozen=True):
    """Information that a palpation gained over the flat prior, the sum of eq. (8), and what is unknown."""

    iteration: int
    gain_bits: float
    entropy_bits: float


class TrialBelief:
    """The trial under way; ``within_sweep``: its posterior is of a sweep that is not over."""

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
        """Take an ``Outlook``: the posterior of the sweep under way."""
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


class TrialRow(msgspec.Struct, frozen=True, kw_only=True):
    """A trial of estimation that is over; lengths in mm.

    ``right``: whether the true depth is, of the known ones, the nearest to the estimate; None of a trial that
    was dropped. Before the first ``PhantomTruth`` it is None, as the depth is.
    """

    number: int
    code: str
    verdict: str
    probe_count: int
    estimate_mm: float
    depth_mm: float | None
    confidence: float
    right: bool | None


class TrialBoard:
    def __init__(self) -> None:
        self._results: dict[int, tuple[int, dict[str, Any]]] = {}
        self._mounts: list[tuple[int, dict[str, Any]]] = []
        self._depths_mm: set[float] = set()
        self._took_over: list[dict[str, Any]] = []
        self._rows: list[TrialRow] | None = None

    def result(self, stamp_ns: int, result: dict[str, Any]) -> None:
        """Take a ``TrialResult``."""
        self._results[result["trial"]] = (stamp_ns, result)
        self._rows = None

    def mounted(self, stamp_ns: int, mounted: dict[str, Any]) -> None:
        """Take a ``PhantomTruth``."""
        self._mounts.append((stamp_ns, mounted))
        self._mounts.sort(key=lambda one: one[0])
        self._depths_mm.add(_mm(mounted["depth_m"]))
        self._rows = None

    def learnt(self, depths_m: Iterable[float]) -> None:
        """Take the depths that training taught: an estimate is held against the nearest of them."""
        self._depths_mm |= {_mm(depth_m) for depth_m in depths_m}
        self._rows = None

    def took_over(self, change: dict[str, Any]) -> None:
        """Take a ``PolicyChange``."""
        self._took_over.append(change)

    def mixed_text(self) -> str:
        """Return which policies took over among these trials; "" where all are of one policy."""
        first = min(self._results, default=0)
        found = [
            f"{one['policy']} from trial {1 + sum(trial < one['trial'] for trial in self._results)} on"
            for one in self._took_over
            if (one["trial"], one["iteration"]) > (first, 1)
        ]
        return f"Not all are of one policy: {', '.join(found)}." if found else ""

    @property
    def rows(self) -> list[TrialRow]:
        if self._rows is None:
            ordered = sorted(self._results.values(), key=lambda one: one[1]["trial"])
            self._rows = [self._row(place + 1, *one) for place, one in enumerate(ordered)]
        return self._rows

    def _row(self, number: int, stamp_ns: int, result: dict[str, Any]) -> TrialRow:
        mounted: dict[str, Any] = {}
        for at_ns, one in self._mounts:
            mounted = one if at_ns < stamp_ns else mounted  # at a trial's end the next phantom is asked for
        depth_mm = _mm(mounted["depth_m"]) if mounted else None
        estimate_mm = _mm(result["estimate_m"])
        right = None
        if result["verdict"] != "dropped" and depth_mm is not None:
            right = min(self._depths_mm, key=lambda one: abs(one - estimate_mm)) == depth_mm
        return TrialRow(
            number=number,
            code=str(mounted.get("code", "")),
            verdict=result["verdict"],
            probe_count=result["probe_count"],
            estimate_mm=estimate_mm,
            depth_mm=depth_mm,
            confidence=result["confidence"],
            right=right,
        )

    @property
    def judged(self) -> list[TrialRow]:
        return [row for row in self.rows if row.right is not None]

    def accuracy(self) -> Proportion | None:
        """Return the share of right trials with Wilson's 95 % interval; None before the first."""
        return _share(self.judged)

    def by_depth(self) -> dict[float, Proportion]:
        """Return it for each depth in mm: phantoms come in blocks, so the total shows whose block it is."""
        found = {}
        for depth_mm in sorted({row.depth_mm for row in self.judged if row.depth_mm is not None}):
            share = _share([row for row in self.judged if row.depth_mm == depth_mm])
            if share is not None:
                found[depth_mm] = share
        return found


def _share(rows: list[TrialRow]) -> Proportion | None:
    return wilson(sum(row.right is True for row in rows), len(rows)) if rows else None


def _mm(metres: float) -> float:
    return round(metres * 1e3, 6)
