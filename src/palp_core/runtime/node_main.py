"""The main function of a node's process: connect, configure, then follow the conductor or the wall clock."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import select
import signal
import socket
import sys
from typing import Any

import msgspec

from palp_core.errors import NodeError, PalpError, in_words
from palp_core.runtime.birth import NodeProcess, endpoints, load_class
from palp_core.runtime.builtin import Progress
from palp_core.runtime.clock import SimClock, WallClock, monotonic_ns
from palp_core.runtime.executor import Executor
from palp_core.runtime.lifecycle import Lifecycle, Transition
from palp_core.runtime.link import (
    Activate,
    Configured,
    Done,
    Failed,
    Hello,
    Link,
    LinkClosed,
    Matched,
    Relay,
    Round,
    Shutdown,
    ToNode,
    node_end,
)
from palp_core.runtime.zmq_bus import Broadcast, Subscriber

__all__ = ["describe_running", "follow_round", "run_node"]

HEARTBEAT_NS = 100_000_000


def run_node(birth: NodeProcess) -> int:
    """Run one node until the supervisor ends it, and return the exit status of its process."""
    logging.basicConfig(
        level=logging.INFO,
        format=f"[%(levelname)s] [{birth.spec.name}]: %(message)s",
        stream=sys.stderr,
        force=True,
    )
    link = node_end(f"{birth.run_dir}/supervisor.sock")
    link.send(Hello(birth.spec.name, os.getpid()))
    for number in (signal.SIGINT, signal.SIGTERM):  # the loop sees the end of the line, at a handler boundary
        signal.signal(number, lambda *_: link.socket.shutdown(socket.SHUT_RD))
    process: _Lockstep | _Wall | None = None
    try:
        process = _Lockstep(birth, link) if birth.clock == "sim" else _Wall(birth, link)
        gc.collect()
        gc.freeze()
        process.run()
    except LinkClosed:
        _safe_end(process)
        return 1
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        text = in_words(error)
        trace = None if isinstance(error, NodeError) else error  # a NodeError's trace is in the log already
        logging.getLogger("palp").error("%s", text, exc_info=trace)  # noqa: TRY400
        with contextlib.suppress(LinkClosed):
            link.send(Failed(text))
        _safe_end(process)
        return 1
    return 0


def _safe_end(process: _Lockstep | _Wall | None) -> None:
    if process is not None:
        with contextlib.suppress(PalpError, SystemExit, KeyboardInterrupt):
            process.executor.transition(Transition.SHUTDOWN)
        process.broadcast.close()


def _offer(broadcast: Broadcast, executor: Executor) -> None:
    broadcast.offer(executor.outlets.values())
    broadcast.answer("info", lambda _: describe_running(executor))


def describe_running(executor: Executor) -> dict[str, Any]:
    """Return what a running node says of itself, as a plain map."""
    return {
        "name": executor.name,
        "run": executor.spec.run,
        "lifecycle": executor.lifecycle.value,
        "params": msgspec.to_builtins(executor.node.params),
        "published": {name: outlet.sequence for name, outlet in executor.outlets.items()},
        "inputs": {name: msgspec.to_builtins(counter) for name, counter in executor.counters.items()},
        "rejected": executor.rejected_count,
    }


class _Lockstep:
    """A node that works when the conductor says so."""

    def __init__(self, birth: NodeProcess, link: Link[ToNode]) -> None:
        self.link = link
        self.broadcast = Broadcast(*endpoints(birth.run_dir, birth.spec.name))
        self.clock = SimClock()
        self.frames: list[bytes] = []
        node_class = load_class(birth.spec.run, birth.workspace)
        self.executor = Executor(node_class, birth.spec, self.clock, self._send)
        _offer(self.broadcast, self.executor)
        self.executor.transition(Transition.CONFIGURE)
        self._poll = select.poll()
        for descriptor in (link.socket.fileno(), *self.broadcast.file_descriptors):
            self._poll.register(descriptor, select.POLLIN)

    def _send(self, frame: bytes) -> None:
        self.frames.append(frame)
        if self.broadcast.heard:
            self.broadcast.send(frame)

    def _await_conductor(self) -> None:
        """Answer tools while the conductor has no work for this node."""
        if self.broadcast.heard:  # sending may have swallowed a descriptor's signal
            self.broadcast.poll()
        line = self.link.socket.fileno()
        ready: set[int] = set()
        while line not in ready and not self.link.buffered():
            ready = {descriptor for descriptor, _ in self._poll.poll()}
            if ready - {line}:
                self.broadcast.poll()

    def run(self) -> None:
        """Follow the conductor until it shuts the node down."""
        self.link.send(Configured())
        self.link.send(Matched())
        while True:
            self._await_conductor()
            message = self.link.receive()
            self.frames = []
            if isinstance(message, Round):
                follow_round(self.executor, self.clock, message)
            elif isinstance(message, Activate):
                self.executor.transition(Transition.ACTIVATE)
            else:
                self.clock.set(message.now_ns)
                self.executor.transition(Transition.SHUTDOWN)
            due_ns = self.executor.next_due_ns()
            self.link.send(Done(self.frames, -1 if due_ns is None else due_ns, self.executor.exit_code))
            if isinstance(message, Shutdown):
                self.broadcast.close()
                return


def follow_round(executor: Executor, clock: SimClock, message: Round) -> None:
    """Do one node's part of a lockstep round: due timers first, then the messages in the given order."""
    clock.set(message.now_ns)
    executor.run_timers()
    for frame in message.frames:
        executor.consume(frame)


