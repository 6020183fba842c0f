"""From rounds to figures: quantiles, ratios of each round, their median and spread."""

from __future__ import annotations

import csv
import os
import platform
import statistics
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from wire_bench.contenders import Outcome
from wire_bench.plan import Phase

__all__ = ["RATIOS", "Measure", "Results", "machine", "write_csv"]

QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
RATIOS = {
    "p50_ratio": ("latency", "p50_s", 1.25),
    "p99_ratio": ("latency", "p99_s", 1.5),
    "p50_64k_ratio": ("64k", "p50_s", 1.15),
    "p99_64k_ratio": ("64k", "p99_s", None),
    "trip_p50_ratio": ("trip", "p50_s", None),
    "trip_p99_ratio": ("trip", "p99_s", None),
    "rate_48b_ratio": ("rate", "rate_hz", 0.6),
    "rate_1mib_ratio": ("1mib", "rate_hz", 0.9),
    "fan5_p50_ratio": ("fan", "p50_s", 1.3),
    "fan5_p99_ratio": ("fan", "p99_s", None),
}


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
        latencies_s: Every latency, for the chart.
        lost: Messages that did not arrive, by contender.
    """

    rounds: dict[str, dict[str, list[dict[str, float]]]] = field(default_factory=dict)
    latencies_s: dict[str, dict[str, list[np.ndarray[Any, np.dtype[np.float64]]]]] = field(
        default_factory=dict
    )
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
                kept = self.latencies_s.setdefault(contender, {}).setdefault(measure.name, [])
                kept.append(times_s)
            self.rounds.setdefault(contender, {}).setdefault(measure.name, []).append(found)

    def ratios(self, peer: str) -> dict[str, list[float]]:
        """Return palp over the peer of every round, by the names of ``RATIOS``."""
        return {
            name: [
                mine[figure] / theirs[figure]
                for mine, theirs in zip(self._of("palp", measure), self._of(peer, measure), strict=True)
            ]
            for name, (measure, figure, _) in RATIOS.items()
            if self._of("palp", measure) and self._of(peer, measure)
        }

    def _of(self, contender: str, measure: str) -> list[dict[str, float]]:
        return self.rounds.get(contender, {}).get(measure, [])

    def summary(self) -> dict[str, Any]:
        """Return everything as one object."""
        ratios = self.ratios("raw")
        found: dict[str, Any] = {name: statistics.median(values) for name, values in ratios.items()}
        if self.startup_s:
            found["startup_10_nodes_s"] = statistics.median(self.startup_s)
            found["startup_10_nodes_rounds_s"] = self.startup_s
        found["lost"] = self.lost.get("palp", 0)
        found["lost_by_contender"] = self.lost
        found["spread"] = {name: [min(values), max(values)] for name, values in ratios.items()}
        found["absolute"] = {
            contender: {
                measure: {key: statistics.median(r[key] for r in rounds) for key in rounds[0]}
                for measure, rounds in measures.items()
            }
            for contender, measures in self.rounds.items()
        }
        found["ratios_by_round"] = ratios
        found["rounds"] = max((len(values) for values in ratios.values()), default=len(self.startup_s))
        for peer in self.rounds.keys() - {"palp", "raw"}:
            found[f"ratios_to_{peer}"] = {
                name: statistics.median(values) for name, values in self.ratios(peer).items()
            }
        found["machine"] = machine()
        return found


def write_csv(results: Results, path: Path) -> None:
    """Write one row per contender, measure, round and figure."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("contender", "measure", "round", "figure", "value"))
        for contender, measures in results.rounds.items():
            for measure, rounds in measures.items():
                for number, found in enumerate(rounds, start=1):
                    writer.writerows((contender, measure, number, key, value) for key, value in found.items())
        writer.writerows(
            ("palp", "startup", i, "startup_10_nodes_s", s) for i, s in enumerate(results.startup_s, start=1)
        )


def machine() -> dict[str, Any]:
    """Describe the machine, and how busy it is."""
    return {
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "load": os.getloadavg()[0],
        "memory_gib": round(psutil.virtual_memory().total / 2**30),
    }
