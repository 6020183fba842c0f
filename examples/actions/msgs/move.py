"""Messages of an arm."""

from palp_core import Message
from palp_core.units import Metres


class MoveGoal(Message):
    """Where to go."""

    to_m: Metres


class MoveFeedback(Message):
    """Where the arm is on its way."""

    at_m: Metres


class MoveResult(Message):
    """Where it has come to rest."""

    at_m: Metres
