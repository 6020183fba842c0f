"""Put together what a node's predecessor had not yet taken up and what its successor has heard itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from palp_core.graph.messages.frame import Frame, Kind
from palp_core.graph.node.handover import HandOver
from palp_core.graph.node.subscription import Subscription
from palp_core.graph.transport.reorder_buffer import ReorderBuffer


def merged(
    inbox: deque[Frame],
    hand_over: HandOver,
    buffers: Mapping[str, ReorderBuffer],
    inputs: Mapping[str, list[Subscription]],
) -> list[Frame]:
    """Return what the successor has to take up, each message once: the predecessor's first, then its own.

    Args:
        inbox: The successor's; the predecessor's frames are the last of it.
        hand_over: The predecessor's.
        buffers: The successor's, by topic; they go on where the predecessor's were.
        inputs: The successor's, by topic.

    Raises:
        SchemaMismatch: A message was heard by neither.
    """
    count = len(inbox) - len(hand_over.inbox)
    frames = list(inbox)
    own, theirs = frames[:count], [frame for frame in frames[count:] if frame.topic in buffers]
    last = {name: (counter.epoch, counter.sequence) for name, counter in hand_over.consumed.items()}
    for frame in theirs:
        last[frame.topic] = max(last.get(frame.topic, (-1, 0)), (frame.epoch, frame.sequence))
    for name, buffer in buffers.items():
        buffer.succeed(*last.get(name, (-1, 0)))
        buffer.unread = 0
    had = {(frame.topic, frame.epoch, frame.sequence) for frame in theirs}
    for frame in own:
        buffer = buffers[frame.topic]
        if buffer.is_ordered:
            is_new = (frame.epoch, frame.sequence) > last.get(frame.topic, (-1, 0))
        else:
            is_new = (frame.topic, frame.epoch, frame.sequence) not in had
            is_new = is_new and any(wired.expects(frame) for wired in inputs[frame.topic])
        if is_new:
            theirs.append(frame)
    for frame in theirs:
        buffers[frame.topic].unread += frame.kind == Kind.DATA
    return theirs
