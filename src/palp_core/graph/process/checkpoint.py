"""One node of a checkpoint: its hand-over, and what a successor in the same run need not be told."""

import msgspec

from palp_core.errors import SchemaMismatch, in_words
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver, adopt_state
from palp_core.graph.node.journal import KeptJournal
from palp_core.graph.node.node import class_name
from palp_core.graph.rng import rng_from_text


class KeptNode(msgspec.Struct, frozen=True, kw_only=True):
    """A node at a handler boundary, as another run goes on with it."""

    hand_over: HandOver
    journal: KeptJournal


def keep(executor: Executor) -> bytes:
    """Write a node down; it notices nothing of it.

    Raises:
        NodeError: Its state cannot be written down.
    """
    kept = KeptNode(hand_over=executor.succession.copy(), journal=executor.journal.keep())
    return encode_any(kept)


def published(data: bytes) -> dict[str, int]:
    """Return the last sequence of each output of a node that was kept."""
    return _decoded(data).hand_over.published


def restore(executor: Executor, data: bytes) -> None:
    """Go on where a node was kept, with all others: what it publishes next is what it would have published.

    What it says as it takes up has been said before the interruption: the caller lets nobody hear it, and
    ports and randomness are put where they were.

    Raises:
        SchemaMismatch, GraphError: State or parameters do not fit the class.
        NodeError: A hook failed.
    """
    kept = _decoded(data)
    hand_over = kept.hand_over
    executor.succession.take_over(hand_over)
    executor.failing.hook("on_restore", alone=False)
    executor.ends.resume(hand_over)
    executor.rng = rng_from_text(hand_over.rng)
    executor.journal.restore(kept.journal)
    if hand_over.finished:
        executor.finish(0)


def restore_alone(executor: Executor, data: bytes) -> None:
    """Give a node that is about to be activated the state and randomness it had: the wall clock.

    Raises:
        SchemaMismatch: The state does not fit the class.
        NodeError: The hook failed.
    """
    hand_over = _decoded(data).hand_over
    executor.node.state = adopt_state(executor.declaration.state, class_name(type(executor.node)), hand_over)
    executor.rng = rng_from_text(hand_over.rng)
    executor.failing.hook("on_restore", alone=True)


def _decoded(data: bytes) -> KeptNode:
    try:
        return decode_any(KeptNode, data)
    except (ValueError, TypeError) as error:
        raise SchemaMismatch(f"the checkpoint is of another version: {in_words(error)}") from error
