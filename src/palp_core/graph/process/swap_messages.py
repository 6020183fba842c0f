"""What the supervisor and two processes of one node say to each other while one takes the other's place.

The *predecessor* works; the *successor* is configured, hears the same inputs, and publishes nothing until it
is told :class:`Go`. That word is the one instant at which the node changes hands: before it everything can be
taken back, after it the predecessor only leaves.
"""

from palp_core.graph.process.channel import ChannelMessage


class Place(ChannelMessage, frozen=True):
    """To the predecessor: readers should listen to a second place too, from where the node will go on."""

    publish: str
    serve: str


class Announced(ChannelMessage, frozen=True):
    """The readers have been told; ``readers`` are how many there are, by topic."""

    readers: dict[str, int]


class Listening(ChannelMessage, frozen=True):
    """From a reader: it listens to a topic at the second place, too."""

    topic: str
    publish: str


class Meet(ChannelMessage, frozen=True):
    """To the successor: say when so many readers listen here.

    Attributes:
        readers: By topic, how many.
        nodes: Those of the graph, by name: without them the swap waits.
    """

    readers: dict[str, int]
    nodes: list[str] = []


class Met(ChannelMessage, frozen=True):
    """They do; ``missing`` are those that did not come in time, none of them a node of the graph."""

    missing: dict[str, int]


class HandIn(ChannelMessage, frozen=True):
    """To the predecessor: write down everything at a handler boundary.

    Attributes:
        after: Epoch and sequence by input topic: up to there it must have received, because the successor
            hears only what comes later.
        pause: Then take up nothing more, until :class:`Resume` or :class:`Leave`.
        with_latest: Add the last message of every input.
    """

    after: dict[str, tuple[int, int]]
    pause: bool
    with_latest: bool = False


class HandedIn(ChannelMessage, frozen=True):
    """What the predecessor has written down.

    Attributes:
        hand_over: An encoded :class:`~palp_core.graph.node.handover.HandOver`.
        at_ns: When, on the host's monotonic clock.
        remembered: Replies to requests from outside that may be asked again.
        heard: Up to where it has received its inputs: what it rejected it has heard, too.
        frames: In lockstep, what it has published on this occasion.
    """

    hand_over: bytes
    at_ns: int
    remembered: dict[str, bytes]
    heard: dict[str, tuple[int, int]]
    frames: list[bytes] = []


class Rehearse(ChannelMessage, frozen=True):
    """To either: would this hand-over fit?

    Attributes:
        hand_over: An encoded hand-over.
        params: Those that the swap sets.
        try_out: Try the handlers on the last messages, too, if it has some.
    """

    hand_over: bytes
    params: dict[str, object]
    try_out: bool = False


class Rehearsed(ChannelMessage, frozen=True):
    """How that went.

    Attributes:
        error: Why it would not, or "".
        after: Up to where the successor has not heard its inputs (see :class:`HandIn`).
        tried: What came of the state, as an encoded hand-over, if it was tried out.
    """

    error: str
    after: dict[str, tuple[int, int]]
    tried: bytes = b""


class TakeOver(ChannelMessage, frozen=True):
    """To the successor: continue from here, but publish nothing yet.

    ``remembered``, ``heard`` and ``at_ns`` are those of :class:`HandedIn`; ``start_ns`` is the graph's start.
    On probation the successor works, and says a :class:`Commit` when it is asked.
    """

    hand_over: bytes
    params: dict[str, object]
    start_ns: int
    heard: dict[str, tuple[int, int]]
    remembered: dict[str, bytes]
    at_ns: int = 0
    on_probation: bool = False


HANDLER = "handler"
"""What proves a node whose class says nothing else."""


class Commit(ChannelMessage, frozen=True):
    """From a successor on probation, to its predecessor: so far all is well.

    What it publishes is heard by way of the predecessor, who can go on from here if the next handler fails.

    Attributes:
        hand_over: The node as it is now, without what waits in its inbox.
        frames: What it has published since the last commit.
        run_count: How many handlers have run.
        proof_count: How much is done of what proves the node: its handlers, if its class says nothing else.
        proof: What that is, a word: handler, choice.
        last: The probation is over: what it publishes now it keeps back.
        ends: Names of its timers, alarms, events and clients.
    """

    hand_over: bytes
    frames: list[bytes]
    run_count: int
    proof_count: int
    proof: str
    last: bool = False
    ends: list[str] = []


class CommitNow(ChannelMessage, frozen=True):
    """To a successor on probation: say one :class:`Commit`, as soon as there is something to report.

    Attributes:
        until_ns: Then in any case, on the host's monotonic clock; 0: at once.
        last: The probation is over: at once, and keep back what follows.
    """

    until_ns: int = 0
    last: bool = False


class Published(ChannelMessage, frozen=True):
    """From the predecessor: readers have been sent the frames of a :class:`Commit`.

    Attributes:
        error: Why it could not go on from there, or "".
    """

    error: str = ""


class Shadow(ChannelMessage, frozen=True):
    """To the successor: work as from here, unheard, and compare with what ``publish`` has to say."""

    hand_over: bytes
    params: dict[str, object]
    start_ns: int
    heard: dict[str, tuple[int, int]]
    publish: str


class EndShadow(ChannelMessage, frozen=True):
    """To the successor: pause, and say how it went."""


class Shadowed(ChannelMessage, frozen=True):
    """How it went (JSON, empty in lockstep), and ``after`` as in :class:`Rehearsed`."""

    report: bytes
    after: dict[str, tuple[int, int]]


class TookOver(ChannelMessage, frozen=True):
    """Ready to go on, or why not.

    Attributes:
        error: Empty if it is.
        held: Messages that wait to be taken up.
        frames: In lockstep, what it has published while it took over.
        next_due_ns: In lockstep, when it is due next; -1: never.
    """

    error: str
    held: int = 0
    frames: list[bytes] = []
    next_due_ns: int = -1


class Go(ChannelMessage, frozen=True):
    """To the successor: the node is yours; ``record`` is what it is to remember of the swap."""

    record: dict[str, object]


class Working(ChannelMessage, frozen=True):
    """The successor takes up what comes; ``record`` is what it remembers of the swap."""

    record: dict[str, object]


class Resume(ChannelMessage, frozen=True):
    """To the predecessor: the swap is off, go on; from the last :class:`Commit`, if there was one."""


class Stay(ChannelMessage, frozen=True):
    """To the predecessor: readers can forget the second place."""


class Leave(ChannelMessage, frozen=True):
    """To the predecessor: the successor works; let the readers go, and end."""

    patience_ns: int


class Bury(ChannelMessage, frozen=True):
    """To the successor at work: the predecessor has died; tell the readers in its place that it is gone."""


ToSwapped = (
    Place
    | HandIn
    | Resume
    | Stay
    | Leave
    | Meet
    | Rehearse
    | TakeOver
    | Go
    | Bury
    | Shadow
    | EndShadow
    | Commit
    | CommitNow
)
FromSwapped = (
    Announced | HandedIn | Met | Rehearsed | TookOver | Working | Shadowed | Listening | Commit | Published
)
