"""A graph's recorder: a process of its own, so that nothing it does slows or ends the graph.

When the launcher's channel ends, whether the graph has ended or the launcher was killed, it takes what is
still on its way and finishes the bag.

Run as ``python -m palp_core.graph.recording.recorder_process <descriptor of the channel>``.
"""

import contextlib
import select
import signal
import socket
import sys

from palp_core.errors import PalpError
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.process.channel import ChannelClosed, ChannelMessage, MessageChannel
from palp_core.graph.recording import recorder_messages
from palp_core.graph.recording.recorder_run import RecorderRun


class LaunchedRecorder(RecorderRun):
    """A recording that a launcher ends."""

    def __init__(self, channel: MessageChannel[recorder_messages.StartRecording]) -> None:
        super().__init__(lambda text: self.send(recorder_messages.RecorderNote(text)))
        self._channel = channel

    def send(self, message: ChannelMessage) -> None:
        """Send the launcher a message, if it is still there."""
        with contextlib.suppress(ChannelClosed):
            self._channel.send(message)

    def end_wanted(self) -> bool:
        return super().end_wanted() or bool(select.select((self._channel.socket,), (), (), 0.0)[0])


def main(connection: socket.socket) -> int:
    """Record until the channel ends."""
    channel: MessageChannel[recorder_messages.StartRecording] = MessageChannel(
        connection, recorder_messages.to_recorder()
    )
    run = LaunchedRecorder(channel)
    with run.signals():
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C is for the launcher, which ends us
        try:
            request = channel.receive()
            complete, text = run.record(
                RunningGraph(request.record),
                request.options,
                lambda: run.send(recorder_messages.RecordingStarted()),
            )
        except ChannelClosed:
            return 1
        except PalpError as error:
            run.send(recorder_messages.RecorderRefused(str(error)))
            return 2
    run.send(recorder_messages.RecordingFinished(complete, text))
    return 0 if complete else 1


if __name__ == "__main__":
    sys.exit(main(socket.socket(fileno=int(sys.argv[1]))))
