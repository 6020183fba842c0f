"""What a person at the rig is asked, and what they answer."""

from palp_core import Message
from palp_core.units import Count, Nanoseconds


class Prompt(Message):
    """What is wanted of the operator; the latest one is open until it is answered or another comes.

    ``kind`` is ``enter`` (Enter suffices), ``choice`` (one of ``choices``), ``text``, or ``none``: nothing is
    wanted, ``text`` only informs. ``number`` identifies the prompt: an answer names it.
    ``ends_ns`` is when it ends by itself, 0: never.
    """

    stamp_ns: Nanoseconds
    number: Count
    kind: str
    text: str
    choices: list[str] = []
    ends_ns: Nanoseconds = 0


class AnswerRequest(Message):
    """The answer to the prompt of that number; ``by`` says whose: ``terminal``, ``page`` or ``script``."""

    number: Count
    text: str = ""
    by: str = ""


class AnswerReply(Message):
    """Whether the answer was taken; ``text`` says why not."""

    taken: bool
    text: str = ""
