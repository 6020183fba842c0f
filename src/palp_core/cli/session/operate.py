"""``palp session operate``: the operator's terminal."""

from __future__ import annotations

import select
import sys
from typing import TYPE_CHECKING, Any

import typer

from palp_core.cli import options
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph, note_ended
from palp_core.errors import GraphError, PalpError

if TYPE_CHECKING:
    from palp_core.graph.discovery.running_graph import RunningGraph
    from palp_core.graph.messages.frame import Frame
    from palp_core.graph.messages.topic import Topic

PROMPT, SHOWN = "Prompt", ("Countdown", "EffortBars")
_BAR = 30


def operate(*, timeout: options.TimeoutOption = 5.0, graph: options.GraphOption = None) -> None:
    """Enter alone is an answer, too."""
    from palp_core.graph.discovery.topic_reader import TopicReader

    with options.until_ctrl_c():
        running = find_graph(graph, changes=True)
        topics = [topic for topic in running.record.topics if topic.type in (PROMPT, *SHOWN)]
        if not any(topic.type == PROMPT for topic in topics):
            raise GraphError(f"nothing in graph '{running.record.graph}' asks anything of an operator")
        desk = Desk(running, topics, timeout)
        with TopicReader(running, topics, history_depth=1) as reader:
            for received in reader.messages():
                if received is not None and received.is_message:
                    desk.show(received.frame)
                elif received is None and (line := typed()) is not None:
                    desk.answer(line)
    note_ended(running)
    if desk.undelivered:
        raise typer.Exit(1)


class Desk:
    """The operator's screen, and where an answer goes; ``undelivered``: no node took the last."""

    def __init__(self, running: RunningGraph, topics: list[Topic], timeout_s: float) -> None:
        self._running, self._timeout_s = running, timeout_s
        self._topics = {topic.name: topic for topic in topics}
        self._prompts: list[tuple[str, dict[str, Any]]] = []
        self.undelivered = False

    def show(self, frame: Frame) -> None:
        """Show a message: a prompt as a line of its own, what changes all the time over itself."""
        import msgspec

        topic = self._topics[frame.topic]
        message: dict[str, Any] = msgspec.msgpack.decode(frame.payload)
        if topic.type == PROMPT:
            self._prompts = [one for one in self._prompts if one[0] != topic.node]
            if message["kind"] != "none":
                self._prompts.append((topic.node, message))
            choices = f" [{' / '.join(filter(None, message['choices']))}]" if any(message["choices"]) else ""
            sys.stdout.write("\r\x1b[K")
            print_text(message["text"] + choices)
        elif topic.type == "Countdown":
            sys.stdout.write(f"\r\x1b[K{message['what']}: {message['left_s']:.0f} s left ")
        else:
            sys.stdout.write(f"\r\x1b[K{effort_line(message)}")
        sys.stdout.flush()

    def answer(self, line: str) -> None:
        """Send what was typed to the node that asked last; a name does not leave this terminal."""
        from palp_core.palpation.session.human.questions import refuse_names

        if not self._prompts:
            note("nothing is asked")
            return
        node, prompt = self._prompts[-1]
        request = {"number": prompt["number"], "text": line, "by": "terminal"}
        try:
            refuse_names(prompt["text"], line)
            reply = self._running.ask(
                node, "call", timeout_s=self._timeout_s, retries=2, service="answer", request=request
            )["reply"]
        except PalpError as error:
            self.undelivered = isinstance(error, GraphError) and not self._running.alive
            note(str(error))
            return
        if not reply["taken"]:
            note(reply["text"])


def effort_line(message: dict[str, Any]) -> str:
    """Return both muscles' effort as bars.

    >>> effort_line({"fds": 1.0, "edc": 0.0, "clipped": False}).count("#")
    30
    """
    bars = "  ".join(
        f"{name.upper()} |{'#' * round(_BAR * min(1.0, message[name])):<{_BAR}}|" for name in ("fds", "edc")
    )
    return bars + ("  CLIPPED" if message["clipped"] else "")


def typed() -> str | None:
    """Return a line that was typed, None while there is none."""
    if not select.select([sys.stdin], [], [], 0)[0]:
        return None
    line = sys.stdin.readline()
    if not line:
        raise typer.Exit(0)
    return line.strip()
