"""Every key of a launch file, told once: the checker, the reference and the schema for editors go by it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_type_hints

from palp_core.graph.messages.qos import MAX_BLOCKING_MS, POLICIES, Qos
from palp_core.graph.node.spec import LONGEST_BACKOFF_S, NAME, NodeSpec

Form = Literal["text", "word", "whole", "number", "flag", "any", "list", "mapping"]
"""What stands at a key: ``whole`` is a whole number, ``flag`` true or false."""

HIGHEST_PRIORITY = 99
MOST_RESTARTS = 1_000_000

ADDRESS = re.compile(r"tcp://\S+:(\d{1,5}|\*)")
FUNCTION = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
RUN = re.compile(r"(?P<module>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*|[^:]+\.py):(?P<name>[A-Za-z_]\w*)")
WIRE = re.compile(rf"{NAME.pattern}/{NAME.pattern}")


@dataclass(frozen=True, kw_only=True)
class Key:
    """One key.

    Attributes:
        says: What it is for, a sentence.
        form: What stands there.
        example: A value as it is written.
        words: All that a word may be.
        pattern: What a text must match as a whole.
        least: Smallest number.
        most: Largest number; None: none is too large.
        default: What holds without the key, as it would be written; "": nothing does.
        required: Whether the mapping must have it.
        keys: Keys of the mapping that stands there, or of each item of the list.
        each: Keys of what each name of the author's own leads to.
        short: A plain value that may stand in the mapping's place.
        selects: Whether ``{select: $(var name), branch: ...}`` may stand there.
        root_only: Counts in the file that is launched, and in no included one.
    """

    says: str
    form: Form = "text"
    example: str = ""
    words: tuple[str, ...] = ()
    pattern: re.Pattern[str] | None = None
    least: int = 0
    most: int | None = None
    default: str = ""
    required: bool = False
    keys: Mapping[str, Key] | None = None
    each: Mapping[str, Key] | None = None
    short: Key | None = None
    selects: bool = False
    root_only: bool = False


Table = Mapping[str, Key]

ARGUMENT: Table = {
    "default": Key(
        says="Its value where none is given, and with that its type; without one it must be given.",
        form="any",
        example="10",
    ),
    "choices": Key(
        says="All values that it may have. Without default and choices any value will do.",
        form="list",
        example="[fixed, markov]",
    ),
    "or_class": Key(
        says="Whether `MODULE:CLASS` or `FILE.py:CLASS` will do as well as a choice. A selection by the "
        "argument has a branch `else` for it: of its parameters and inputs the class is given what it has.",
        form="flag",
        default="false",
    ),
    "help": Key(says="What it means, for `--show-args` and for mistakes.", example="trials per phantom"),
    "sets": Key(
        says="By its value, defaults of other arguments of this file. What is given wins over them.",
        form="mapping",
        example="{swift: {lift_mm: 6.0}}",
    ),
}
"""Of an argument under ``args``."""

INCLUDE: Table = {
    "file": Key(
        says="The launch file, relative to the one that includes it.",
        example="parts/world.yaml",
        required=True,
    ),
    "args": Key(
        says="Values of its arguments, which then are no arguments of this file.",
        form="mapping",
        example="{noise: $(var noise)}",
    ),
    "namespace": Key(
        says="Goes before the names of its nodes, as in `left_torque`, and into the wires between them: for "
        "a second rig in one graph.",
        pattern=NAME,
        example="left",
    ),
}
"""Of an item under ``include``."""

CHECKPOINT: Table = {
    "file": Key(
        says="Where the latest checkpoint is; relative to where one is.",
        example="$(var out)/checkpoint",
        required=True,
    ),
    "after": Key(
        says="The output whose messages say that a checkpoint is due.",
        pattern=WIRE,
        example="experiment/trial",
        required=True,
    ),
    "nodes": Key(
        says="The nodes whose state is kept.",
        form="list",
        example="[experiment, policy]",
        required=True,
    ),
}
"""Of ``checkpoint``."""

_RESTARTS = ("never", "on_failure")
_UNSTATED = NodeSpec(name="", run="")

RESTART: Table = {
    "when": Key(
        says="Whether the node is started again after its process failed. A mapping without it means "
        "`on_failure`.",
        form="word",
        words=_RESTARTS,
        default="on_failure",
    ),
    "max_restarts": Key(
        says="How often at most; 30 s of work without a failure, and the count begins anew. The failure "
        "after the last restart ends the run, as one without `restart` does.",
        form="whole",
        most=MOST_RESTARTS,
        default=str(_UNSTATED.max_restarts),
    ),
    "backoff_s": Key(
        says="Seconds before the first restart; each further one waits twice as long.",
        form="number",
        most=LONGEST_BACKOFF_S,
        default=str(_UNSTATED.backoff_s),
    ),
}
"""Of ``restart`` of a node, where it is a mapping."""

_QOS_SAYS = {
    "reliability": "`reliable`: what went missing is asked for again; `best_effort`: it is counted.",
    "durability": "`transient_local`: a late joiner gets the publisher's last `depth` messages first.",
    "history": "`keep_all`: `publish()` waits while this reader is `depth` messages behind.",
    "max_blocking_ms": (
        "With `keep_all`, the longest such wait in ms; then `publish()` raises. "
        f"0: {MAX_BLOCKING_MS:g} ms where the publisher states none either."
    ),
    "depth": "Messages that are kept for whoever missed them; a `best_effort` reader holds no more unread.",
    "deadline_ms": "Longest time between two messages in ms; 0: none stated.",
    "lifespan_ms": "A message older than this, in ms, is not handed over; 0: none stated.",
    "liveliness": "Who asserts that the publisher lives: its process; with `manual_by_topic` each message.",
    "lease_ms": "Longest silence in ms before the publisher counts as dead; 0: none stated.",
}


def _qos_keys() -> Iterator[tuple[str, Key]]:
    """Yield a key for each policy, with words, bounds and default as :class:`Qos` has them."""
    standard = Qos()
    for name, kind in get_type_hints(Qos).items():
        default = getattr(standard, name)
        shown = default if isinstance(default, str) else f"{default:g}"
        if words := get_args(kind):
            yield name, Key(says=_QOS_SAYS[name], form="word", words=words, default=shown)
        else:
            form: Form = "whole" if kind is int else "number"
            bounds = POLICIES[name]
            yield (
                name,
                Key(says=_QOS_SAYS[name], form=form, least=bounds.least, most=bounds.most, default=shown),
            )


QOS: Table = dict(_qos_keys())
"""What an input may ask of its publisher. Where the input's class states a policy, that is the default."""

