"""Messages between the supervisor and two processes of one node while one takes the other's place.

The *predecessor* works; the *successor* is configured, receives the same inputs and publishes nothing before
:class:`Commit`. Their order, and what undoes each, is the table of :mod:`palp_core.graph.swap.engine`.
"""

from palp_core.graph.process.channel import ChannelMessage


class AnnounceSuccessor(ChannelMessage, frozen=True):
    """To the predecessor: readers should connect to a second place too, from where the node will go on."""

    publish: str
    serve: str


class SuccessorAnnounced(ChannelMessage, frozen=True):
    """The readers have been sent the place; ``readers`` are how many there are, by topic."""

    readers: dict[str, int]


class AwaitReaders(ChannelMessage, frozen=True):
    """To the successor: answer when so many readers are connected.

    Attributes:
        nodes: Those of the graph, by name: without them the swap waits.
    """

    readers: dict[str, int]
    nodes: list[str] = []


class ReadersReady(ChannelMessage, frozen=True):
    """They are, or those that are no nodes of the graph did not come in time."""


class RequestHandover(ChannelMessage, frozen=True):
    """To the predecessor: write down everything at a handler boundary.

    Attributes:
        after: Epoch and sequence by input topic: up to there it must have received, because the successor
            receives only what comes later.
        pause: Then handle nothing more, until :class:`Resume` or :class:`Leave`.
    """

    after: dict[str, tuple[int, int]]
    pause: bool
    with_latest: bool = False


class Handover(ChannelMessage, frozen=True):
    """What the predecessor has written down.

    Attributes:
        remembered: Replies to requests from outside that may be asked again.
        received: Up to where it has received its inputs, rejected messages included.
        frames: In lockstep, what it has published on this occasion.
    """

    hand_over: bytes
    at_ns: int
    remembered: dict[str, bytes]
    received: dict[str, tuple[int, int]]
    frames: list[bytes] = []


class DryRun(ChannelMessage, frozen=True):
    """To either: would this hand-over fit?

    Attributes:
        try_out: Try the handlers on the last messages, too, if it has some.
    """

    hand_over: bytes
    params: dict[str, object]
    try_out: bool = False


class DryRunResult(ChannelMessage, frozen=True):
    """How that went.

    Attributes:
        after: Up to where the successor lacks its inputs (see :class:`RequestHandover`).
        tried: What came of the state, as an encoded hand-over, if it was tried out.
    """

    error: str
    after: dict[str, tuple[int, int]]
    tried: bytes = b""


class TakeOver(ChannelMessage, frozen=True):
    """To the successor: continue from here, but publish nothing yet.

    Attributes:
        shadow: Work until :class:`EndShadow`, and compare with what comes from this endpoint, if any.
    """

    handover: Handover
    params: dict[str, object]
    start_ns: int
    on_probation: bool = False
    shadow: str | None = None


class TookOver(ChannelMessage, frozen=True):
    """Ready to go on, or why not.

    Attributes:
        frames: In lockstep, what it has published while it took over.
        next_due_ns: In lockstep, when it is due next; -1: never.
    """

    error: str
    held: int = 0
    frames: list[bytes] = []
    next_due_ns: int = -1


class RequestReport(ChannelMessage, frozen=True):
    """To a successor on probation: send one :class:`WorkReport`, as soon as there is something to report.

    Attributes:
        until_ns: Then in any case, on the host's monotonic clock; 0: at once.
        last: The probation is over: keep back what follows.
    """

    until_ns: int = 0
    handler_count: int = 0
    last: bool = False


HANDLER = "handler"
"""What proves a node whose class states nothing else."""


class WorkReport(ChannelMessage, frozen=True):
    """From a successor on probation, to its predecessor: so far all is well.

    The predecessor publishes the frames, and can go on from here if the next handler fails.

    Attributes:
        hand_over: The node as it is now, without what waits in its inbox.
        frames: What it has published since the last report.
        proof_count: How much is done of what proves the node: its handlers, if its class states nothing else.
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


class Published(ChannelMessage, frozen=True):
    """From the predecessor: the readers have been sent the frames of a :class:`WorkReport`.

    Attributes:
        error: Why it could not go on from there, or "".
    """

    error: str = ""


class EndShadow(ChannelMessage, frozen=True):
    """To the successor: pause, and report how it went."""


class Shadowed(ChannelMessage, frozen=True):
    """How it went (JSON, empty in lockstep), and ``after`` as in :class:`DryRunResult`."""

    report: bytes
    after: dict[str, tuple[int, int]]


class Commit(ChannelMessage, frozen=True):
    """To the successor: the node is yours.

    Attributes:
        record: What it is to remember of the swap.
        frames: What it has reported, and its predecessor has died before it could publish.
    """

    record: dict[str, object]
    frames: list[bytes] = []


class Working(ChannelMessage, frozen=True):
    """The successor handles what comes.

    Attributes:
        gap_s: How long neither handled anything; 0 in lockstep.
    """

    gap_s: float
    held: int


class Resume(ChannelMessage, frozen=True):
    """To the predecessor: the swap is off, go on; from the last :class:`WorkReport`, if there was one."""


class CancelMove(ChannelMessage, frozen=True):
    """To the predecessor: readers can forget the second place."""


class Leave(ChannelMessage, frozen=True):
    """To the predecessor: the successor works; send the readers on, and end."""

    patience_ns: int


class AnnouncePredecessorDead(ChannelMessage, frozen=True):
    """To the successor that works: send the readers on in the place of its predecessor, which has died."""


ToPredecessor = AnnounceSuccessor | RequestHandover | DryRun | WorkReport | Resume | CancelMove | Leave
ToSuccessor = AwaitReaders | DryRun | TakeOver | RequestReport | EndShadow | Commit | AnnouncePredecessorDead
FromPredecessor = SuccessorAnnounced | Handover | DryRunResult | Published
FromSuccessor = ReadersReady | DryRunResult | TookOver | WorkReport | Shadowed | Working
ToSwapped = ToPredecessor | ToSuccessor
FromSwapped = FromPredecessor | FromSuccessor
