"""What the experiment is set to do, and what a replacement of its node inherits."""

from typing import Annotated, Literal

import msgspec

from msgs.estimation import Belief, Palpation
from msgs.experiment import PolicyChange
from palp_core import Params, ReadOnly, State
from palp_core.palpation.perception.belief.trial_filter import DepthCount
from palp_core.palpation.perception.strategy.trained_rings import PUBLISHED
from palp_core.palpation.session.orders import GROUPED
from palp_core.palpation.session.plan import Specimens
from palp_core.units import Count, CountPositive, Metres, Seconds

TrialCount = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
"""Of trials, or of palpations in training: what a rig can do in its lifetime."""


POLICY = "policy"
"""The node whose place others take."""


def taking_over(swaps: str) -> list[str]:
    """Return the classes of ``TRIAL=MODULE:CLASS,...`` by trial; another form is refused elsewhere."""
    entries = [entry.partition("=") for entry in swaps.split(",") if "=" in entry]
    entries.sort(key=lambda entry: int(entry[0]) if entry[0].strip().isdecimal() else 0)
    return [run.strip() for *_, run in entries]


SwappedIn = Annotated[str, msgspec.Meta(extra={"successors": (POLICY, taking_over)})]
"""Policies that take over: the check of the launch file looks at their classes, too."""


class ExperimentParams(Params):
    """Set in the launch file.

    ``training`` palpations per phantom and ring position of ``rings_mm``, ``trials`` of estimation per
    phantom. Order, re-homing and remounting were not published: ``training_order`` mixes the ring positions
    of a mounting (randomised) or goes through them in turn (blocked); ``rehome`` tells before what the ring's
    actuator is driven to its stop and back (never: only as a policy wants it). ``swaps`` names policies that
    take over: ``30=nodes.policy_markov:Markov``. ``out``, the record's folder, must hold no session, unless
    that is to be replaced (``overwrite``).
    ``session`` names the session's sheet, which the report checks and copies.
    ``plan`` is the paper's experiment, or how well the rig repeats. ``depths`` and ``stop``: the estimator's.
    ``mounting``: which phantom when: ``grouped`` to limit remounts, ``each_trial``, ``block_randomised``, or
    a CSV of trials. ``specimens``: whether trials are of the phantoms of training, or of others.
    """

    out: str = "results"
    overwrite: bool = False
    session: str = ""
    plan: Literal["paper", "repeatability"] = "paper"
    wait_s: Seconds = 3600.0
    phantoms: str = ""
    policy: str = ""
    swaps: SwappedIn = ""
    seed: Count = 0
    trials: TrialCount = 100
    training: TrialCount = 25
    rings_mm: str = PUBLISHED
    training_order: Literal["randomised", "blocked"] = "randomised"
    rehome: Literal["palpation", "trial", "condition", "never"] = "trial"
    training_mounts: CountPositive = 1
    estimation_mounts: CountPositive = 1
    depths: DepthCount = 0
    stop: str = ""
    from_m: Metres = -0.03
    to_m: Metres = 0.05
    scene: str = ""
    mounting: ReadOnly[str] = GROUPED
    specimens: ReadOnly[Specimens] = "same"


class ExperimentState(State):
    """What a replacement inherits: the plan's replies so far, and the facts of the present step."""

    plan_seed: int = -1
    replies: list[str] = []
    phase: str = ""
    code: str = ""
    remount: int = -1
    depth_m: float = 0.0
    trial: int = 0
    number: int = 0
    trial_announced: bool = True
    label_m: float = 0.0
    iteration: int = 0
    commanded: bool = False
    swept: bool = False
    decided: bool = False
    enter_ns: int | None = None
    leave_ns: int | None = None
    goal_id: int = 0
    stage_ready: bool = True
    ring_trial: int = -1
    ring_iteration: int = -1
    ring_settled: bool = False
    ring_landed: bool = False
    last_ring_m: float = -1.0
    rehomed: bool = False
    waited: bool = False
    true_ring_m: float | None = None
    true_height_m: float | None = None
    guards: list[str] = []
    touch_changed: bool = False
    palpation: list[Palpation] = []
    belief: list[Belief] = []
    row: int = 0
    palpations_done: int = 0
    right_count: int = 0
    judged: dict[str, list[int]] = {}
    trials_done: int = 0
    dropped_count: int = 0
    sweep_s: float = 0.0
    finished: bool = False
    again: list[tuple[int, str]] = []
    not_again: list[tuple[str, int]] = []
    mount_again: str = ""
    home_again: bool = False
    policy: str = ""
    next_policy: str = ""
    policy_changes: list[PolicyChange] = []
