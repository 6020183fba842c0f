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

__all__ = ["OWN", "QUANTILES", "RATIOS", "TARGETS", "Measure", "Ratio", "Results", "machine", "write_csv"]

QUANTILES = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
PALP = "palp"


@dataclass(frozen=True)
class Ratio:
    """A figure of palp's over one of a contender's, in the same round.

    Attributes:
        measure: Palp's.
        figure: Of both.
        theirs: The contender's measure, if it is another one.
    """

    measure: str
    figure: str
    theirs: str = ""

    @property
    def beside(self) -> str:
        """The contender's measure."""
        return self.theirs or self.measure


RATIOS = {
    "p50_ratio": Ratio("latency", "p50_s"),
    "p99_ratio": Ratio("latency", "p99_s"),
    "cpu_ratio": Ratio("latency", "cpu_s"),
    "p50_64k_ratio": Ratio("64k", "p50_s"),
    "p99_64k_ratio": Ratio("64k", "p99_s"),
    "cpu_64k_ratio": Ratio("64k", "cpu_s"),
    "trip_p50_ratio": Ratio("trip", "p50_s"),
    "trip_p99_ratio": Ratio("trip", "p99_s"),
    "trip_cpu_ratio": Ratio("trip", "cpu_s"),
    "rate_48b_ratio": Ratio("rate", "rate_hz"),
    "rate_1mib_ratio": Ratio("1mib", "rate_hz"),
    "fan5_p50_ratio": Ratio("fan", "p50_s"),
    "fan5_p99_ratio": Ratio("fan", "p99_s"),
    "fan5_cpu_ratio": Ratio("fan", "cpu_s"),
}
OWN = {
    "call_p50_ratio": Ratio("call", "p50_s", "trip"),
    "call_cpu_ratio": Ratio("call", "cpu_s", "trip"),
}
TARGETS = {
    "raw": {
        "p50_ratio": 1.25,
        "p99_ratio": 1.5,
        "p50_64k_ratio": 1.15,
        "rate_48b_ratio": 1.1,
        "rate_1mib_ratio": 1.3,
        "fan5_p50_ratio": 1.3,
    },
    "raw_timeout": {
        "p50_ratio": 1.05,
        "cpu_ratio": 1.25,
        "p50_64k_ratio": 1.1,
        "fan5_p50_ratio": 1.0,
    },
    PALP: {"call_p50_ratio": 1.15},
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

    def drop(self, contender: str) -> None:
        """Forget a contender that failed on the way."""
        for kept in (self.lost, self.rounds):
            kept.pop(contender, None)

    def ratios(self, peer: str) -> dict[str, list[float]]:
        """Return palp over the peer of every round, by the names of ``RATIOS``; over itself, of ``OWN``.

        A ratio to what a peer could not do at all, a rate of 0, is not among them.
        """
        found = {}
        for name, ratio in (OWN if peer == PALP else RATIOS).items():
            mine = [figures[ratio.figure] for figures in self._of(PALP, ratio.measure)]
            theirs = [figures[ratio.figure] for figures in self._of(peer, ratio.beside)]
            if mine and theirs and min(theirs) > 0.0:
                found[name] = [value / beside for value, beside in zip(mine, theirs, strict=True)]
        return found

    def _of(self, contender: str, measure: str) -> list[dict[str, float]]:
        return self.rounds.get(contender, {}).get(measure, [])

    def summary(self) -> dict[str, Any]:
        """Return everything as one object; ratios at its top are to ``raw``, or to palp's own round trip."""
        by_round = {peer: self.ratios(peer) for peer in self.rounds}
        plain = {**by_round.get("raw", {}), **by_round.get(PALP, {})}
        found: dict[str, Any] = {name: statistics.median(values) for name, values in plain.items()}
        if self.startup_s:
            found["startup_10_nodes_s"] = statistics.median(self.startup_s)
            found["startup_10_nodes_rounds_s"] = self.startup_s
        found["lost"] = self.lost.get(PALP, 0)
        found["lost_by_contender"] = self.lost
        found["spread"] = {name: [min(values), max(values)] for name, values in plain.items()}
        figures = self._figures()
        found["absolute"] = _nested(figures, "median")
        found["absolute_least"] = _nested(figures, "least")
        found["absolute_largest"] = _nested(figures, "largest")
        found["rounds_of"] = {
            contender: {measure: len(rounds) for measure, rounds in measures.items()}
            for contender, measures in self.rounds.items()
        }
        found["ratios"] = {
            peer: {
                name: {**_stated(values), "target": TARGETS.get(peer, {}).get(name)}
                for name, values in ratios.items()
            }
            for peer, ratios in by_round.items()
            if ratios
        }
        found["ratios_by_round"] = plain
        counts = [len(rounds) for measures in self.rounds.values() for rounds in measures.values()]
        found["rounds"] = max(counts, default=len(self.startup_s))
        found["machine"] = machine()
        return found

    def _figures(self) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
        """Return what is stated of each contender, measure and figure."""
        return {
            contender: {
                measure: {key: _stated([found[key] for found in rounds]) for key in rounds[0]}
                for measure, rounds in measures.items()
            }
            for contender, measures in self.rounds.items()
        }

    def rows(self) -> list[tuple[str, str, int | str, str, float]]:
        """Return contender, measure, round (or what is stated of all), figure and value of all figures."""
        rows: list[tuple[str, str, int | str, str, float]] = []
        for contender, measures in self.rounds.items():
            for measure, rounds in measures.items():
                for number, found in enumerate(rounds, start=1):
                    rows.extend((contender, measure, number, key, value) for key, value in found.items())
        for contender, stated in self._figures().items():
            for measure, figures in stated.items():
                for key, values in figures.items():
                    rows.extend((contender, measure, what, key, value) for what, value in values.items())
        for peer in self.rounds:
            for name, ratios in self.ratios(peer).items():
                measure = (RATIOS | OWN)[name].measure
                stated = {**dict(enumerate(ratios, start=1)), **_stated(ratios)}
                rows.extend((f"{PALP}/{peer}", measure, what, name, value) for what, value in stated.items())
        startup = enumerate(self.startup_s, start=1)
        rows.extend((PALP, "startup", number, "startup_10_nodes_s", took_s) for number, took_s in startup)
        return rows


def _stated(values: list[float]) -> dict[str, float]:
    return {
        "median": statistics.median(values),
        "least": min(values),
        "largest": max(values),
        "rounds": len(values),
    }


def _nested(figures: dict[str, dict[str, dict[str, dict[str, float]]]], what: str) -> dict[str, Any]:
    return {
        contender: {
            measure: {key: values[what] for key, values in of.items()} for measure, of in measures.items()
        }
        for contender, measures in figures.items()
    }


def write_csv(results: Results, path: Path) -> None:
    """Write one row per contender, measure, round and figure; that of a ratio is of ``palp/`` and the peer.

    In place of a round's number, ``median``, ``least``, ``largest`` and ``rounds`` say what is stated of all.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("contender", "measure", "round", "figure", "value"))
        writer.writerows(results.rows())


def machine() -> dict[str, Any]:
    """Describe the machine, and how busy it is."""
    return {
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "load": os.getloadavg()[0],
        "memory_gib": round(psutil.virtual_memory().total / 2**30),
    }
