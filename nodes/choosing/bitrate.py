"""Choose the whole palpation: of ring, depth, speed, path and direction what tells most a second."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from msgs.action import ActionPromise, ActionQuestion, PalpationAction
from nodes.policy import PolicyNode, PolicyParams
from palp_core.errors import PerceptionError
from palp_core.palpation.devices.sim.stage import SimStage
from palp_core.palpation.mechanics.scene.file import read_scene
from palp_core.palpation.mechanics.scene.scene import StagePath
from palp_core.palpation.perception.strategy import policies
from palp_core.palpation.perception.strategy.policies_informed import BitsPerSecond, Timing
from palp_core.palpation.perception.strategy.trained_rings import rings_of
from palp_core.palpation.perception.trace.actions import SweepAction, most_a_second
from palp_core.palpation.session.named_files import file_mistakes
from palp_core.palpation.session.trace.action_time import ActionTime, RigStanding
from palp_core.palpation.session.trace.choices import ActionChoices
from palp_core.units import (
    Metres,
    MetresPerSecondPositive,
    MillimetresNonNegative,
    MillimetresPositive,
    NewtonMillimetresPositive,
    NewtonsPositive,
)


class BitrateParams(PolicyParams):
    """Set in the launch file.

    ``vary`` names what is chosen beside the ring: speed, indentation, path, direction. Chosen among are the
    launch file's own sweep, from ``from_m`` to ``to_m`` at ``sweep_speed_m_s``, as deep as the ``scene``
    says, ``speeds_mm_s`` and ``indentations_mm`` beside these, paths that begin or end ``inset_mm`` within,
    and each path back. The limits are those of the safety node: ``speed_m_s``, and ``stop_n_mm`` and
    ``stop_n`` for what is expected with three spreads; no indentation is deeper than the scene's. From
    ``lift_mm`` and ``rehome`` follow the rig's times; the stage's accelerations are assumed.
    """

    vary: str = "speed, indentation, path, direction"
    from_m: Metres = -0.03
    to_m: Metres = 0.05
    sweep_speed_m_s: MetresPerSecondPositive = 0.020
    scene: str = ""
    speeds_mm_s: tuple[MillimetresPositive, ...] = (40.0,)
    indentations_mm: tuple[MillimetresPositive, ...] = (3.0,)
    inset_mm: MillimetresNonNegative = 10.0
    speed_m_s: MetresPerSecondPositive = 0.050
    stop_n_mm: NewtonMillimetresPositive = 100.0
    stop_n: NewtonsPositive = 10.0
    lift_mm: MillimetresPositive = 20.0
    rehome: Literal["palpation", "trial", "condition", "never"] = "trial"


def choices_of(params: BitrateParams) -> ActionChoices:
    """Return what may be chosen, within the limits.

    Raises:
        PerceptionError: A word of ``vary`` is none, or a number is beyond its limit.
        MechanicsError: The scene cannot be read.
    """
    path = read_scene(params.scene).path if params.scene else StagePath()
    return ActionChoices.within(
        params.vary,
        SweepAction(0.0, path.indentation_m, params.sweep_speed_m_s, params.from_m, params.to_m),
        speeds_m_per_s=[one * 1e-3 for one in params.speeds_mm_s],
        indentations_m=[one * 1e-3 for one in params.indentations_mm],
        inset_m=params.inset_mm * 1e-3,
        fastest_m_per_s=params.speed_m_s,
    )


class Bitrate(PolicyNode):
    """Ask the estimator what each palpation would tell, and take that of most bits a second of the rig.

    The estimator reads whole traces. Where it can promise nothing the ring is the stiffest, the rest as the
    launch file says.
    """

    params: BitrateParams

    @staticmethod
    def mistakes(params: BitrateParams) -> dict[str, str]:
        if found := file_mistakes(params):
            return found
        try:
            choices_of(params)
        except PerceptionError as error:
            return {next((name for name in ("vary", "speeds_mm_s", "indentations_mm", "inset_mm")
                          if str(error).startswith(name)), ""): str(error)}  # fmt: skip
        return {}

    def on_configure(self) -> None:
        super().on_configure()
        stage = SimStage(lift_m=self.params.lift_mm * 1e-3)
        self.times = ActionTime(stage, Timing(rehomes=self.params.rehome != "never"))

    def choose(self) -> policies.StiffnessPolicy:
        kept = self.state.primitives.get("rings_m")
        return BitsPerSecond(tuple(kept or rings_of(self.params.trained_mm)))

    def refreshed(self) -> policies.StiffnessPolicy:
        return self.choose()

    def _next(self) -> None:
        """Ask what palpations would tell."""
        state = self.state
        state.asked = [_row(one) for one in choices_of(self.params).actions(self.policy.rings_m)]
        columns = np.array(state.asked).T.copy()
        self.question.publish(
            ActionQuestion(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.iteration + 1,
                ring_m=columns[0],
                indentation_m=columns[1],
                speed_m_s=columns[2],
                from_m=columns[3],
                to_m=columns[4],
                torque_limit_n_m=self.params.stop_n_mm * 1e-3,
                force_limit_n=self.params.stop_n,
            )
        )

    def _with_promise(self, actions: Sequence[SweepAction], promise: ActionPromise) -> None:
        bits = promise.bits
        if len(bits) != len(actions) or not (bits >= 0.0).any():
            why = promise.refused[0] if promise.refused else "the answer is to another question"
            self.log.warning("no palpation can be chosen: %s; the stiffest, as the launch file says", why)
            super()._next()
            return
        allowed = np.where(bits >= 0.0, bits, -np.inf)
        best, _ = most_a_second(allowed[None], self.times.seconds(actions, self._standing()))
        self._take(actions[int(best[0])])

    def _standing(self) -> RigStanding:
        """Return where the trial so far has left the rig."""
        at, home = RigStanding(), choices_of(self.params).home
        for number, ring_m in enumerate(self.state.tried_m, start=1):
            chosen = self.state.chosen.get(number)
            terms = chosen or (home.indentation_m, home.speed_m_per_s, home.from_m, home.to_m)
            at = self.times.after(SweepAction(ring_m, *terms), at)
        return at

    def _take(self, action: SweepAction) -> None:
        """Have the experiment move the ring and sweep as chosen."""
        state = self.state
        state.iteration += 1
        self._tell_change()
        state.level = int(np.argmin(np.abs(np.asarray(self.policy.rings_m) - action.ring_m)))
        state.ring_m = action.ring_m
        state.landed.append(not state.tried_m or state.tried_m[-1] != action.ring_m)
        state.tried_m.append(action.ring_m)
        state.chosen[state.iteration] = _row(action)[1:]
        self.action.publish(
            PalpationAction(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                iteration=state.iteration,
                ring_m=action.ring_m,
                indentation_m=action.indentation_m,
                speed_m_s=action.speed_m_per_s,
                from_m=action.from_m,
                to_m=action.to_m,
            )
        )


def _row(action: SweepAction) -> tuple[float, float, float, float, float]:
    path = (action.from_m, action.to_m)
    return (action.ring_m, action.indentation_m, action.speed_m_per_s, *path)
