"""A running graph as tools see it: found by its run directory, asked over its nodes' own sockets."""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from palp_core.errors import GraphError, SchemaMismatch
from palp_core.graph.discovery.choice import choose
from palp_core.graph.discovery.run_directory import END_ASKED, RECORD, NodeEntry, RunRecord, read_record
from palp_core.graph.messages.topic import Topic, topic_of
from palp_core.graph.node.spec import COMPOSITION, HUNG_S, LAUNCHER, MERGED_LOG, topic
from palp_core.graph.problems import hint
from palp_core.whole_file import is_locked, write_whole

if TYPE_CHECKING:
    from palp_core.graph.messages.frame import Frame
    from palp_core.graph.messages.message import Message

REPLY_TIMEOUT_S = 5.0
SWAP_MARGIN_S = 10.0
CHANGES_OF_HANDS = 10
SAFETY_TYPE, SAFETY_NAME = "SafetyBeat", "safety"
LAST = 2**62
"""Above every sequence number."""

MessageType = TypeVar("MessageType", bound="Message")
Request = Callable[[str, dict[str, Any], float], dict[str, Any] | None]


class Service(NamedTuple):
    """A service of a running node: its name, ``/<node>/<port>``, and the types of request and reply."""

    name: str
    node: str
    port: str
    request: str
    reply: str


class Edge(NamedTuple):
    """One input of a running node, and the account that its reader keeps."""

    node: str
    topic: str
    account: dict[str, Any]


class Answers(NamedTuple):
    """Replies of nodes, by name, and why the others did not answer."""

    replies: dict[str, dict[str, Any]]
    silent: dict[str, GraphError]

    def services(self, *, include_hidden: bool = False) -> list[Service]:
        """Return the services of the nodes by their ``info``."""
        found = [
            Service(f"/{node}/{port}", node, port, *types)
            for node, info in self.replies.items()
            for port, types in info.get("services", {}).items()
        ]
        return [service for service in found if include_hidden or not hidden(service.name)]

    def edges(self, topic: str | None = None) -> list[Edge]:
        """Return the inputs of the nodes by their ``info``; of one topic if it is named."""
        return [
            Edge(node, name, account)
            for node, info in self.replies.items()
            for name, account in info.get("inputs", {}).items()
            if topic is None or name == topic
        ]


def no_external_port(name: str, known: Collection[str]) -> GraphError:
    advice = hint(name, known) if known else "; declare it external: true in the launch file"
    return GraphError(f"no port '{name}' takes messages from outside{advice}")


def safety_node(types: Iterable[tuple[str, str]], nodes: Collection[str]) -> str | None:
    """Return the node that stops motion, by the type that it publishes, whatever its name.

    Its name decides where several publish that, or none does: yours may have messages of its own. ``types``
    are pairs of node and type, of every topic.
    """
    beating = [node for node, kind in types if kind == SAFETY_TYPE]
    if SAFETY_NAME in nodes and (not beating or SAFETY_NAME in beating):
        return SAFETY_NAME
    return beating[0] if beating else None


def hidden(name: str) -> bool:
    """Tell whether a name is one of those that are not listed: a part of it begins with an underscore.

    >>> hidden("/relay/_order"), hidden("/relay/amplified")
    (True, False)
    """
    return any(part.startswith("_") for part in name.split("/"))


