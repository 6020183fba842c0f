"""The own link leads to the stage that moves: never a false alarm however late, and no other stage passes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from palp_core.palpation.devices.motion_profile import MotionProfile
from palp_core.palpation.devices.protocols import AxisReport
from palp_core.palpation.devices.safety.link_check import CHECK_MOVE_M, LinkCheck, StagePlace

MS = 1_000_000
END_NS = 8_000 * MS
FASTEST_M_PER_S = 0.0625
Place = Callable[[int], float]


def path(*legs: tuple[float, float, int]) -> Place:
    """Return a place as a function of time: legs of (to_m, speed_m_per_s, start_ns), from 0."""
    profiles, here_m = [], 0.0
    for to_m, speed, start_ns in legs:
        profiles.append((here_m, to_m, MotionProfile(0.0, abs(to_m - here_m), speed, 1.0, start_ns)))
        here_m = to_m

    def at_m(time_ns: int) -> float:
        now_m = 0.0
        for from_m, to_m, profile in profiles:
            if time_ns >= profile.start_ns:
                done = float(profile.position(np.array([time_ns]))[0]) / profile.end_m
                now_m = from_m + done * (to_m - from_m)
        return now_m

    return at_m


SWEEPS = path(
    (CHECK_MOVE_M, 0.05, 500 * MS),
    (-0.015, 0.05, 1500 * MS),
    (0.020, 0.02, 3000 * MS),
    (0.0, 0.05, 6500 * MS),
)
SMALL = path((CHECK_MOVE_M, 0.05, 500 * MS))
RESTS: Place = lambda _: 0.0  # noqa: E731


def ask(
    place: Place, rng: np.random.Generator, period_ms: float, answer_ms: float
) -> list[tuple[int, int, float]]:
    """Return when a place was asked for and answered, and what: it was so at some time in between."""
    found, now_ns = [], 0
    while now_ns < END_NS:
        answered_ns = now_ns + round(rng.uniform(0.2, answer_ms) * MS)
        found.append((now_ns, answered_ns, place(int(rng.integers(now_ns, answered_ns)))))
        now_ns = answered_ns + round(rng.uniform(0.2, 2.0) * period_ms * MS)
    return found


def run(
    stage: Place,
    link: Place,
    *,
    period_ms: float = 20.0,
    answer_ms: float = 3.0,
    late_ms: float = 5.0,
    seed: int = 0,
) -> tuple[LinkCheck, list[str]]:
    """Let both report, late by up to ``late_ms`` and each in its order; return the results meanwhile."""
    rng, check, shown = np.random.default_rng(seed), LinkCheck(FASTEST_M_PER_S), []
    received: list[tuple[int, int, StagePlace | AxisReport]] = []
    for source, rows in enumerate((ask(stage, rng, period_ms, answer_ms), ask(link, rng, 50.0, answer_ms))):
        arrives_ns = 0
        for asked_ns, answered_ns, at_m in rows:
            arrives_ns = max(arrives_ns, answered_ns + round(rng.uniform(0.0, late_ms) * MS))
            received.append(
                (
                    arrives_ns,
                    source,
                    StagePlace(asked_ns, answered_ns, at_m, 0.0)
                    if source == 0
                    else axis(asked_ns, answered_ns, at_m),
                )
            )
    for _, _, item in sorted(received, key=lambda row: row[:2]):
        if isinstance(item, StagePlace):
            check.note_stage(item)
        else:
            check.note_axis(item)
        shown.append(check.contradiction)
    return check, shown


def seeds(count: int) -> list[Any]:
    """Return the first two seeds, and more at night."""
    return [pytest.param(seed, marks=[pytest.mark.nightly] if seed > 1 else []) for seed in range(count)]


def axis(asked_ns: int, answered_ns: int, at_m: float) -> AxisReport:
    return AxisReport(
        axis="X", direction="y", fault="", moving=False, enabled=True,
        position_m=at_m, asked_ns=asked_ns, answered_ns=answered_ns,
    )  # fmt: skip


@pytest.mark.parametrize("seed", seeds(20))
@pytest.mark.parametrize(
    ("period_ms", "answer_ms", "late_ms"),
    [(20.0, 3.0, 5.0), (20.0, 3.0, 2000.0), (60.0, 50.0, 500.0), (20.0, 600.0, 0.0), (300.0, 200.0, 3000.0)],
)
def test_the_same_controller_never_contradicts_itself_however_late_and_slow_all_is(
    period_ms: float, answer_ms: float, late_ms: float, seed: int
) -> None:
    check, shown = run(SWEEPS, SWEEPS, period_ms=period_ms, answer_ms=answer_ms, late_ms=late_ms, seed=seed)
    assert set(shown) == {""}
    assert check.verified_ns("y") > 0
    assert "mm are needed" not in check.result("y")
    assert check.verified_ns("z") == 0


@pytest.mark.parametrize("seed", seeds(5))
@pytest.mark.parametrize(
    ("stage", "link"),
    [
        (SMALL, RESTS),
        (RESTS, SMALL),
        (SWEEPS, RESTS),
        (RESTS, SWEEPS),
        (SWEEPS, lambda t: -SWEEPS(t)),
        (RESTS, lambda _: 0.0035),
    ],
    ids=[
        "rests at the small move",
        "moves by itself",
        "rests",
        "sweeps by itself",
        "other sign",
        "other place",
    ],
)
def test_another_controller_is_noticed_and_never_verified(stage: Place, link: Place, seed: int) -> None:
    check, shown = run(stage, link, seed=seed)
    assert "the link leads to another controller" in "".join(shown)
    if link is RESTS or stage is RESTS:
        assert check.verified_ns("y") == 0


def test_a_link_on_a_controller_at_rest_is_not_verified_though_the_bounds_are_wide() -> None:
    check, shown = run(SMALL, RESTS, period_ms=400.0, answer_ms=300.0)
    assert set(shown) == {""}
    assert check.verified_ns("y") == 0
    assert check.result("y") == "followed the stage over 0.0 mm, 1.5 mm are needed"


def test_a_stage_that_is_connected_again_is_verified_again_and_may_have_another_origin() -> None:
    check, _ = run(SWEEPS, SWEEPS)
    check.note_stage(StagePlace(0, 0, 0.0, 0.0))
    assert check.verified_ns("y") == 0
    check.note_axis(axis(END_NS, END_NS + MS, 0.5))  # while it homes
    check.note_stage(StagePlace(END_NS + 20 * MS, END_NS + 22 * MS, 0.0, 0.0))
    assert check.contradiction == ""
