"""What a publisher tells its readers when it goes on at another place."""

from __future__ import annotations

import msgspec

from palp_core.errors import SchemaMismatch
from palp_core.graph.messages.message import decode_any


class Move(msgspec.Struct, frozen=True):
    """Payload of a frame of kind MOVED.

    Attributes:
        phase: ``prepare``: listen there too; ``here``: this is that place, and it speaks from now on;
            ``gone``: from here comes nothing more; ``stay``: forget that place.
        publish: That place's endpoint.
        serve: Where it answers.
    """

    phase: str
    publish: str
    serve: str


def read_move(payload: memoryview) -> Move:
    """Decode a MOVED frame's payload.

    Raises:
        SchemaMismatch: It is none, or sends readers to another host.
    """
    move = decode_any(Move, payload)
    if not (move.publish.startswith("ipc://") and move.serve.startswith("ipc://")):
        raise SchemaMismatch(f"a publisher cannot move to {move.publish}")
    return move
