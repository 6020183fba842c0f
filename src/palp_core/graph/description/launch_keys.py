"""Every key of a launch file, as structs: the reader, the schema and the reference page use them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, get_args, get_type_hints

import msgspec
from msgspec import UNSET, Meta, UnsetType, field

from palp_core.graph.messages.qos import MAX_BLOCKING_MS, POLICIES, Qos
from palp_core.graph.node.spec import LONGEST_BACKOFF_S, NAME, NodeSpec

RUN = re.compile(r"(?P<module>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*|[^:]+\.py):(?P<name>[A-Za-z_]\w*)")
DIALECT = "http://json-schema.org/draft-07/schema#"
"""Draft 7, the one that editors' YAML servers know."""

_WIRE = rf"{NAME.pattern}/{NAME.pattern}"
_FUNCTION = r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*"
_ADDRESS = r"tcp://\S+:(\d{1,5}|\*)"
_UNSTATED = NodeSpec(name="", run="")


def _key(says: str, example: Any = None, *, root: bool = False, **more: Any) -> Meta:
    """Return what a key is for; ``root``: it counts in the file that is launched, and in no included one."""
    return Meta(
        description=says, examples=None if example is None else [example], extra={"root": root, **more}
    )


def _text(pattern: str, form: str) -> Meta:
    return Meta(pattern=f"^({pattern})$", extra={"form": form})


Name = Annotated[str, _text(NAME.pattern, "a letter, then letters, digits and _, at most 32")]
Wire = Annotated[str, _text(_WIRE, "node/port")]
Function = Annotated[str, _text(_FUNCTION, "module:function")]
Values = dict[str, Any]


