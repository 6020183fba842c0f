"""One node of a checkpoint: its hand-over, as a later run goes on with it."""

from palp_core.errors import SchemaMismatch, in_words
from palp_core.graph.messages.message import decode_any, encode_any
from palp_core.graph.node.executor import Executor
from palp_core.graph.node.handover import HandOver, adopt_state
from palp_core.graph.node.node import class_name
from palp_core.graph.rng import rng_from_text


def keep(executor: Executor) -> bytes:
    """Write a node down; it notices nothing of it."""
    return encode_any(executor.snapshot())


def restore(executor: Executor, data: bytes) -> None:
    """Give a node that is about to be activated the state and randomness it had."""
    try:
        hand_over = decode_any(HandOver, data)
    except (ValueError, TypeError) as error:
        raise SchemaMismatch(f"the checkpoint is of another version: {in_words(error)}") from error
    executor.node.state = adopt_state(executor.declaration.state, class_name(type(executor.node)), hand_over)
    executor.rng = rng_from_text(hand_over.rng)
    executor.run_hook("on_restore")