class _Wall:
    """A node that follows the machine's clock."""

    def __init__(self, birth: NodeProcess, link: Link[ToNode]) -> None:
        self.link = link
        self.broadcast = Broadcast(*endpoints(birth.run_dir, birth.spec.name))
        self.clock = WallClock(monotonic_ns())
        node_class = load_class(birth.spec.run, birth.workspace)
        self.executor = Executor(node_class, birth.spec, self, self._send)
        self.executor.transition(Transition.CONFIGURE)
        _offer(self.broadcast, self.executor)
        self._progress = {
            outlet.topic.encode() for outlet in self.executor.outlets.values() if outlet.message is Progress
        }
        publishers = {
            name: endpoints(birth.run_dir, name.split("/")[1])[0] for name in self.executor.counters
        }
        self.subscriber = Subscriber(publishers)
        self._unmatched = {name.encode() for name in publishers}
        self._next_beat_ns = 0

    def now_ns(self) -> int:
        """Return the time since the graph's start; the start is known at activation."""
        return self.clock.now_ns()

    def _send(self, frame: bytes) -> None:
        self.broadcast.send(frame)
        if self._progress and frame[: frame.index(0)] in self._progress and self._heard():
            self.link.send(Relay(frame, None))

    def _heard(self) -> bool:
        """Tell whether the supervisor keeps up: a node that moves something waits for no terminal."""
        return bool(select.select((), (self.link.socket,), (), 0.0)[1])

    def run(self) -> None:
        """Follow the clock until the supervisor shuts the node down."""
        self.link.send(Configured())
        executor = self.executor
        announced = finished = False
        while True:
            self._wait()
            self.broadcast.poll()
            for frame in self.subscriber.receive():
                if self._unmatched:
                    self._unmatched.discard(frame[: frame.index(0)])
                executor.inbox.append(frame)
            if not announced and not self._unmatched:
                announced = True
                self.link.send(Matched())
            if self._command():
                return
            executor.run_timers()
            while self._backlog() and not self._spoken() and monotonic_ns() < self._next_beat_ns:
                executor.consume(executor.inbox.popleft())
                executor.run_timers()
            if executor.exit_code is not None and not finished:
                finished = True
                self.link.send(Relay(b"", executor.exit_code))

    def _wait(self) -> None:
        now_ns = monotonic_ns()
        if now_ns >= self._next_beat_ns:
            self.broadcast.beat()
            self._next_beat_ns = now_ns + HEARTBEAT_NS
        timeout_s = (self._next_beat_ns - now_ns) / 1e9
        due_ns = self.executor.next_due_ns()
        if due_ns is not None:
            timeout_s = min(timeout_s, (due_ns - self.now_ns()) / 1e9)
        waiting = self._backlog() or self.link.buffered()
        waiting = waiting or self.subscriber.pending() or self.broadcast.pending()
        if timeout_s > 0.0 and not waiting:
            descriptors = (
                self.link.socket.fileno(),
                self.subscriber.file_descriptor,
                *self.broadcast.file_descriptors,
            )
            select.select(descriptors, (), (), timeout_s)

    def _backlog(self) -> bool:
        return bool(self.executor.inbox) and self.executor.lifecycle is Lifecycle.ACTIVE

    def _spoken(self) -> bool:
        return self.link.buffered() or bool(select.select((self.link.socket,), (), (), 0.0)[0])

    def _command(self) -> bool:
        """Obey the supervisor if it has spoken; return True when the node has ended."""
        if not self._spoken():
            return False
        message = self.link.receive()
        if isinstance(message, Activate):
            self.clock = WallClock(message.start_ns)
            self.executor.transition(Transition.ACTIVATE)
        elif isinstance(message, Shutdown):
            self.executor.transition(Transition.SHUTDOWN)
            self.link.send(Done([], -1, self.executor.exit_code))
            self.subscriber.close()
            self.broadcast.close()
            return True
        return False