class Keys(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Keys of one mapping of a launch file."""


class ArgumentKeys(Keys):
    """An argument."""

    default: Annotated[
        Any, _key("Its value where none is given, and with that its type; without one it must be given.", 10)
    ] = UNSET
    choices: Annotated[
        list[Any],
        Meta(min_length=1),
        _key(
            "All values that it may have. Without default and choices any value will do.",
            ["fixed", "markov"],
        ),
    ] = []
    or_class: Annotated[
        bool,
        _key(
            "Whether `MODULE:CLASS` or `FILE.py:CLASS` will do as well as a choice. A selection by the "
            "argument has a branch `else` for it: of the node's parameters and inputs the class is given "
            "those that it has."
        ),
    ] = False
    help: Annotated[
        str, _key("What it means, for `palp graph args` and for mistakes.", "trials per phantom")
    ] = ""
    sets: Annotated[
        dict[str, Values],
        _key(
            "By its value, values of other arguments and of shared parameters of this file. What is given "
            "wins over them.",
            {"swift": {"lift_mm": 6.0}},
        ),
    ] = {}


class IncludeKeys(Keys):
    """An included file."""

    file: Annotated[
        str,
        Meta(min_length=1),
        _key("The launch file, relative to the one that includes it.", "parts/world.yaml"),
    ]
    args: Annotated[
        Values,
        _key(
            "Values of its arguments, which then are no arguments of this file.",
            {"noise": "$(var noise)"},
        ),
    ] = {}
    namespace: Annotated[
        Name | UnsetType,
        _key(
            "Goes before the names of its nodes, as in `left_torque`, and into the wires between them: for "
            "a second rig in one graph.",
            "left",
        ),
    ] = UNSET


class CheckpointKeys(Keys):
    """Checkpoints."""

    file: Annotated[
        str,
        Meta(min_length=1),
        _key("Where the latest checkpoint is; relative to where one is.", "$(var out)/checkpoint"),
    ]
    after: Annotated[
        Wire, _key("The output whose messages say that a checkpoint is due.", "experiment/trial")
    ]
    nodes: Annotated[list[str], _key("The nodes whose state is kept.", ["experiment", "policy"])]


Restart = Literal["never", "on_failure"]


class RestartKeys(Keys):
    """Restarts."""

    when: Annotated[
        Restart,
        _key(
            "Whether the node is started again after its process failed. A mapping without it means "
            "`on_failure`."
        ),
    ] = "on_failure"
    max_restarts: Annotated[
        int,
        Meta(ge=0, le=1_000_000),
        _key(
            "How often at most; 30 s of work without a failure, and the count begins again. The failure "
            "after the last restart ends the run, as one without `restart` does."
        ),
    ] = _UNSTATED.max_restarts
    backoff_s: Annotated[
        float,
        Meta(ge=0, le=LONGEST_BACKOFF_S),
        _key("Seconds before the first restart; each further one waits twice as long."),
    ] = _UNSTATED.backoff_s


_QOS_SAYS = {
    "reliability": "`reliable`: what went missing is asked for again; `best_effort`: it is counted.",
    "durability": "`transient_local`: a late joiner gets the publisher's last `depth` messages first.",
    "history": "`keep_all`: `publish()` waits while this reader is `depth` messages behind.",
    "max_blocking_ms": (
        "With `keep_all`, the longest such wait in ms; then `publish()` raises. "
        f"0: {MAX_BLOCKING_MS:g} ms where the publisher states none either."
    ),
    "depth": "Messages kept for readers that missed them; a `best_effort` reader holds no more unread.",
    "deadline_ms": "Longest time between two messages in ms; 0: none stated.",
    "lifespan_ms": "A message older than this, in ms, is not handed over; 0: none stated.",
    "liveliness": "Who asserts that the publisher lives: its process; with `manual_by_topic` each message.",
    "lease_ms": "Longest silence in ms before the publisher counts as dead; 0: none stated.",
}


def _policies() -> Iterator[tuple[str, Any, Any]]:
    """Yield a field for each policy, with the words, bounds and default of :class:`Qos`."""
    standard = Qos()
    for name, kind in get_type_hints(Qos).items():
        bounds = POLICIES[name]
        limits = Meta() if get_args(kind) else Meta(ge=bounds.least, le=bounds.most)
        yield name, Annotated[kind, limits, _key(_QOS_SAYS[name])], getattr(standard, name)


QosKeys: Any = msgspec.defstruct("QosKeys", list(_policies()), bases=(Keys,))
"""What an input may ask of its publisher. Where the input's class states a policy, that is the default."""


class InputKeys(QosKeys):  # type: ignore[misc] # made from Qos, whose fields they are
    """An input."""

    source: Annotated[Wire | UnsetType, _key("The output that it reads.", "phantom/contact")] = field(
        name="from", default=UNSET
    )
    external: Annotated[
        bool,
        _key(
            "In place of `from`: it takes messages from outside the graph, on the topic `/NODE/INPUT`.",
        ),
    ] = False


class NodeKeys(Keys):
    """A node."""

    run: Annotated[
        str,
        _text(re.sub(r"\?P<\w+>", "", RUN.pattern), "module:Class or path.py:Class"),
        _key(
            "The node's class, `module:Class`: the module as the workspace imports it, or a path that ends "
            "in `.py`, relative to the launch file.",
            "nodes.policy_markov:Markov",
            selects=True,
        ),
    ]
    params: Annotated[
        Values,
        _key(
            "Values of its parameters. What is left out is the shared parameter of that name, if there is "
            "one, else the class's default.",
            {"ring_mm": 16.0},
            selects=True,
        ),
    ] = {}
    inputs: Annotated[
        dict[str, Wire | InputKeys],
        _key(
            "Where each input comes from: `node/port`, or a mapping that also asks for a quality of "
            "service. An argument whose value is empty leaves the input open.",
            {"pose": "stage/pose"},
            selects=True,
        ),
    ] = {}
    restart: Annotated[
        Restart | RestartKeys,
        _key(
            "What happens when its process fails once it was active: a handler raises, the process dies or "
            "answers no more. A node that finishes has not failed. The next process begins with a new "
            "state; its inputs go on where the last one was, as far as their publishers keep what came "
            "meanwhile (`depth`). On the wall clock.",
            {"when": "on_failure", "max_restarts": 5},
        ),
    ] = "never"
    on_exit: Annotated[
        Literal["shutdown"] | UnsetType, _key("`shutdown`: when the node has finished, the graph ends.")
    ] = UNSET
    realtime_priority: Annotated[
        int,
        Meta(ge=1, le=99),
        _key("Priority of its process with the real-time scheduler SCHED_FIFO; without it the ordinary one."),
    ] = 0
    joined: Annotated[
        bool,
        _key(
            "Its process is on another host, from where it joins with `palp run --join`. On the wall clock."
        ),
    ] = False
    output: Annotated[
        Literal["screen", "log"],
        _key("`screen`: all that it prints is shown where the graph was launched; `log`: warnings, errors."),
    ] = "log"


class FileKeys(Keys):
    """The file."""

    graph: Annotated[
        Name | UnsetType,
        _key("What the running graph is called; `--graph` of every verb takes it.", "rig", root=True),
    ] = UNSET
    clock: Annotated[
        Literal["sim", "wall"] | UnsetType,
        _key(
            "`sim`: simulated time in lockstep, the same bytes every time; `wall`: the machine's clock.",
            root=True,
        ),
    ] = UNSET
    seed: Annotated[int, Meta(ge=0), _key("Of every random number of the nodes.", root=True)] = 0
    args: Annotated[
        dict[str, ArgumentKeys],
        _key(
            "Arguments by name: `name:=value` on the command line, `$(var name)` in this file.",
            {"trials": {"default": 100}},
        ),
    ] = {}
    shared: Annotated[
        Values,
        _key(
            "Parameters that every node of the graph is given whose class has one of that name, unless the "
            "node states its own. `shared.NAME:=VALUE` on the command line; in an included file with a "
            "namespace for its nodes only.",
            {"noise": "$(var noise)"},
        ),
    ] = {}
    include: Annotated[
        list[IncludeKeys],
        _key(
            "Launch files whose nodes belong to the graph as well.",
            [{"file": "parts/world.yaml"}],
        ),
    ] = []
    nodes: Annotated[
        dict[str, NodeKeys],
        _key(
            "The nodes by name. `NODE.PARAM:=VALUE` on the command line sets a parameter.",
            {"counter": {"run": "count.py:Counter"}},
        ),
    ] = {}
    report: Annotated[
        Function | UnsetType,
        _key(
            "A function that is given the `RunSummary` at the end and returns what to print.",
            "palp_core.palpation.session.report:session",
            root=True,
        ),
    ] = UNSET
    listen: Annotated[
        Annotated[str, _text(f"({_ADDRESS})?", "tcp://HOST:PORT")],
        _key(
            "Where nodes of other hosts may join; port 0 takes any free one. On the wall clock.",
            "tcp://192.168.1.5:7600",
            root=True,
        ),
    ] = ""
    view: Annotated[
        Function | UnsetType,
        _key(
            "A function that fills a page of the graph's own in `palp view`.",
            "palp_core.palpation.live_page.page:rig",
            root=True,
        ),
    ] = UNSET
    checkpoint: Annotated[
        CheckpointKeys | UnsetType,
        _key(
            "On the wall clock: when nodes are written down, for `--resume` after an interruption.",
            {"file": "$(var out)/checkpoint", "after": "experiment/trial", "nodes": ["experiment", "policy"]},
            root=True,
        ),
    ] = UNSET


SECTIONS: Mapping[str, type[Keys]] = {
    "": FileKeys,
    "args.NAME": ArgumentKeys,
    "include[]": IncludeKeys,
    "nodes.NODE": NodeKeys,
    "nodes.NODE.inputs.INPUT": InputKeys,
    "nodes.NODE.restart": RestartKeys,
    "checkpoint": CheckpointKeys,
}
"""Keys by the place in a file; a title is the first line of their docstring."""

SUBSTITUTIONS: Mapping[str, str] = {
    "var": "`$(var name)`: the value of an argument, with its type where it is the whole value.",
    "env": "`$(env NAME default)`: an environment variable; without a default it must be set.",
    "dirname": "`$(dirname)`: the folder of this file.",
    "filename": "`$(filename)`: this file.",
    "now": "`$(now)`: the host's local time at launch, as in `2026-11-22_21-05-09`.",
}
"""What may stand in any value; none holds another."""

_SUBSTITUTION = {"type": "string", "pattern": r"\$\("}
_SELECTION = {
    "type": "object",
    "properties": {"select": {**_SUBSTITUTION, "description": "The argument that chooses: $(var name)."}},
    "required": ["select"],
}


def launch_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 7) of a launch file, as plain values.

    No key of the file itself is required, as a part that is only included has no ``graph`` and ``clock``;
    which arguments, parameters and wires there are, only ``palp launch FILE --check`` knows.
    """
    (_, components) = msgspec.json.schema_components([FileKeys], ref_template="#/definitions/{name}")
    definitions = {name: _with_substitutions(schema) for name, schema in components.items()}
    root = definitions.pop("FileKeys")
    return {
        "$schema": DIALECT,
        **root,
        "title": "palp launch file",
        "description": "A graph: which nodes, with which parameters, wired how.",
        "definitions": definitions,
    }


def _with_substitutions(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a mapping whose values may be substitutions, and some of them selections."""
    selects = {
        item.encode_name
        for cls in SECTIONS.values()
        if cls.__name__ == schema["title"]
        for item in msgspec.structs.fields(cls)
        if meta_of(item.type).get("selects")
    }
    properties = {}
    for name, key in schema["properties"].items():
        about = {part: key.pop(part) for part in ("description", "default", "examples") if part in key}
        if isinstance(about.get("description"), str):
            about["description"] = about["description"].replace("`", "")
        if each := key.get("additionalProperties"):
            key["additionalProperties"] = {"anyOf": [each, _SUBSTITUTION]}
        forms = [key] if key else []
        if forms:
            forms += [_SELECTION] if name in selects else []
            forms += [_SUBSTITUTION, *([{"type": "null"}] if key.get("type") == "object" else [])]
        properties[name] = about | ({"anyOf": forms} if forms else {})
    return {**schema, "properties": properties}


def meta_of(kind: Any) -> dict[str, Any]:
    """Return what the annotations of a key's type say in addition to its description."""
    found: dict[str, Any] = {}
    for meta in getattr(kind, "__metadata__", ()):
        found |= meta.extra or {}
    return found