INPUT: Table = {
    "from": Key(says="The output that it reads.", pattern=WIRE, example="phantom/contact"),
    "external": Key(
        says="In place of `from`: it takes messages from outside the graph, on the topic `/NODE/INPUT`.",
        form="flag",
        default="false",
    ),
    "on_event": Key(
        says="What happens when what is asked for is not kept: a warning, or the node is started again, "
        "or the graph ends. On the wall clock.",
        form="word",
        words=("warn", "restart", "shutdown"),
        default="warn",
    ),
    **QOS,
}
"""Of an input, where it is a mapping."""

NODE: Table = {
    "run": Key(
        says="The node's class, `module:Class`: the module as the workspace imports it, or a path that ends "
        "in `.py`, relative to the launch file.",
        pattern=RUN,
        example="nodes.policy_markov:Markov",
        required=True,
        selects=True,
    ),
    "params": Key(
        says="Values of its parameters. What is left out has the class's default.",
        form="mapping",
        example="{ring_mm: 16.0}",
        selects=True,
    ),
    "inputs": Key(
        says="Where each input comes from: `node/port`, or a mapping that also asks for a quality of "
        "service. An argument whose value is empty leaves the input open.",
        form="mapping",
        example="{pose: stage/pose}",
        each=INPUT,
        short=Key(says="The output that it reads.", pattern=WIRE),
        selects=True,
    ),
    "restart": Key(
        says="What happens when its process fails once it was at work: a handler raises, the process dies or "
        "answers no more. A node that finishes has not failed. The next process begins with a new state; its "
        "inputs go on where the last one was, as far as their publishers keep what came meanwhile (`depth`). "
        "On the wall clock.",
        form="mapping",
        example="{when: on_failure, max_restarts: 5}",
        keys=RESTART,
        short=Key(says="As `when`.", form="word", words=_RESTARTS),
        default="never",
    ),
    "on_exit": Key(
        says="`shutdown`: when the node has finished, the graph ends.", form="word", words=("shutdown",)
    ),
    "cpus": Key(says="Cores on which its process may run; without it all.", form="list", example="[0, 1]"),
    "realtime_priority": Key(
        says="Priority of its process with the real-time scheduler SCHED_FIFO; without it the ordinary one.",
        form="whole",
        least=1,
        most=HIGHEST_PRIORITY,
    ),
    "joined": Key(
        says="Its process is on another host, from where it joins with `palp run --join`. On the wall clock.",
        form="flag",
        default="false",
    ),
    "output": Key(
        says="`screen`: all that it prints is shown where the graph was launched; `log`: warnings, errors.",
        form="word",
        words=("screen", "log"),
        default="log",
    ),
}
"""Of a node under ``nodes``."""

