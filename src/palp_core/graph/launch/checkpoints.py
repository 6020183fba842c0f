"""The checkpoints of one run: when one is due, what is written, and where an interrupted run goes on.

On the wall clock the nodes that the launch file names write themselves down when the message comes that says
it is due; all others begin again. A checkpoint replaces the one before whole or not at all, and is removed
when the run has come to its end. A run in simulated time is run again: that takes seconds.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.clock import monotonic_ns
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import NodeClass, NodeClassRequest
from palp_core.graph.launch.checkpoint_file import (
    KeptRun,
    KeptSpec,
    RunIdentity,
    read_checkpoint,
    require_same,
    write_checkpoint,
)
from palp_core.graph.node.loading import source_of
from palp_core.graph.swap.compatibility import incompatibilities, replaced

Inspect = Callable[[list[NodeClassRequest], Path], list[NodeClass]]
_LOG = logging.getLogger("palp.supervisor")


RESUMES = "the run goes on, and could be resumed where the last one was written"


class CheckpointCost(msgspec.Struct):
    """What the checkpoints of a run have cost.

    Attributes:
        count: How many were written.
        bytes: Size of the latest one.
        spent_ns: Time of all of them, on the machine's clock.
    """

    count: int = 0
    bytes: int = 0
    spent_ns: int = 0


class Checkpoints:
    """The checkpoints of one run.

    Args:
        checked: The graph, as the launch file has it.
        given: Its arguments as the command line has them.
        resume: Go on from the latest one.

    Attributes:
        resumed: What the run goes on from; None: it begins.
        on_trouble: Is told why a checkpoint could not be written, and "" once one could again.
        cost: What they have cost so far.

    Raises:
        GraphError: The launch file asks for none, there is none, it is damaged, of another run, or another
            run writes there.
    """

    def __init__(self, checked: CheckedGraph, given: Sequence[str], *, resume: bool) -> None:
        entry = checked.checkpoint
        if resume and checked.clock == "sim":
            raise GraphError(f"{checked.file}: a run in simulated time cannot resume; run it again")
        if resume and entry is None:
            raise GraphError(
                f"{checked.file}: cannot resume: the launch file writes no checkpoint; add "
                "checkpoint: {file: PATH, after: node/port, nodes: [node, ...]}"
            )
        self.cost = CheckpointCost()
        self.path = None if entry is None else Path(entry.file).absolute()
        self._launched, self._given = checked, list(given)
        self._identity: RunIdentity | None = None
        self._runs: set[str] = set()
        self._lock = -1
        self._failed = ""
        self.on_trouble: Callable[[str], None] = lambda _: None
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
        self._identity = RunIdentity.of(self._launched, self._runs)
        require_same(path, found.identity, self._identity)
        if lost := [run for run in self._runs if source_of(run, self._launched.workspace) is None]:
            raise GraphError(f"{path} cannot be resumed: no source file of {', '.join(lost)} is found")
        return found

    @property
    def resumed_count(self) -> int:
        """How often the run was interrupted."""
        return 0 if self.resumed is None else self.resumed.resumed_count + 1

    @property
    def attached(self) -> dict[str, str] | None:
        """What the interrupted run has kept with all that is recorded of it; None: the run begins."""
        return None if self.resumed is None else self.resumed.attached

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
            raise GraphError(f"{self.path} is being written: the run that it is of goes on already") from None
        except OSError as error:
            raise GraphError(f"no checkpoint can be written to {self.path}: {error.strerror}") from error

    def begin(self) -> None:
        """Keep other runs from the checkpoint, now that the run begins.

        Raises:
            GraphError: Another one writes it, nothing can be written there, or an unfinished run would be
            lost that no report of the launch file has looked at.
        """
        if self.path is None or self._lock >= 0:
            return
        if self.path.exists() and not self._launched.report:
            raise GraphError(
                f"{self.path} is of an unfinished run: --resume goes on with it; remove it to begin anew"
            )
        self._hold()

    def with_successors(self, inspect: Inspect) -> CheckedGraph:
        """Return the graph as it was at the checkpoint: with the nodes that had taken over by then.

        Raises:
            GraphError: One of them cannot be had any more.
        """
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

    def write(self, checked: CheckedGraph, kept: Sequence[bytes], begun_ns: int, **known: object) -> None:
        """Write a checkpoint; if that fails, the one before stays, and it is said once.

        Args:
            checked: The graph as it is now.
            kept: Nodes, written down, in the order of the graph.
            begun_ns: When that began, on the machine's monotonic clock.
            known: Other fields of the checkpoint.
        """
        assert self.path is not None
        nodes = [
            KeptSpec(name=spec.name, run=spec.run, params=spec.params, kept=node)
            for spec, node in zip(checked.spawned, kept, strict=True)
            if node
        ]
        runs = {node.run for node in nodes}
        if self._identity is None or runs != self._runs:
            self._runs, self._identity = runs, RunIdentity.of(self._launched, runs)
        checkpoint = KeptRun(
            identity=self._identity,
            given=self._given,
            resumed_count=self.resumed_count,
            attached=checked.attached,
            nodes=nodes,
            **known,  # type: ignore[arg-type]
        )
        try:
            self.cost.bytes = write_checkpoint(self.path, checkpoint, sealed=checked.blind)
        except OSError as error:
            self._say(f"no checkpoint can be written to {self.path}: {error.strerror or error}")
            return
        if self._failed:
            self._failed = ""
            self.on_trouble("")
        self.cost.count += 1
        self.cost.spent_ns += monotonic_ns() - begun_ns

    def _say(self, text: str) -> None:
        if text != self._failed:
            _LOG.warning("%s; %s", text, RESUMES)
            self.on_trouble(text)
        self._failed = text

    def command(self, file: Path) -> str:
        """Return the command by which the run, which has ended, goes on; "" if it cannot.

        Args:
            file: The launch file, as it was given.
        """
        if self.path is None or not self.cost.count or not self.path.exists():
            return ""
        named = {word.partition(":=")[0] for word in self._given}
        where = [  # a folder that was named by the time would be another one
            f"{name}:={value}"
            for name, value in self._launched.args.items()
            if name not in named and isinstance(value, str) and value and self._is_in(value)
        ]
        return shlex.join(["palp", "launch", str(file), *self._given, *where, "--resume"])

    def _is_in(self, folder: str) -> bool:
        return self.path is not None and self.path.is_relative_to(Path(folder).absolute())

    def finish(self) -> None:
        """Remove the checkpoint: the run has come to its end."""
        if self.path is not None and self._lock >= 0:
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)

    def close(self, *, remove: bool = True) -> None:
        """Let other runs have the checkpoint."""
        if self._lock < 0 or self.path is None:
            return
        if remove:
            with contextlib.suppress(OSError):
                self.path.with_name(f".{self.path.name}.lock").unlink(missing_ok=True)
        os.close(self._lock)
        self._lock = -1
