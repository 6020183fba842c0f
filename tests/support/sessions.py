"""Small synthetic records, written as a session writes them."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palp_core.graph.launch.summary import RunSummary
from palp_core.palpation.reporting import charts
from palp_core.palpation.session.result import TIME_KEYS
from palp_core.palpation.session.trials_csv import Row, SessionWriter

RINGS_M = (0.0, 0.016)
RATE_HZ = 1000.0
SWEEP = 1400

Writer = Callable[..., Path]
Summariser = Callable[..., RunSummary]


def torque_n_m(peak_n_m: float, rng: np.random.Generator) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A bump over a base, with a little noise."""
    x = np.linspace(-1.0, 1.0, SWEEP)
    return peak_n_m * (0.8 + 0.2 * np.exp(-20.0 * x**2)) + 1e-5 * rng.standard_normal(SWEEP)


def without_times(result: dict[str, Any]) -> dict[str, Any]:
    """Return what must be equal for two runs of the same launch file and seed."""
    return {key: value for key, value in result.items() if key not in TIME_KEYS}


SMALL_STRAIN = "small strain: 2 mm pressed into 2 mm of gel over the bead"


@pytest.fixture
def record(tmp_path: Path) -> Writer:
    """Write a record into the test's folder."""
    return writer(tmp_path)


def writer(folder: Path) -> Writer:
    """Return what writes a record: a trial is (true class, posteriors), the last of which is its estimate."""

    def write(
        name: str = "out",
        *,
        depths_m: Sequence[float] = (0.002, 0.004, 0.008),
        repeats: int = 2,
        trials: Sequence[tuple[int, Sequence[Sequence[float]]]] = (),
        last_word: str = "decided",
        primitives: bool = True,
    ) -> Path:
        out, rng, count = folder / name, np.random.default_rng(5), 0
        keeper = SessionWriter(str(out), depths_m)
        keeper.start()

        def keep(depth_m: float, ring_m: float, **more: Any) -> None:
            nonlocal count
            peak_n_m = ring_m * (1.0 + 0.1 / (depth_m * 1e3)) + 0.0005 + 1e-5 * rng.standard_normal()
            facts: dict[str, Any] = {
                "row": count,
                "session": "markov-3",
                "phantom": "ABC"[depths_m.index(depth_m)],
                "remount": 0,
                "depth_m": depth_m,
                "iteration": 1,
                "ring_m": ring_m,
                "true_ring_m": ring_m,
                "guards": [SMALL_STRAIN] if (depth_m, ring_m) == (0.002, 0.016) else [],
                "peak_n_m": peak_n_m,
                "posterior": [],
                "gain": [],
                "gamma": None,
                "verdict": "",
                "estimate_m": None,
                "outlier": False,
                "policy": "markov",
                "seed": 3,
                "start_ns": count * 10**10,
                "end_ns": count * 10**10 + 1_399_000_000,
            }
            keeper.append(Row(**(facts | more)), torque_n_m(peak_n_m, rng), RATE_HZ)
            count += 1

        for depth_m in depths_m:
            for ring_m in RINGS_M:
                for _ in range(repeats):
                    keep(depth_m, ring_m, phase="training", trial=count + 1)
        if primitives and repeats:
            shape = (len(depths_m), len(RINGS_M))
            keeper.primitives(
                {
                    "depths_m": list(depths_m),
                    "rings_m": list(RINGS_M),
                    "mean": (np.arange(6.0).reshape(3, 2)[: shape[0]] * 1e-3).tolist(),
                    "sd": np.full(shape, 1e-4).tolist(),
                    "count": np.full(shape, repeats).tolist(),
                    "floor": 1e-5,
                }
            )
        for index, (truth, posteriors) in enumerate(trials):
            for iteration, posterior in enumerate(posteriors, start=1):
                keep(
                    depths_m[truth],
                    RINGS_M[iteration % 2],
                    phase="estimation",
                    trial=1000 + index,
                    iteration=iteration,
                    posterior=list(posterior),
                    gain=[0.0] * len(depths_m),
                    gamma=None if iteration == 1 else 0.1,
                    verdict=last_word if iteration == len(posteriors) else "continue",
                    estimate_m=depths_m[int(np.argmax(posterior))],
                )
        return out

    return write


def describe(out: Path, *, wall_s: float = 2.0, composed: bool = False, **estimator: Any) -> RunSummary:
    """Describe a run that recorded into a folder."""
    args = {"out": str(out), "policy": "markov", "trials": 2, "training": 2}
    return RunSummary(
        graph="rig",
        file="launch/sim.yaml",
        clock="sim",
        seed=3,
        composed=composed,
        args=args,
        given=[f"{name}:={value}" for name, value in args.items() if name != "policy"],
        params={
            "experiment": args | {"rehome": "trial", "from_m": -0.03},
            "policy": {"matrices": "ar1"},
            "phantom": {"phantoms": "", "output": "peak", "tolerance": 0.02, "height_sd_mm": 0.1},
            "stage": {"sweep_speed_m_s": 0.02},
            "estimator": {"level": 5, "stop": "paper_guarded", "max_probes": 15} | estimator,
        },
        publishes={
            "experiment": {"/experiment/ring": "RingCommand", "/experiment/result": "TrialResult"},
            "policy": {"/policy/command": "RingCommand"},
            "phantom": {"/phantom/guard": "ContactGuard", "/phantom/truth": "PhantomTruth"},
            "stage": {"/stage/status": "SweepStatus"},
            "estimator": {"/estimator/belief": "Belief"},
        },
        listens={
            "experiment": ["/estimator/belief", "/phantom/guard", "/phantom/truth", "/stage/status"],
            "policy": ["/estimator/belief", "/experiment/trial"],
        },
        exit_code=0,
        clock_s=123.0,
        wall_s=wall_s,
        activation_count=77,
    )


@pytest.fixture
def summary() -> Summariser:
    """Describe a run that recorded into a folder."""
    return describe


def charts_in(page: Path) -> set[str]:
    """Return the names of the charts on a page."""
    return set(re.findall(r'data-name="(\w+)"', page.read_text(encoding="utf-8")))


@contextlib.contextmanager
def no_charts() -> Iterator[None]:
    """Make charts that show nothing, for who looks at other things: to draw a page of them takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(charts, "image", lambda chart, form: b"")
        yield


@pytest.fixture
def blank_charts() -> Iterator[None]:
    with no_charts():
        yield


@pytest.fixture
def strict_json() -> Callable[[Path], Any]:
    """Read JSON that holds no NaN and no infinity."""

    def refuse(constant: str) -> Any:
        raise AssertionError(f"{constant} is not JSON")

    return lambda path: json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
