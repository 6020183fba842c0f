"""From rounds to figures: quantiles, ratios of each round, their median and spread."""

from __future__ import annotations

import os
import platform
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from wire_bench.contenders import Outcome
from wire_bench.plan import Phase

__all__ = ["PALP", "QUANTILES", "Measure", "Results"]

QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
PALP = "palp"
OWN_TRIP = "palp's own trip"
"""What a call of a service is compared with: there and back by two topics."""


@dataclass(frozen=True)
class Measure:
    """One thing to measure: its name and the phase that measures it."""

    name: str
    phase: Phase


@dataclass
class Results:
    """Figures of every round, by contender and measure.

    Attributes:
        rounds: ``rounds[contender][measure]`` is a list of figures, one a round.
        lost: Messages that did not arrive, by contender.
    """

    rounds: dict[str, dict[str, list[dict[str, float]]]] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    startup_s: list[float] = field(default_factory=list)

    def add(self, contender: str, measures: list[Measure], outcome: Outcome) -> None:
        """Enter one round."""
        self.lost[contender] = self.lost.get(contender, 0) + outcome.lost
        for at, measure in enumerate(measures):
            if measure.phase.kind == "search":
                found = {"rate_hz": outcome.rates_hz[at]}
            else:
                times_s = (outcome.latencies_s if measure.phase.kind == "stream" else outcome.trips_s)[at]
                found = {f"{name}_s": float(np.quantile(times_s, q)) for name, q in QUANTILES.items()}
                found["cpu_s"] = outcome.cpu_s[at]
            self.rounds.setdefault(contender, {}).setdefault(measure.name, []).append(found)

    def summary(self) -> dict[str, Any]:
        """Return ``[measure][figure][contender]``: its value, and palp over it, each as a spread."""
        measures: dict[str, Any] = {}
        for measure, figure, contender, values, ratios in self._rows():
            row = measures.setdefault(measure, {}).setdefault(figure, {}).setdefault(contender, {})
            row |= {"value": spread(values)} | ({"palp_over_it": spread(ratios)} if ratios else {})
        machine = f"{os.cpu_count()} cores, Linux {platform.release()}, load {os.getloadavg()[0]:.1f}"
        startup = {"startup_10_nodes_s": spread(self.startup_s)} if self.startup_s else {}
        return {"measures": measures, **startup, "lost": self.lost, "machine": machine}

    def table(self) -> str:
        """Return a line for each figure of each contender, and what was lost."""
        lines = [f"{'measure':16} {'contender':16} {'median (least to largest)':36} palp over it"]
        for measure, figure, contender, values, ratios in self._rows():
            unit, scale, digits = ("Hz", 1.0, 0) if figure == "rate_hz" else ("us", 1e6, 0)
            value = written([value * scale for value in values], digits, unit)
            name = f"{measure} {figure.removesuffix('_s').removesuffix('_hz')}"
            over = written(ratios, 2) if ratios else ""
            lines.append(f"{name:16} {contender:16} {value:36} {over}".rstrip())
        if self.startup_s:
            lines.append(f"ten nodes, to the first message at the end: {written(self.startup_s, 2, 's')}")
        return "\n".join([*lines, f"lost: {self.lost}"])

    def _rows(self) -> Iterator[tuple[str, str, str, list[float], list[float]]]:
        """Yield measure, figure, contender, its values and palp's over them, round by round."""
        for measure, rounds in self.rounds.get(PALP, {}).items():
            for figure in rounds[0]:
                mine = self._values(PALP, measure, figure)
                for contender in self.rounds:
                    theirs = self._values(contender, measure, figure)
                    if theirs:
                        ratios = [] if contender == PALP else over(mine, theirs)
                        yield measure, figure, contender, theirs, ratios
                trip = self._values(PALP, "trip", figure) if measure == "call" else []
                if trip:
                    yield measure, figure, OWN_TRIP, trip, over(mine, trip)

    def _values(self, contender: str, measure: str, figure: str) -> list[float]:
        return [found[figure] for found in self.rounds.get(contender, {}).get(measure, [])]


def over(mine: list[float], theirs: list[float]) -> list[float]:
    """Return the ratio of each round; none if the other could not do it at all, a rate of 0."""
    return [a / b for a, b in zip(mine, theirs, strict=True)] if min(theirs) > 0.0 else []


def spread(values: list[float]) -> dict[str, float]:
    """Return the median over the rounds, the least and the largest."""
    return {"median": statistics.median(values), "least": min(values), "largest": max(values)}


def written(values: list[float], digits: int, unit: str = "") -> str:
    """Write a median with its spread."""
    middle, least, largest = (f"{value:,.{digits}f}" for value in spread(values).values())
    return f"{middle}{f' {unit}' if unit else ''} ({least} to {largest})"
