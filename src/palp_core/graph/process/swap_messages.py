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
    """To the successor: answer when so many readers are connected."""

    readers: dict[str, int]
    nodes: list[str] = []  # those of the graph, by name: without them the swap waits


class ReadersReady(ChannelMessage, frozen=True):
    """They are, or those that are no nodes of the graph did not come in time."""


class RequestHandover(ChannelMessage, frozen=True):
    """To the predecessor: write down everything at a handler boundary."""

    # epoch and sequence by input topic: up to there it must have received, because the successor receives
    # only what comes later
    after: dict[str, tuple[int, int]]
    pause: bool  # then handle nothing more, until :class:`Resume` or :class:`Leave`
    with_latest: bool = False


class Handover(ChannelMessage, frozen=True):
    """What the predecessor has written down."""

    hand_over: bytes
    at_ns: int
    remembered: dict[str, bytes]  # replies to requests from outside that may be asked again
    received: dict[str, tuple[int, int]]  # up to where it has received its inputs, rejected messages included
    frames: list[bytes] = []  # in lockstep, what it has published on this occasion


class DryRun(ChannelMessage, frozen=True):
    """To either: would this hand-over fit?"""

    hand_over: bytes
    params: dict[str, object]
    try_out: bool = False  # try the handlers on the last messages, too, if it has some


class DryRunResult(ChannelMessage, frozen=True):
    """How that went."""

    error: str
    # up to where the successor lacks its inputs (see :class:`RequestHandover`)
    after: dict[str, tuple[int, int]]
    tried: bytes = b""  # what came of the state, as an encoded hand-over, if it was tried out


class TakeOver(ChannelMessage, frozen=True):
    """To the successor: continue from here, but publish nothing yet."""

    handover: Handover
    params: dict[str, object]
    start_ns: int
    on_probation: bool = False
    # work until :class:`EndShadow`, and compare with what comes from this endpoint, if any
    shadow: str | None = None


class TookOver(ChannelMessage, frozen=True):
    """Ready to go on, or why not."""

    error: str
    held: int = 0
    frames: list[bytes] = []  # in lockstep, what it has published while it took over
    next_due_ns: int = -1  # in lockstep, when it is due next; -1: never


class RequestReport(ChannelMessage, frozen=True):
    """To a successor on probation: send one :class:`WorkReport`, as soon as there is something to report."""

    until_ns: int = 0  # then in any case, on the host's monotonic clock; 0: at once
    handler_count: int = 0
    last: bool = False  # the probation is over: keep back what follows


HANDLER = "handler"
"""What proves a node whose class states nothing else."""


class WorkReport(ChannelMessage, frozen=True):
    """From a successor on probation, to its predecessor: publish the frames; it can go on from here."""

    hand_over: bytes  # the node as it is now, without what waits in its inbox
    frames: list[bytes]  # what it has published since the last report
    run_count: int
    # how much is done of what proves the node: its handlers, if its class states nothing else
    proof_count: int
    proof: str
    last: bool = False  # the probation is over: what it publishes now it keeps back
    ends: list[str] = []  # names of its timers, alarms, events and clients


class Published(ChannelMessage, frozen=True):
    """From the predecessor: the readers have been sent the frames of a :class:`WorkReport`."""

    error: str = ""  # why it could not go on from there, or ""


class EndShadow(ChannelMessage, frozen=True):
    """To the successor: pause, and report how it went."""


class Shadowed(ChannelMessage, frozen=True):
    """How it went (JSON, empty in lockstep), and ``after`` as in :class:`DryRunResult`."""

    report: bytes
    after: dict[str, tuple[int, int]]


class Commit(ChannelMessage, frozen=True):
    """To the successor: the node is yours."""

    record: dict[str, object]  # what it is to remember of the swap
    frames: list[bytes] = []  # what it has reported, and its predecessor has died before it could publish


class Working(ChannelMessage, frozen=True):
    """The successor handles what comes."""

    gap_s: float  # how long neither handled anything; 0 in lockstep
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