class RunningGraph:
    """A running graph.

    Args:
        record: What its ``graph.json`` holds; :meth:`refresh` reads it again.
        request: Sends a request to an endpoint and waits so many seconds for the reply; None if none comes.
    """

    def __init__(self, record: RunRecord, request: Request | None = None) -> None:
        self.record = record
        self._request = request or _ask
        self._mark: tuple[int, int] | None = None

    @classmethod
    def find(cls, name: str | None = None) -> RunningGraph:
        """Return the running graph of that name, id or pid; by default the one of the folder one is in.

        Raises:
            GraphError: None runs, or none of that name; or several may be meant.
        """
        return cls(choose(name).record)

    @property
    def folder(self) -> Path:
        return Path(self.record.serve.removeprefix("ipc://")).parent

    def refresh(self) -> RunRecord:
        """Return the record as the run directory has it now; the same object as before if nothing changed."""
        try:
            entry = (self.folder / RECORD).stat()
        except OSError:  # it has ended
            return self.record
        mark = entry.st_mtime_ns, entry.st_ino
        if mark != self._mark and (record := read_record(self.folder)) is not None:
            self._mark = mark
            if record != self.record:
                self.record = record
        return self.record

    @property
    def alive(self) -> bool:
        return is_locked(self.folder)

    @property
    def node_names(self) -> list[str]:
        return [node.name for node in self.record.nodes]

    def node(self, name: str) -> NodeEntry:
        """Return a node by its name, with or without the slash."""
        for entry in self.record.nodes:
            if entry.name == name.removeprefix("/"):
                return entry
        if name.removeprefix("/") == LAUNCHER:  # it publishes and answers as a node does
            return NodeEntry(LAUNCHER, "", self.record.pid, "", self.record.serve)
        known = [f"/{known}" for known in self.node_names]
        fix = "; repeat the command for each node" if name == "/**" else hint(_rooted(name), known)
        raise GraphError(f"no node '{name}' in graph '{self.record.graph}'{fix}")

    def topic(self, name: str) -> Topic:
        rooted = _rooted(name)
        node = rooted.split("/")[1]
        own = self._hidden_topics([node]) if hidden(rooted) and node in self.node_names else []
        for entry in [*self.record.topics, *own]:
            if entry.name == rooted:
                return entry
        names = [topic.name for topic in (*self.record.topics, *own)]
        known = [known for known in names if not hidden(known) or hidden(name)]
        raise GraphError(f"no topic '{name}' in graph '{self.record.graph}'{hint(_rooted(name), known)}")

    def topics(self, *, include_hidden: bool = False) -> list[Topic]:
        """Return the topics, in graph order, then the hidden ones."""
        if include_hidden:
            return [*self.record.topics, *self._hidden_topics(self.node_names)]
        return [topic for topic in self.record.topics if not hidden(topic.name)]

    def _hidden_topics(self, nodes: Iterable[str]) -> list[Topic]:
        """Return what the runtime publishes for each node: its events, and the order of what it consumes."""
        from palp_core.graph.messages.builtin import NodeEvent, Order
        from palp_core.graph.node.journal import ORDER_PORT
        from palp_core.graph.node.qos_events import EVENTS_PORT

        ports: dict[str, type[Message]] = {EVENTS_PORT: NodeEvent, ORDER_PORT: Order}
        return [
            topic_of(topic(entry.name, port), kind, entry.name, entry.publish)
            for entry in map(self.node, nodes)
            for port, kind in ports.items()
        ]

    def ask(
        self,
        node: str,
        operation: str,
        *,
        timeout_s: float = REPLY_TIMEOUT_S,
        retries: int = 0,
        **fields: Any,
    ) -> dict[str, Any]:
        """Ask a node to do something; a repetition carries the same id, so that it is done only once.

        Raises:
            GraphError: No such node, it refuses, or it does not answer in time.
        """
        entry = self.node(node)
        request = {"op": operation, "node": entry.name, "id": uuid.uuid4().hex, **fields}
        reply = None
        for _ in range(retries + 1):
            reply = self._reply(entry.serve, request, timeout_s)
            if reply is not None:
                break
        if reply is None:
            tried = f" in any of {retries + 1} attempts" if retries else ""
            raise GraphError(
                f"/{entry.name} did not answer '{operation}' within {timeout_s:g} s{tried}: "
                f"{self._whereabouts(entry)}"
            )
        if "error" in reply:
            raise GraphError(f"/{entry.name}: {str(reply['error']).removeprefix(f'{entry.name}: ')}")
        return reply

    def _reply(self, serve: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        """Ask; a node that has changed hands meanwhile is asked again."""
        reply = self._request(serve, request, timeout_s)
        for _ in range(CHANGES_OF_HANDS):
            if reply is None or not reply.get("again"):
                break
            reply = self._request(serve, request, timeout_s)
        return reply

    def swap(self, node: str, run: str = "", *, timeout_s: float = 10.0, **options: Any) -> dict[str, Any]:
        """Let another class take a node's place; see :class:`palp_core.graph.swap.swap.SwapRequest`.

        Returns:
            What came of it: ``report``, or ``failed`` with the step that failed and why; then the old node
            goes on.

        Raises:
            GraphError: No such node, or the launcher does not answer.
        """
        probation = options.get("probation") or {}
        wait_s = timeout_s + float(options.get("shadow_s", 0.0)) + SWAP_MARGIN_S
        longest_s = probation.get("longest_s")
        wait_s += float(timeout_s if longest_s is None else longest_s) + HUNG_S[self.record.clock]
        wait_s += 3.0 * timeout_s  # in which the last reports of a probation are moved
        wanted = {"node": node, "run": run, "timeout_s": timeout_s, **options}
        request = {"op": "swap", "node": LAUNCHER, "id": uuid.uuid4().hex, "request": wanted}
        reply = None
        for _ in range(math.ceil(wait_s)):  # by the same id it is done once; a launcher that ends is noticed
            reply = self._request(self.record.serve, request, 1.0)
            if reply is not None or not self.alive:
                break
        if reply is None:
            raise GraphError(f"/{LAUNCHER} did not answer: {self._whereabouts(self.node(LAUNCHER))}")
        if "error" in reply:
            raise GraphError(str(reply["error"]))
        return {key: value for key, value in reply.items() if key in ("report", "failed")}

    def ask_all(
        self,
        operation: str,
        nodes: Iterable[str] | None = None,
        *,
        timeout_s: float = REPLY_TIMEOUT_S,
        **fields: Any,
    ) -> Answers:
        """Ask several nodes (None: all) at the same time, so that a stuck one costs its own time only."""
        from concurrent.futures import ThreadPoolExecutor

        names = self.node_names if nodes is None else list(nodes)
        if not names:  # as when all have yet to join
            return Answers({}, {})

        def ask(name: str) -> dict[str, Any] | GraphError:
            try:
                return self.ask(name, operation, timeout_s=timeout_s, **fields)
            except GraphError as error:
                return error

        with ThreadPoolExecutor(max_workers=min(len(names), 32)) as pool:
            answers = dict(zip(names, pool.map(ask, names), strict=True))
        return Answers(
            {name: answer for name, answer in answers.items() if isinstance(answer, dict)},
            {name: answer for name, answer in answers.items() if isinstance(answer, GraphError)},
        )

    def history(
        self,
        node: str,
        topic: str,
        *,
        first: int = 1,
        last: int = LAST,
        timeout_s: float = REPLY_TIMEOUT_S,
    ) -> list[Frame]:
        """Return the messages of these sequences that a node still has of one of its topics.

        Raises:
            GraphError: No such node, it does not answer, or what it answers is not of this version.
        """
        from palp_core.graph.messages.frame import parse

        reply = self.ask(node, "history", timeout_s=timeout_s, topic=topic, first=first, last=last)
        try:
            return [parse(raw) for raw in reply["frames"]]
        except SchemaMismatch as error:
            raise GraphError(f"/{node}: {error}") from error

    def decoded_history(
        self, node: str, topic: str, kind: type[MessageType], timeout_s: float
    ) -> list[MessageType]:
        from palp_core.graph.messages.message import decode

        frames = self.history(node, topic, timeout_s=timeout_s)
        try:
            return [decode(kind, frame.payload) for frame in frames]
        except SchemaMismatch as error:
            raise GraphError(f"/{node}: {topic}: {error}") from error

    def external_ports(
        self, nodes: Iterable[str] | None = None, *, timeout_s: float = REPLY_TIMEOUT_S
    ) -> dict[str, dict[str, Any]]:
        """Return the described types of the inputs that take messages from outside, by ``/node/port``."""
        infos = self.ask_all("info", nodes, timeout_s=timeout_s).replies
        external = {node: info["external"] for node, info in infos.items() if info.get("external")}
        schemas = self.ask_all("schemas", external, timeout_s=timeout_s).replies
        return {
            topic(node, port): reply["ports"][port]["types"][0]
            for node, reply in schemas.items()
            for port in external[node]
        }

    def external_port(
        self, name: str, *, timeout_s: float = REPLY_TIMEOUT_S
    ) -> tuple[str, str, dict[str, Any]]:
        """Return node, port and described type of an input that takes messages from outside."""
        name = _rooted(name)
        node, _, port = name[1:].partition("/")
        if node in self.node_names:
            self.ask(node, "info", timeout_s=timeout_s)  # one that does not answer is not "no such port"
        known = self.external_ports([node], timeout_s=timeout_s) if node in self.node_names else {}
        if name in known:
            return node, port, known[name]
        if any(name == entry.name for entry in self.record.topics):
            raise GraphError(
                f"{name} is published by /{self.topic(name).node}, and a topic has one publisher; "
                "publish into a port that the launch file declares external: true"
            )
        raise no_external_port(name, self.external_ports(timeout_s=timeout_s))

    def moves_something_real(self) -> bool:
        """Tell whether a node moves something on the wall clock; True if the launcher does not answer."""
        if self.record.clock == "sim":
            return False
        try:
            nodes = self.ask(LAUNCHER, "launch")["nodes"]
        except GraphError:
            return True
        return any(spec.get("moves") for spec in nodes)

    def typed_parameters(
        self, node: str, texts: Mapping[str, str], *, timeout_s: float = REPLY_TIMEOUT_S
    ) -> dict[str, Any]:
        from palp_core.graph.discovery.message_yaml import typed_parameters

        declared = self.ask(node, "describe_parameters", timeout_s=timeout_s)["parameters"]
        return typed_parameters(node, declared, texts)

    @contextlib.contextmanager
    def ask_to_end(self, asked_by: str) -> Iterator[Callable[[float], bool]]:
        """Ask the graph to end, as Ctrl-C at its launch does; yield a function that waits for it."""
        record = self.record
        ended = f"graph '{record.graph}' has ended already"
        try:
            process = os.pidfd_open(record.pid)
        except OSError as error:
            raise GraphError(ended) from error
        try:
            if not self.alive:  # asked once the process is held: its number cannot be another's from here on
                raise GraphError(ended)
            with contextlib.suppress(OSError):  # a full disk: then it only knows of the signal
                write_whole(self.folder / END_ASKED, asked_by)
            try:
                signal.pidfd_send_signal(process, signal.SIGINT)
            except OSError as error:
                why = f"graph '{record.graph}' (pid {record.pid}) cannot be asked to end: {error.strerror}"
                raise GraphError(why) from error
            waiting = select.poll()  # select.select() takes no descriptor above 1023
            waiting.register(process, select.POLLIN)
            yield lambda timeout_s: bool(waiting.poll(timeout_s * 1e3))
        finally:
            os.close(process)

    def process_of(self, entry: NodeEntry) -> int:
        """Return the process of a node: its own, the launcher's if it is composed, or 0 on another host."""
        composed = Path(entry.serve).stem == COMPOSITION
        return self.record.pid if composed or entry.name == LAUNCHER else entry.pid

    def _whereabouts(self, entry: NodeEntry) -> str:
        """Return why a node may be silent, and what to look at."""
        import psutil

        pid = self.process_of(entry)
        if pid == 0:
            return "it has joined from elsewhere; look there, and at the connection"
        log = self.folder / "log" / f"{entry.name if entry.pid else MERGED_LOG}.log"
        try:
            status = psutil.Process(pid).status()
        except psutil.NoSuchProcess:
            status = psutil.STATUS_ZOMBIE
        if status == psutil.STATUS_ZOMBIE:  # or it is dead, and who started it has not asked yet
            return f"its process {pid} is gone; see {log}"
        if status == psutil.STATUS_STOPPED:
            return f"its process {pid} is stopped; continue it with: kill -CONT {pid}"
        return f"its process {pid} runs, but a handler may not return; see {log}"

    def service(self, name: str, timeout_s: float = REPLY_TIMEOUT_S) -> Service:
        """Return a service by its name, from the word of its node."""
        node, _, port = _rooted(name)[1:].partition("/")
        if node in self.node_names:
            known = Answers({node: self.ask(node, "info", timeout_s=timeout_s)}, {}).services()
        else:
            known = self.ask_all("info", timeout_s=timeout_s).services()
        for service in known:
            if service.node == node and service.port == port:
                return service
        names = [service.name for service in known]
        raise GraphError(f"no service '{name}' in graph '{self.record.graph}'{hint(_rooted(name), names)}")


def _ask(endpoint: str, request: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
    # A quarter of a second that `palp node list` does without.
    from palp_core.graph.transport.requester_socket import ask

    return ask(endpoint, request, timeout_s)


def _rooted(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"