LAUNCH_FILE: Table = {
    "graph": Key(
        says="What the running graph is called; `--graph` of every verb takes it.",
        pattern=NAME,
        example="rig",
        required=True,
        root_only=True,
    ),
    "clock": Key(
        says="`sim`: simulated time in lockstep, the same bytes every time; `wall`: the machine's clock.",
        form="word",
        words=("sim", "wall"),
        required=True,
        root_only=True,
    ),
    "seed": Key(says="Of every random number of the nodes.", form="whole", default="0", root_only=True),
    "args": Key(
        says="Arguments by name: `name:=value` on the command line, `$(var name)` in this file.",
        form="mapping",
        example="{trials: {default: 100}}",
        each=ARGUMENT,
    ),
    "include": Key(
        says="Launch files whose nodes belong to the graph as well.",
        form="list",
        example="[{file: parts/world.yaml}]",
        keys=INCLUDE,
    ),
    "nodes": Key(
        says="The nodes by name.",
        form="mapping",
        example="{counter: {run: count.py:Counter}}",
        each=NODE,
    ),
    "report": Key(
        says="A function that is given the `RunSummary` at the end and returns what to print.",
        pattern=FUNCTION,
        example="palp_core.palpation.session.report:session",
        root_only=True,
    ),
    "listen": Key(
        says="Where nodes of other hosts may join; port 0 takes any free one. On the wall clock.",
        pattern=ADDRESS,
        example="tcp://192.168.1.5:7600",
        root_only=True,
    ),
    "view": Key(
        says="A function that fills a page of the graph's own in `palp view`.",
        pattern=FUNCTION,
        example="palp_core.palpation.live_page.page:rig",
        root_only=True,
    ),
    "blind": Key(
        says="Whether `palp view` shows only what its page names as harmless, and a checkpoint is sealed.",
        form="flag",
        default="false",
        root_only=True,
    ),
    "checkpoint": Key(
        says="On the wall clock: when nodes are written down, for `--resume` after an interruption.",
        form="mapping",
        example="{file: $(var out)/checkpoint, after: experiment/trial, nodes: [experiment, policy]}",
        keys=CHECKPOINT,
        root_only=True,
    ),
}
"""Of a launch file."""

SUBSTITUTIONS: Mapping[str, str] = {
    "var": "`$(var name)`: the value of an argument, with its type where nothing else stands beside it.",
    "env": "`$(env NAME default)`: an environment variable; without a default it must be set.",
    "dirname": "`$(dirname)`: the folder of this file.",
    "filename": "`$(filename)`: this file.",
    "now": "`$(now)`: the host's local time at launch, as in `2026-11-22_21-05-09`.",
}
"""What may stand in any value; none holds another."""

SECTIONS: Mapping[str, tuple[str, Table]] = {
    "": ("The file", LAUNCH_FILE),
    "args.NAME": ("An argument", ARGUMENT),
    "include[]": ("An included file", INCLUDE),
    "nodes.NODE": ("A node", NODE),
    "nodes.NODE.inputs.INPUT": ("An input", INPUT),
    "nodes.NODE.restart": ("Restarts", RESTART),
    "checkpoint": ("Checkpoints", CHECKPOINT),
}
"""Title and keys by the place in a file."""


def as_plain(key: Key, text: str) -> Any:
    """Return a default as a value of its form."""
    match key.form:
        case "flag":
            return text == "true"
        case "whole":
            return int(text)
        case "number":
            return float(text)
    return text
