"""A graph's recorder: a process of its own, so that nothing it does slows or ends the graph.

When the launcher's line ends, whether the graph has ended or the launcher was killed, it takes what is still
on its way and finishes the bag.

Run as ``python -m palp_core.graph.recording.recorder_process <descriptor of the line>``.
"""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import sys

from palp_core.errors import PalpError
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.recording.recorder_messages import (
    Record,
    Recorded,
    Recording,
    Refused,
    Said,
    to_recorder,
)
from palp_core.graph.recording.recorder_run import RecordRun


class _Led(RecordRun):
    """A recording that a launcher ends."""

    def __init__(self, line: MessageChannel[Record]) -> None:
        super().__init__(lambda text: self.tell(Said(text)))
        self._line = line

    def tell(self, word: ChannelMessage) -> None:
        """Say something to the launcher, if it is still there."""
        with contextlib.suppress(ChannelClosed):
            self._line.send(word)

    def wanted(self) -> bool:
        return super().wanted() or bool(select.select((self._line.socket,), (), (), 0.0)[0])


def main(connection: socket.socket) -> int:
    """Record until the line ends."""
    line: MessageChannel[Record] = MessageChannel(connection, to_recorder())
    run = _Led(line)
    with run.signals():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for the launcher, which ends us
        try:
            told = line.receive()
            complete, text = run.record(
                RunningGraph(told.record), told.options, lambda: run.tell(Recording())
            )
        except ChannelClosed:
            return 1
        except PalpError as error:
            run.tell(Refused(str(error)))
            return 2
    run.tell(Recorded(complete, text))
    return 0 if complete else 1


if __name__ == "__main__":
    sys.exit(main(socket.socket(fileno=int(sys.argv[1]))))
