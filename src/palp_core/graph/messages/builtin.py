"""Messages that the runtime itself knows."""

from palp_core.graph.messages.message import Message
from palp_core.units import Count, Nanoseconds, Probability, Seconds


class Progress(Message):
    """Progress of a run, which the launch terminal shows.

    ``score`` is a live figure between 0 and 1, such as an accuracy, and counts only where ``score_defined``.
    """

    stamp_ns: Nanoseconds
    phase: str
    done_count: Count
    total_count: Count
    text: str = ""
    score: Probability = 0.0
    score_defined: bool = False
    busy_s: float = 0.0


class Swap(Message):
    """Ask the launcher to replace this node, as an experiment's plan states.

    In simulated time it is done before time goes on. ``params`` (JSON) are the new node's.
    """

    stamp_ns: Nanoseconds
    node: str
    run: str
    params: str = "{}"


class DiagnosticStatus(Message):
    """The state of a node, as ROS 2's message of that name: published at its start and at each change.

    ``level`` is ``ok``, ``warn`` or ``error``: what is not ``ok`` stays in view until it is, in the launch
    view, ``palp top`` and ``palp doctor``. ``text`` is what is wrong, ``advice`` what to do or type about
    it. A port for it is ``transient_local`` with ``depth=1``: a late reader gets the latest.
    """

    stamp_ns: Nanoseconds
    level: str = "ok"
    text: str = ""
    advice: str = ""


class CheaperMethod(Message):
    """A cheaper method that was not taken, and why: its state in the register."""

    name: str
    why: str


class MethodUse(Message):
    """One exchangeable method that a node uses, as the register of methods weighed it.

    ``of`` distinguishes uses of one task, as by a phantom's code. ``asked`` is true where it was named, not
    chosen. ``bound`` is its stated error of ``output`` and counts only where ``bounded``. ``cost_s`` is
    declared, for one use as the task counts them (``per``). ``scene`` (JSON) is what it is used on, SI.
    A method that the register does not know is named by its module and has neither bound nor evidence.
    """

    task: str
    name: str
    of: str = ""
    asked: bool = False
    output: str = ""
    tolerance: float = 0.0
    bound: float = 0.0
    bounded: bool = False
    evidence: str = ""
    cheaper: list[CheaperMethod] = []
    cost_s: Seconds = 0.0
    per: str = ""
    scene: str = "{}"


class MethodsUsed(Message):
    """The methods that a node uses from now on, for ``palp methods why`` and the report.

    Said when the node begins, when it takes another's place, and whenever one of them changes. A port for it
    is ``transient_local``: a late reader gets it, too.
    """

    stamp_ns: Nanoseconds
    uses: list[MethodUse]


class Order(Message):
    """What a node consumed and in which order: enough to drive it again to the same outputs.

    The i-th entry is ``sources[source[i]]``: a transition such as ``activate``, ``input:<port>``,
    ``reply:<client>``, ``call:<service><client topic>``, ``timer:<name>``, ``parameters`` or
    ``outside:<service>``; with its epoch and sequence (of a timer the tick number k, of an event its total
    count, of parameters and calls from outside their place in ``changes``, JSON) and the node's time.
    ``hand_over``, where not empty, is the node's encoded hand-over before the first entry: a place to start.
    """

    stamp_ns: Nanoseconds
    sources: list[str]
    source: list[int]
    epoch: list[int]
    sequence: list[int]
    now_ns: list[int]
    changes: list[str]
    hand_over: bytes


class NodeEvent(Message):
    """An event of a node, on its hidden topic ``/<node>/_events``.

    ``kind`` is ``parameters``, ``transition``, ``deadline``, ``lifespan``, ``liveliness``, ``message_lost``,
    ``reader_overrun`` or ``call_timeout``; ``text`` is for a person, ``data`` (JSON) for a machine.
    """

    stamp_ns: Nanoseconds
    kind: str
    text: str
    data: str


class GraphEvent(Message):
    """Something that happened to a graph: on ``/graph/events``.

    ``kind`` is ``started``, ``failed``, ``restarting``, ``restarted``, ``unresponsive``, ``responsive``,
    ``swapped``, ``joined``, ``left``, ``refused``, ``recorder`` or ``ending``.
    """

    stamp_ns: Nanoseconds
    kind: str
    node: str
    text: str
    data: str


class EdgeHealth(Message):
    """Account of one input since its node began: see ``palp_core.graph.node.sequence_account``.

    Latencies are from the publisher's stamp to arrival and 0 while nothing was received.
    """

    topic: str
    received_count: Count
    lost_count: Count
    repeated_count: Count
    late_count: Count
    dropped_count: Count
    latency_p50_s: Seconds
    latency_p90_s: Seconds
    latency_p99_s: Seconds
    latency_max_s: Seconds


class NodeHealth(Message):
    """How a node's process does, since it began.

    An overrun is a tick that starts after the next one is due; a missed deadline is counted by the reader.
    ``lost_by_readers_count`` is what readers of its topics reported as lost for good.
    ``pid`` is 0 of a node that has joined from another host. ``counted_ns`` is when the node counted, on the
    monotonic clock of its host: rates are between two of these, for who passes it on has a pace of its own.
    """

    node: str
    pid: Count
    lifecycle: str
    memory_bytes: Count
    cpu_s: Seconds
    tick_count: Count
    overrun_count: Count
    missed_deadline_count: Count
    rejected_count: Count
    unread_count: Count
    edges: list[EdgeHealth]
    lost_by_readers_count: Count = 0
    counted_ns: Nanoseconds = 0


class GraphHealth(Message):
    """How all nodes do, joined ones last: on ``/graph/health``, once a second on the wall clock."""

    stamp_ns: Nanoseconds
    nodes: list[NodeHealth]
