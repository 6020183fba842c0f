"""A checkpoint on the disk: a run at one instant, and of which run it is. It is there whole, or refused."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, in_words
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.launch.changes_told import ChangeTold
from palp_core.graph.launch.diagnostics import Incident
from palp_core.graph.launch.methods_told import MethodTold
from palp_core.graph.node.loading import source_of
from palp_core.graph.recording.provenance import versions
from palp_core.graph.workspaces.underlays import SHARED, underlays
from palp_core.whole_file import read_whole, write_whole

_MAGIC = b"palp checkpoint 1\n"
_DIGEST_BYTES = 32
_ANEW = "or begin anew, in another place"


class RunIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """What must be as it was, for a run to go on.

    Attributes:
        nodes: Every node as the launch file and its arguments have it, by name.
        versions: Of Python and of the packages that a result depends on.
        sources: Digest of each source file of the workspace's nodes and messages, and of ``palp_core``.
    """

    graph: str
    clock: str
    seed: int
    args: dict[str, Any]
    nodes: dict[str, dict[str, Any]]
    versions: dict[str, str]
    sources: dict[str, str]

    @classmethod
    def of(cls, checked: CheckedGraph, runs: Iterable[str]) -> RunIdentity:
        """Return what a run of a graph is, here and now, with classes that have taken over nodes' work."""
        nodes: dict[str, dict[str, Any]] = {
            spec.name: msgspec.to_builtins(spec) for spec in (*checked.nodes, *checked.recorders)
        }
        found = cls(
            graph=checked.graph,
            clock=checked.clock,
            seed=checked.seed,
            args=msgspec.to_builtins(checked.args),
            nodes=nodes,
            versions=versions(),
            sources=_sources(checked, runs),
        )
        return msgspec.msgpack.decode(msgspec.msgpack.encode(found), type=cls)  # as one that was kept

    def differences(self, now: RunIdentity) -> list[str]:
        """Return in words what is not as it was."""
        found = [
            f"the {what} was {before}, and is {after}"
            for what, before, after in (
                ("clock", self.clock, now.clock),
                ("seed", self.seed, now.seed),
            )
            if before != after
        ]
        found += [
            f"argument {name} was {_shown(self.args, name)}, and is {_shown(now.args, name)}"
            for name in sorted({*self.args, *now.args})
            if self.args.get(name) != now.args.get(name) and name != "seed"
        ]
        found += [] if found else self._changed_nodes(now)
        found += [
            f"{name} was {self.versions.get(name, 'not there')}, and is {now.versions.get(name, 'not there')}"
            for name in sorted({*self.versions, *now.versions})
            if self.versions.get(name) != now.versions.get(name)
        ]
        changed = [
            name
            for name in sorted({*self.sources, *now.sources})
            if self.sources.get(name) != now.sources.get(name)
        ]
        if changed:
            found.append(f"the software has changed: {', '.join(changed)}")
        return found

    def _changed_nodes(self, now: RunIdentity) -> Iterator[str]:
        """Yield what the launch file says otherwise of nodes, with the same arguments."""
        for name in sorted({*self.nodes, *now.nodes}):
            before, after = self.nodes.get(name), now.nodes.get(name)
            if before is None or after is None:
                yield f"the launch file has {'a' if before is None else 'no'} node '{name}'"
            elif before != after:
                keys = sorted(key for key in {*before, *after} if before.get(key) != after.get(key))
                yield f"the launch file says otherwise of node '{name}': {', '.join(keys)}"


class KeptSpec(msgspec.Struct, frozen=True, kw_only=True):
    """A node of a checkpoint: what runs under its name by then, and the node itself, written down."""

    name: str
    run: str
    params: dict[str, Any]
    kept: bytes


class KeptRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run at one instant.

    Attributes:
        identity: What must be as it is, for another to go on from here.
        given: The arguments as the command line had them.
        now_ns: When, on the graph's clock.
        resumed_count: How often the run had been interrupted by then.
        attached: Texts that the report keeps with all that is recorded of the run, by name.
        nodes: Those that the launch file names, in graph order.
        incidents: What nodes had said was wrong, in time's order.
        standing: The place among these of what still is, by topic.
        methods: Which methods nodes had said they use.
        changes: Classes that had taken a node's place, and parameters that had been set.
    """

    identity: RunIdentity
    given: list[str]
    now_ns: int
    resumed_count: int
    attached: dict[str, str]
    nodes: list[KeptSpec]
    incidents: list[Incident] = []
    standing: dict[str, int] = {}
    methods: list[MethodTold] = []
    changes: list[ChangeTold] = []


def write_checkpoint(path: Path, checkpoint: KeptRun) -> int:
    """Write a checkpoint that outlives a power cut; the one before stays if that fails. Return its bytes.

    Args:
        path: Where.
        checkpoint: It.

    Raises:
        OSError: It cannot be written.
    """
    body = msgspec.msgpack.encode(checkpoint)
    data = b"".join((_MAGIC, hashlib.sha256(body).digest(), body))
    write_whole(path, data, durable=True)
    return len(data)


def read_checkpoint(path: Path) -> KeptRun:
    """Return the checkpoint of an unfinished run.

    Raises:
        GraphError: There is none, or it is damaged.
    """
    try:
        data = read_whole(path, 1 << 30)
    except FileNotFoundError:
        raise GraphError(
            f"nothing to resume: there is no checkpoint {path}: the run that was there came to its end, or "
            "ended before its first checkpoint; without --resume one begins, or says what is in its way"
        ) from None
    except OSError as error:
        raise GraphError(f"{path} cannot be read: {error.strerror or error}") from error
    head, body = data[: len(_MAGIC) + _DIGEST_BYTES], data[len(_MAGIC) + _DIGEST_BYTES :]
    if not head.startswith(b"palp checkpoint"):
        raise GraphError(f"{path} is no checkpoint of a run; nothing is resumed")
    if not head.startswith(_MAGIC):
        raise GraphError(f"{path} was written by another version of palp; resume it with that, {_ANEW}")
    if head[len(_MAGIC) :] != hashlib.sha256(body).digest():
        raise GraphError(f"{path} is torn: a part of it is missing or wrong; nothing is resumed: begin anew")
    try:
        return msgspec.msgpack.decode(body, type=KeptRun)
    except msgspec.MsgspecError as error:
        raise GraphError(f"{path} is of another version of palp: {in_words(error)}") from error


def require_same(path: Path, before: RunIdentity, now: RunIdentity) -> None:
    """Refuse to go on with another run than the one that was interrupted.

    Raises:
        GraphError: It is another.
    """
    if found := before.differences(now):
        lines = "".join(f"\n  {one}" for one in found)
        raise GraphError(
            f"{path} is of another run than this one would be:{lines}\nresume it as it was, {_ANEW}"
        )


def _shown(args: Mapping[str, Any], name: str) -> str:
    if name not in args:
        return "not there"
    value = args[name]
    return str(value).lower() if isinstance(value, bool) else f"'{value}'" if value == "" else str(value)


def _sources(checked: CheckedGraph, runs: Iterable[str]) -> dict[str, str]:
    """Return a digest of each file that the nodes may be made of."""
    workspace, files = Path(checked.workspace), set[Path]()
    for run in (*(spec.run for spec in checked.nodes), *runs):
        found = source_of(run, checked.workspace)
        if found is None:
            continue
        path = found[0]
        files.add(path)
        if path.is_relative_to(workspace) and path.parent != workspace:
            files.update((workspace / path.relative_to(workspace).parts[0]).rglob("*.py"))
        for one in underlays():
            if path.is_relative_to(one.folder / "nodes"):
                files.update(file for kind in SHARED for file in (one.folder / kind).rglob("*.py"))
    files.update((workspace / "msgs").rglob("*.py"))
    package = Path(__file__).parents[2]
    own = sorted(package.rglob("*.py"))
    found_digests = {_relative(path, workspace): _digest([path]) for path in sorted(files) if path not in own}
    return {**found_digests, "palp_core": _digest(own)}


def _relative(path: Path, workspace: Path) -> str:
    return str(path.relative_to(workspace)) if path.is_relative_to(workspace) else str(path)


def _digest(files: list[Path]) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
