"""Checkpoints of a graph composed into one process."""

from collections.abc import Sequence
from functools import partial

import msgspec

from palp_core.graph.lockstep.composition import Composition
from palp_core.graph.process import checkpoint
from palp_core.graph.process.control_messages import Done


class ComposedKeeper:
    """Writes the nodes of a composition down, and lets others go on from there.

    Args:
        composition: Has the nodes.
    """

    def __init__(self, composition: Composition) -> None:
        self._composition = composition

    def keep(self) -> list[bytes]:
        """Write every node down, in graph order."""
        composition = self._composition
        return [checkpoint.keep(composition.executor(index)) for index in range(len(composition.names))]

    def restore(self, kept: Sequence[bytes]) -> list[Done]:
        """Let every node go on from what was written down; return when each is due."""
        return [self._restored(index, node) for index, node in enumerate(kept)]

    def _restored(self, index: int, node: bytes) -> Done:
        composition = self._composition
        done = composition.work_unheard(index, partial(checkpoint.restore, composition.executor(index), node))
        return msgspec.structs.replace(done, frames=[])
