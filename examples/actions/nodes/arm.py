"""An arm that moves to where it is asked to."""

import math

from msgs.move import MoveFeedback, MoveGoal, MoveResult
from palp_core import Act, GoalHandle, Node, Params, State, accept, execute
from palp_core.errors import GoalRejected
from palp_core.units import HertzPositive, MetresNonNegative


class ArmParams(Params):
    """How the arm moves."""

    step_hz: HertzPositive = 20.0
    step_m: MetresNonNegative = 0.01
    reach_m: MetresNonNegative = 1.0


class ArmState(State):
    """Where it is: what the next process of the node goes on from."""

    at_m: float = 0.0


class Arm(Node):
    """Moves in steps, one goal at a time."""

    params: ArmParams
    state: ArmState
    move = Act(MoveGoal, MoveFeedback, MoveResult, when_busy="queue")

    @accept(move)
    def check(self, goal: MoveGoal) -> None:
        if abs(goal.to_m) > self.params.reach_m:
            raise GoalRejected(f"{goal.to_m} m is beyond the reach of {self.params.reach_m} m")

    @execute(move, "step_hz")
    def advance(self, goal: GoalHandle[MoveGoal, MoveFeedback, MoveResult]) -> None:
        if goal.is_cancel_requested:
            goal.canceled(MoveResult(at_m=self.state.at_m))
            return
        left_m = goal.request.to_m - self.state.at_m
        if abs(left_m) > self.params.step_m:
            self.state.at_m += math.copysign(self.params.step_m, left_m)
            goal.publish_feedback(MoveFeedback(at_m=self.state.at_m))
        else:
            self.state.at_m = goal.request.to_m
            goal.succeed(MoveResult(at_m=self.state.at_m))
