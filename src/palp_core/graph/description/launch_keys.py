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
        Any, _key("The value if none is given; it also sets the type. Without it, a value must be given.", 10)
    ] = UNSET
    choices: Annotated[
        list[Any],
        Meta(min_length=1),
        _key(
            "All allowed values. Without default and choices, any value is allowed.",
            ["fixed", "markov"],
        ),
    ] = []
    or_class: Annotated[
        bool,
        _key(
            "Whether `MODULE:CLASS` or `FILE.py:CLASS` is allowed, too. A selection by the argument needs a "
            "branch `else` for it. The class gets those parameters and inputs of the node that it declares."
        ),
    ] = False
    help: Annotated[
        str, _key("The meaning, for `palp graph args` and error messages.", "trials per phantom")
    ] = ""
    sets: Annotated[
        dict[str, Values],
        _key(
            "For each value, the values of other arguments and shared parameters of this file. A value that "
            "you give yourself wins.",
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
            "Values of its arguments, which are then not arguments of this file.",
            {"noise": "$(var noise)"},
        ),
    ] = {}
    namespace: Annotated[
        Name | UnsetType,
        _key(
            "A prefix of its nodes' names, as in `left_torque`, and of the wires between them: for "
            "a second rig in one graph.",
            "left",
        ),
    ] = UNSET


class CheckpointKeys(Keys):
    """Checkpoints."""

    file: Annotated[
        str,
        Meta(min_length=1),
        _key("The file of the latest checkpoint, relative to the present folder.", "$(var out)/checkpoint"),
    ]
    after: Annotated[Wire, _key("The output whose messages cause a checkpoint.", "experiment/trial")]
    nodes: Annotated[list[str], _key("The nodes whose state palp saves.", ["experiment", "policy"])]


Restart = Literal["never", "on_failure"]


class RestartKeys(Keys):
    """Restarts."""

    when: Annotated[
        Restart,
        _key(
            "Whether palp starts the node again after its process failed. A mapping without this key means "
            "`on_failure`."
        ),
    ] = "on_failure"
    max_restarts: Annotated[
        int,
        Meta(ge=0, le=1_000_000),
        _key(
            "Most restarts in a row; after 30 s without a failure the count begins again. The failure "
            "after the last restart ends the run, as a failure without `restart` does."
        ),
    ] = _UNSTATED.max_restarts
    backoff_s: Annotated[
        float,
        Meta(ge=0, le=LONGEST_BACKOFF_S),
        _key("Seconds before the first restart; each further restart waits twice as long."),
    ] = _UNSTATED.backoff_s


_QOS_SAYS = {
    "reliability": "`reliable`: the reader requests missing messages again; `best_effort`: it counts them.",
    "durability": "`transient_local`: a late reader first gets the publisher's last `depth` messages.",
    "history": "`keep_all`: `publish()` waits while this reader is `depth` messages behind.",
    "max_blocking_ms": (
        "With `keep_all`, the longest such wait in ms; then `publish()` raises. "
        f"0: {MAX_BLOCKING_MS:g} ms, unless the publisher states a time."
    ),
    "depth": "Messages that the publisher keeps; also the longest queue of a `best_effort` reader.",
    "deadline_ms": "Longest time between two messages in ms; 0: none stated.",
    "lifespan_ms": "A reader drops messages older than this, in ms; 0: none stated.",
    "liveliness": "`automatic`: the process shows that it lives; `manual_by_topic`: each message does.",
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

    source: Annotated[Wire | UnsetType, _key("The output that the input reads.", "phantom/contact")] = field(
        name="from", default=UNSET
    )
    external: Annotated[
        bool,
        _key(
            "Instead of `from`: the input takes messages from outside the graph, on the topic `/NODE/INPUT`.",
        ),
    ] = False


class NodeKeys(Keys):
    """A node."""

    run: Annotated[
        str,
        _text(re.sub(r"\?P<\w+>", "", RUN.pattern), "module:Class or path.py:Class"),
        _key(
            "The node's class, `module:Class`: a module that the workspace can import, or a path that ends "
            "in `.py`, relative to the launch file.",
            "nodes.policy_markov:Markov",
            selects=True,
        ),
    ]
    params: Annotated[
        Values,
        _key(
            "Values of its parameters. A missing parameter takes the shared value of that name, if there is "
            "one, else the class's default.",
            {"ring_mm": 16.0},
            selects=True,
        ),
    ] = {}
    inputs: Annotated[
        dict[str, Wire | InputKeys],
        _key(
            "The source of each input: `node/port`, or a mapping that also requests a quality of service. "
            "An argument with an empty value leaves the input open.",
            {"pose": "stage/pose"},
            selects=True,
        ),
    ] = {}
    restart: Annotated[
        Restart | RestartKeys,
        _key(
            "Whether palp restarts an active node that failed: a handler raised, or the process died or "
            "stopped answering. The next process begins with a new state. Its inputs continue where the last "
            "process was, as far as the publishers kept the messages (`depth`). On the wall clock.",
            {"when": "on_failure", "max_restarts": 5},
        ),
    ] = "never"
    on_exit: Annotated[
        Literal["shutdown"] | UnsetType, _key("`shutdown`: the graph ends when the node finishes.")
    ] = UNSET
    realtime_priority: Annotated[
        int,
        Meta(ge=1, le=99),
        _key("Priority of its process with the real-time scheduler SCHED_FIFO."),
    ] = 0
    joined: Annotated[
        bool,
        _key("Its process runs on another host and joins with `palp run --join`. On the wall clock."),
    ] = False
    output: Annotated[
        Literal["screen", "log"],
        _key("`screen`: the launch terminal shows all output of the node; `log`: warnings and errors only."),
    ] = "log"


class FileKeys(Keys):
    """The file."""

    graph: Annotated[
        Name | UnsetType,
        _key("Name of the running graph, for `--graph` of every verb.", "rig", root=True),
    ] = UNSET
    clock: Annotated[
        Literal["sim", "wall"] | UnsetType,
        _key(
            "`sim`: simulated time in lockstep, the same bytes every time; `wall`: the host's clock.",
            root=True,
        ),
    ] = UNSET
    seed: Annotated[int, Meta(ge=0), _key("Seed of all random numbers of the nodes.", root=True)] = 0
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
            "Parameter values for every node whose class has a parameter of that name. A value of the node "
            "itself wins. `shared.NAME:=VALUE` sets one on the command line. In an included file with a "
            "namespace they apply to its nodes only.",
            {"noise": "$(var noise)"},
        ),
    ] = {}
    include: Annotated[
        list[IncludeKeys],
        _key(
            "Other launch files whose nodes join the graph.",
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
            "A function that receives the `RunSummary` at the end and returns the text to print.",
            "palp_core.palpation.session.report:session",
            root=True,
        ),
    ] = UNSET
    listen: Annotated[
        Annotated[str, _text(f"({_ADDRESS})?", "tcp://HOST:PORT")],
        _key(
            "Address at which nodes of other hosts may join; port 0 takes a free one. On the wall clock.",
            "tcp://192.168.1.5:7600",
            root=True,
        ),
    ] = ""
    view: Annotated[
        Function | UnsetType,
        _key(
            "A function that fills the graph's own page in `palp view`.",
            "palp_core.palpation.live_page.page:rig",
            root=True,
        ),
    ] = UNSET
    checkpoint: Annotated[
        CheckpointKeys | UnsetType,
        _key(
            "When to save the state of nodes, for `--resume` after an interruption. On the wall clock.",
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
    "var": "`$(var name)`: the value of an argument.",
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
