"""The checkpoints of a run on the wall clock, from which an interrupted one goes on.

The nodes that the launch file names write themselves down when the message comes after which it is due; all
others begin again. A checkpoint replaces the one before whole or not at all, and is removed when the run has
come to its end. A run in simulated time is run again: that takes seconds.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import logging
import os
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import GraphError, in_words
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.launch.run_journal import JournalEntries
from palp_core.graph.node.loading import source_of
from palp_core.graph.recording.provenance import versions
from palp_core.graph.swap.compatibility import incompatibilities, replaced
from palp_core.graph.workspaces.underlays import SHARED, underlays
from palp_core.whole_file import read_whole, write_whole

Inspect = Callable[[list[NodeClassRequest], Path], list[NodeClass]]
RESUMES = "the run goes on, and could be resumed where the last one was written"
_LOG = logging.getLogger("palp.supervisor")
_MAGIC = b"palp checkpoint 2\n"
_DIGEST_BYTES = 32
_ELSEWHERE = "or begin again, in another place"
_MISSING = object()
_PALP_CORE = "palp_core"


def facts_of(checked: CheckedGraph, runs: Iterable[str]) -> dict[str, Any]:
    """Return what must be as it was for a run to go on; ``runs`` are classes that have taken over."""
    facts: dict[str, Any] = {"the clock": checked.clock, "the seed": checked.seed}
    facts |= {f"argument {name}": value for name, value in checked.args.items() if name != "seed"}
    facts |= {
        f"node '{spec.name}'": msgspec.to_builtins(spec) for spec in (*checked.nodes, *checked.recorders)
    }
    facts |= versions()
    facts |= _sources(checked, runs)
    kept: dict[str, Any] = msgspec.msgpack.decode(msgspec.msgpack.encode(facts))  # as they are written down
    return kept


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return which facts are not as they were; where arguments differ, nodes do for that."""
    found = {}
    for name in dict.fromkeys((*before, *now)):
        old, new = before.get(name, _MISSING), now.get(name, _MISSING)
        if old == new:
            continue
        if isinstance(old, dict) and isinstance(new, dict):
            keys = (key for key in {*old, *new} if old.get(key, _MISSING) != new.get(key, _MISSING))
            found[name] = f"{name} differs in {', '.join(sorted(keys))}"
        elif name.startswith("node "):
            found[name] = f"the launch file has {'a' if old is _MISSING else 'no'} {name}"
        elif name.startswith("file ") or name == _PALP_CORE:
            found[name] = f"{name} has changed"
        else:
            found[name] = f"{name} was {_shown(old)}, and is {_shown(new)}"
    is_given = any(name.startswith(("the ", "argument ")) for name in found)
    return [text for name, text in found.items() if not (is_given and name.startswith("node "))]


class KeptNode(msgspec.Struct, frozen=True, kw_only=True):
    """A node of a checkpoint: what runs under its name by then, and the node itself, written down."""

    name: str
    run: str
    params: dict[str, Any]
    kept: bytes


class KeptRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run at one instant."""

    facts: dict[str, Any]
    given: list[str]
    now_ns: int
    resumed_count: int
    attached: dict[str, str]
    nodes: list[KeptNode]
    journal: JournalEntries


def write_checkpoint(path: Path, checkpoint: KeptRun) -> int:
    """Write a checkpoint that outlives a power cut; the one before stays if that fails. Return its bytes."""
    body = msgspec.msgpack.encode(checkpoint)
    data = b"".join((_MAGIC, hashlib.sha256(body).digest(), body))
    write_whole(path, data, durable=True)
    return len(data)


def read_checkpoint(path: Path) -> KeptRun:
    try:
        data = read_whole(path, 1 << 30)
    except FileNotFoundError:
        raise GraphError(
            f"no checkpoint {path} (run finished, or stopped before its first one); start without --resume"
        ) from None
    except OSError as error:
        raise GraphError(f"{path} cannot be read: {error.strerror or error}") from error
    head, body = data[: len(_MAGIC) + _DIGEST_BYTES], data[len(_MAGIC) + _DIGEST_BYTES :]
    if not head.startswith(b"palp checkpoint"):
        raise GraphError(f"{path} is not a checkpoint; start again without --resume")
    if not head.startswith(_MAGIC):
        raise GraphError(f"{path} was written by another version of palp; resume it with that, {_ELSEWHERE}")
    if head[len(_MAGIC) :] != hashlib.sha256(body).digest():
        raise GraphError(f"{path} is incomplete or damaged; start again without --resume")
    try:
        return msgspec.msgpack.decode(body, type=KeptRun)
    except msgspec.MsgspecError as error:
        raise GraphError(f"{path} is from another version of palp: {in_words(error)}") from error


class Checkpoints:
    """The checkpoints of one run."""

    def __init__(self, checked: CheckedGraph, given: Sequence[str], *, resume: bool) -> None:
        keys = checked.checkpoint
        if resume and checked.clock == "sim":
            raise GraphError(f"{checked.file}: a run in simulated time cannot resume; run it again")
        if resume and keys is None:
            raise GraphError(
                f"{checked.file}: cannot resume: the launch file writes no checkpoint; add "
                "checkpoint: {file: PATH, after: node/port, nodes: [node, ...]}"
            )
        self.path = None if keys is None else Path(keys.file).absolute()
        self.count = 0
        self._launched, self._given = checked, list(given)
        self._facts: dict[str, Any] = {}
        self._runs: set[str] = set()
        self._lock = -1
        self._failed = ""
        self._gathered: dict[int, dict[str, bytes]] = {}
        self.resumed: KeptRun | None = None
        if resume and self.path is not None:
            if self.path.exists():  # else there may be no folder either
                self._hold()
            try:
                self.resumed = self._read(self.path)
            except GraphError:
                self.close()
                raise

    def _read(self, path: Path) -> KeptRun:
        found = read_checkpoint(path)
        self._runs = {node.run for node in found.nodes}
        self._facts = facts_of(self._launched, self._runs)
        if changed := differences(found.facts, self._facts):
            lines = "".join(f"\n  {text}" for text in changed)
            raise GraphError(
                f"{path} is from another run than this one would be:{lines}\n"
                f"resume it as it was, {_ELSEWHERE}"
            )
        if lost := [run for run in self._runs if source_of(run, self._launched.workspace) is None]:
            raise GraphError(f"{path} cannot be resumed: no source file of {', '.join(lost)} is found")
        return found

    @property
    def resumed_count(self) -> int:
        return 0 if self.resumed is None else self.resumed.resumed_count + 1

    def _hold(self) -> None:
        """Keep other runs from the checkpoint until :meth:`close`."""
        assert self.path is not None
        lock = self.path.with_name(f".{self.path.name}.lock")
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(self._lock).st_ino != lock.stat().st_ino:
                raise BlockingIOError
        except (BlockingIOError, FileNotFoundError):
            self.close(remove=False)
            raise GraphError(f"{self.path} is in use: its run is still going") from None
        except OSError as error:
            raise GraphError(f"no checkpoint can be written to {self.path}: {error.strerror}") from error

    def begin(self) -> None:
        """Keep other runs from the checkpoint, now that the run begins."""
        if self.path is None or self._lock >= 0:
            return
        if self.path.exists() and not self._launched.report:
            raise GraphError(
                f"{self.path} is from an unfinished run; continue it with --resume, or remove the file"
            )
        self._hold()

    def with_successors(self, inspect: Inspect) -> CheckedGraph:
        """Return the graph as it was at the checkpoint: with the nodes that had taken over by then."""
        checked = self._launched
        for kept in self.resumed.nodes if self.resumed is not None else ():
            spec = next(spec for spec in checked.nodes if spec.name == kept.name)
            if (spec.run, spec.params) == (kept.run, kept.params):
                continue
            request = NodeClassRequest(kept.run, kept.params, name=kept.name)
            (found,) = inspect([request], Path(checked.workspace))
            found = msgspec.structs.replace(found, run=kept.run)
            if wrong := incompatibilities(checked, spec, found):
                text = f"{kept.run}, which had taken over '{kept.name}': {'; '.join(wrong)}"
                raise GraphError(f"{self.path} cannot be resumed: {text}")
            checked = replaced(checked, spec, found, kept.params)
        return checked

    def gather(self, name: str, sequence: int, node: bytes) -> Mapping[str, bytes]:
        """Take a node that was written down at a message; return all, once all are there."""
        wanted = {spec.name for spec in self._launched.spawned if spec.keeps_at}
        gathered = self._gathered.setdefault(sequence, {})
        gathered[name] = node
        if not gathered.keys() >= wanted:
            return {}
        self._gathered = {at: nodes for at, nodes in self._gathered.items() if at > sequence}
        return gathered

    def write(
        self, checked: CheckedGraph, kept: Mapping[str, bytes], now_ns: int, journal: JournalEntries
    ) -> str | None:
        """Write a checkpoint; if that fails, the one before stays.

        Returns:
            Why it failed, "" where it succeeds again, None where neither is news.
        """
        assert self.path is not None
        nodes = [
            KeptNode(name=spec.name, run=spec.run, params=spec.params, kept=kept[spec.name])
            for spec in checked.spawned
            if kept.get(spec.name)
        ]
        runs = {node.run for node in nodes}
        if not self._facts or runs != self._runs:
            self._runs, self._facts = runs, facts_of(self._launched, runs)
        checkpoint = KeptRun(
            facts=self._facts,
            given=self._given,
            now_ns=now_ns,
            resumed_count=self.resumed_count,
            attached=checked.attached,
            nodes=nodes,
            journal=journal,
        )
        try:
            write_checkpoint(self.path, checkpoint)
        except OSError as error:
            text = f"no checkpoint can be written to {self.path}: {error.strerror or error}"
            if text == self._failed:
                return None
            _LOG.warning("%s; %s", text, RESUMES)
            self._failed = text
            return text
        self.count += 1
        failed, self._failed = self._failed, ""
        return "" if failed else None

    def command(self, file: Path) -> str:
        """Return the command by which the run of a launch file, which has ended, goes on; "" if it cannot."""
        if self.path is None or not self.count or not self.path.exists():
            return ""
        named = {word.partition(":=")[0] for word in self._given}
        where = [  # a folder that was named by the time would be another one
            f"{name}:={value}"
            for name, value in self._launched.args.items()
            if name not in named
            and isinstance(value, str)
            and value
            and self.path.is_relative_to(Path(value).absolute())
        ]
        return shlex.join(["palp", "launch", str(file), *self._given, *where, "--resume"])

    def finish(self) -> None:
        if self.path is not None and self._lock >= 0:
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)

    def close(self, *, remove: bool = True) -> None:
        if self._lock < 0 or self.path is None:
            return
        if remove:
            with contextlib.suppress(OSError):
                self.path.with_name(f".{self.path.name}.lock").unlink(missing_ok=True)
        os.close(self._lock)
        self._lock = -1


def _shown(value: Any) -> str:
    if value is _MISSING:
        return "not there"
    return str(value).lower() if isinstance(value, bool) else f"'{value}'" if value == "" else str(value)


def _sources(checked: CheckedGraph, runs: Iterable[str]) -> dict[str, str]:
    """Return a digest of each file that the nodes may be made of."""
    workspace, files = Path(checked.workspace), set[Path]()
    for run in (*(spec.run for spec in checked.nodes), *runs):
        found = source_of(run, checked.workspace)
        if found is None:
            continue
        path = found[0]
        files.update((path, *path.parent.glob("*.py")))  # what it may import from next to it
        if path.is_relative_to(workspace) and path.parent != workspace:
            files.update((workspace / path.relative_to(workspace).parts[0]).rglob("*.py"))
        for underlay in underlays():
            if path.is_relative_to(underlay.folder / "nodes"):
                files.update(file for kind in SHARED for file in (underlay.folder / kind).rglob("*.py"))
    files.update((workspace / "msgs").rglob("*.py"))
    own = sorted(Path(__file__).parents[2].rglob("*.py"))
    digests = {
        f"file {path.relative_to(workspace) if path.is_relative_to(workspace) else path}": _digest([path])
        for path in sorted(files)
        if path not in own
    }
    return {**digests, _PALP_CORE: _digest(own)}


def _digest(files: list[Path]) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
