"""``palp bag record`` onto a running graph: until a signal or the graph's end; snapshots on request."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil

from palp_core.errors import BagError
from palp_core.graph.discovery.choice import addressed
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.graph.node.loading import endpoints
from palp_core.graph.node.spec import RECORDER
from palp_core.graph.process.node_services import CallRequest
from palp_core.graph.recording.live_recorder import LiveRecorder
from palp_core.graph.recording.recorder_params import RecorderParams
from palp_core.graph.supervision.interrupt import Interrupt
from palp_core.graph.transport.node_sockets import NodeSockets
from palp_core.graph.transport.request_server import NodeOperation
from palp_core.graph.transport.requester_socket import ask

ANSWER_S = 30.0
PLACE = "recorder-"


def record_until_asked(
    graph: RunningGraph, params: RecorderParams, note: Callable[[str], None]
) -> tuple[bool, str]:
    """Record a running graph until SIGINT, SIGTERM, SIGHUP or its end.

    Return whether nothing is missing, and the account.
    """

    def save(_: CallRequest) -> dict[str, Any]:
        try:
            text = recorder.save()
        except BagError as error:
            text = str(error)
        note(text)
        return {"reply": {"text": text}}

    with Interrupt(breaks_in=False) as interrupt:  # a bag is closed as a whole
        recorder = LiveRecorder(graph, params, note, from_start=False)
        serving = _serving(graph, save) if params.snapshot_s else contextlib.nullcontext()
        with serving as sockets:
            try:
                recorder.await_topics(lambda: interrupt.requested)
                while not (interrupt.requested or recorder.feed.ended):
                    recorder.turn()
                    if sockets is not None:
                        sockets.poll()
            except (OSError, BagError):
                recorder.abandon()
                raise
            except BaseException:
                recorder.close(patient=False)
                raise
            summary = recorder.close(patient=not interrupt.requested)
    text = f"received {summary.text()}" if params.snapshot_s else f"{params.out}: {summary.text()}"
    return summary.complete, text


@contextlib.contextmanager
def _serving(graph: RunningGraph, save: Callable[[CallRequest], dict[str, Any]]) -> Iterator[NodeSockets]:
    """Answer ``save`` in the run directory as a recorder among the nodes does."""
    name = f"{PLACE}{os.getpid()}"
    places = endpoints(str(graph.folder), name)
    sockets = NodeSockets(*places)
    sockets.requests.add(name, {"call": NodeOperation(CallRequest, save)})
    try:
        yield sockets
    finally:
        sockets.close()
        for place in places:
            Path(place.removeprefix("ipc://")).unlink(missing_ok=True)


def save_snapshots(graph: RunningGraph) -> list[str]:
    """Let every recorder that keeps a graph's last seconds write them; return what each answers."""
    nodes = [node for node in graph.record.nodes if node.run == RECORDER and psutil.pid_exists(node.pid)]
    places = {node.name: node.serve for node in nodes}
    for path in sorted(graph.folder.glob(f"{PLACE}*.srv")):
        if psutil.pid_exists(int(path.stem.removeprefix(PLACE))):
            places[path.stem] = f"ipc://{path}"
    texts, silent = [], []
    for name, place in places.items():
        reply = ask(place, {"op": "call", "service": "save", "request": {}}, ANSWER_S)
        if reply is None or "error" in reply:
            silent.append(
                f"recorder {name} did not write its snapshot: {(reply or {}).get('error', 'silent')}"
            )
        else:
            texts.append(reply["reply"]["text"])
    if silent and not any(texts):
        raise BagError("; ".join(silent))
    texts += silent
    if not any(texts):
        start_one = addressed("palp bag record -a --snapshot S", graph.record.id)
        raise BagError(f"no recorder keeps this graph's last seconds; start one: {start_one}")
    return [text for text in texts if text]
