"""A node that sends the arm from place to place."""

from msgs.move import MoveFeedback, MoveGoal, MoveResult
from palp_core import ActionClient, Node, Params, State, WrappedResult, on, on_feedback


class CarrierParams(Params):
    """Where the arm is to go, one place after the other."""

    places_m: list[float] = []


class CarrierState(State):
    """What has been reached, and how far the arm is on its way to the next place."""

    reached_m: list[float] = []
    seen_m: float = 0.0


class Carrier(Node):
    """Sends the arm on when it has arrived, and once more where it did not."""

    params: CarrierParams
    state: CarrierState
    move = ActionClient(MoveGoal, MoveFeedback, MoveResult)

    def on_activate(self) -> None:
        self.send_on()

    def send_on(self) -> None:
        self.move.send_goal(MoveGoal(to_m=self.params.places_m[len(self.state.reached_m)]))

    @on_feedback(move)
    def watch(self, goal_id: str, feedback: MoveFeedback) -> None:
        self.state.seen_m = feedback.at_m

    @on(move)
    def arrive(self, ended: WrappedResult[MoveResult]) -> None:
        if ended.status == "rejected":
            raise ValueError(f"the arm will not go there: {ended.reason}")
        if ended.status == "succeeded" and ended.result is not None:
            self.state.reached_m.append(ended.result.at_m)
        else:
            self.log.warning("goal %s is %s: %s", ended.goal_id, ended.status, ended.reason)
        if len(self.state.reached_m) < len(self.params.places_m):
            self.send_on()
        else:
            self.finish()
