"""Two hosts in one: users with run directories and keys of their own, and a workspace of small nodes."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import psutil
import zmq

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.network.keys import KeyFolder, OwnKeys
from palp_core.graph.node.spec import LAUNCHER
from tests.support.palp import PATIENCE_S, Palp, short_folder, wait_for_error
from tests.support.supervised import Running, write_files

TOYS = '''
from palp_core import Message, Node, Params, Pub, Srv, State, Sub, every, on, serve


class Tick(Message):
    index: int
    sent_ns: int = 0
    data: bytes = b""


class Tock(Message):
    index: int


class Rate(Params):
    rate_hz: float = 100.0
    size: int = 0
    count: int = 0


class Count(State):
    index: int = 0


class Ticker(Node):
    """Count aloud."""

    params: Rate
    state: Count
    tick = Pub(Tick)
    reset = Srv(Tock, Tock)

    @every("rate_hz")
    def count(self):
        self.state.index += 1
        now_ns = self.now_ns()
        self.tick.publish(Tick(index=self.state.index, sent_ns=now_ns, data=bytes(self.params.size)))
        if self.state.index == self.params.count:
            self.finish()

    @serve(reset)
    def begin_again(self, request):
        before, self.state.index = self.state.index, request.index
        return Tock(index=before)


class Notes(Params):
    notes: str = ""


class Keeper(Node):
    """Write down what comes and what happens to it."""

    params: Notes
    state: Count
    tick = Sub(Tick)
    received = Pub(Tock)

    def note(self, *words):
        with open(self.params.notes, "a") as notes:
            notes.write(" ".join(map(str, words)) + "\\n")

    def on_activate(self):
        self.note("active")

    def on_deactivate(self):
        self.note("safe")

    @on(tick)
    def take(self, tick):
        self.note("tick", tick.index, tick.sent_ns, self.now_ns())
        self.received.publish(Tock(index=tick.index))
'''

LAUNCH = """
graph: home
clock: wall
args:
  notes: {default: "", help: of the keeper}
  rate_hz: {default: 100.0, help: of the ticker}
  size: {default: 0, help: bytes of a tick}
nodes:
  ticker: {run: "nodes.toys:Ticker", params: {rate_hz: $(var rate_hz), size: $(var size)}}
  keeper:
    run: nodes.toys:Keeper
    params: {notes: $(var notes)}
    inputs: {tick: {external: true}}
"""


class NoteBook:
    """A named pipe into which a node writes; its reader waits for it."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self.path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        self._text = b""

    def line(self) -> list[str]:
        """Wait for the next line; return its words."""
        while b"\n" not in self._text:
            assert select.select((self._descriptor,), (), (), PATIENCE_S)[0], f"{self.path} remains empty"
            self._text += os.read(self._descriptor, 1 << 16)
        line, _, self._text = self._text.partition(b"\n")
        return line.decode().split()

    def until(self, word: str) -> list[str]:
        """Wait for a line that begins with a word."""
        while (line := self.line())[0] != word:
            pass
        return line

    def close(self) -> None:
        os.close(self._descriptor)


class Host(Palp):
    """A user on a host.

    Args:
        folder: For its keys, notes and workspace; short, for sockets have short paths.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.folder = folder
        self.keys = KeyFolder(self.folder / "keys")
        self.environment["PALP_KEYS"] = str(self.keys.path)
        self.prefix: list[str] = []
        self.books: list[NoteBook] = []
        self.file = folder / "launch/home.yaml"
        write_files(folder, {"nodes/__init__.py": "", "nodes/toys.py": TOYS, "launch/home.yaml": LAUNCH})

    def command(self, *arguments: object) -> list[str]:
        return [*self.prefix, *super().command(*arguments)]

    def run(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        with contextlib.chdir(self.folder):  # the workspace is the nearest folder that has nodes
            return super().run(*arguments)

    def here(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        with contextlib.chdir(self.folder):
            return super().here(*arguments)

    def start(self, *arguments: object) -> subprocess.Popen[str]:
        with contextlib.chdir(self.folder):
            return super().start(*arguments)

    def book(self, name: str = "notes") -> NoteBook:
        book = NoteBook(self.folder / name)
        self.books.append(book)
        return book

    def launch(self, *arguments: object, listen: str = "tcp://127.0.0.1:0") -> Launched:
        """Start the home graph; return when it runs. It listens where the launch file says if that is ""."""
        book = self.book("keeper")
        where = ("--listen", listen) if listen else ()
        process = self.start("launch", self.file, f"notes:={book.path}", *where, *arguments)
        graph = Launched(self, process, book)
        book.until("active")
        return graph

    def close(self) -> None:
        super().close()
        while self.books:
            self.books.pop().close()


@contextlib.contextmanager
def own_host() -> Iterator[Host]:
    """A host with a short folder of its own."""
    with short_folder() as folder, contextlib.closing(Host(folder)) as host:
        yield host


class Launched(Running):
    """A running home graph."""

    def __init__(self, host: Host, process: subprocess.Popen[str], book: NoteBook) -> None:
        super().__init__(host)
        self.host, self.launcher, self.book = host, process, book
        self.address = self.until_printed("listening on ").rpartition(" ")[2].strip()

    def until_printed(self, words: str) -> str:
        """Wait until the launcher prints a line with these words; return it."""
        return wait_for_error(self.launcher, words)

    @property
    def guests(self) -> list[str]:
        """Who has joined, by name."""
        return [node["name"] for node in self.record["nodes"] if not node["pid"] and node["name"] != LAUNCHER]

    def gateway(self) -> psutil.Process:
        (found,) = self.host.running("palp_core.graph.network.gateway")
        return found

    def end(self) -> int:
        """End it as Ctrl-C does."""
        self.launcher.terminate()
        return self.launcher.wait(PATIENCE_S)


class Raw:
    """A client of nothing but pyzmq and msgpack."""

    def __init__(self, address: str, server_key: str = "", own: OwnKeys | None = None) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.DEALER)
        self.socket.setsockopt(zmq.LINGER, 0)
        if own is not None:
            self.socket.curve_serverkey = server_key.encode()
            self.socket.curve_publickey = own.public.encode()
            self.socket.curve_secretkey = own.secret.encode()
        self.socket.connect(address)

    def say(self, op: str, **fields: Any) -> None:
        self.socket.send(msgpack.packb({"op": op, **fields}))

    def until(self, op: str) -> dict[str, Any]:
        """Wait for a word; frames and other words are passed over."""
        end_ns = monotonic_ns() + round(PATIENCE_S * 1e9)
        while True:
            while not self.socket.poll(500):
                assert monotonic_ns() < end_ns, f"no {op}"
                self.say("beat")  # who says nothing for 3 s counts as dead
            parts = self.socket.recv_multipart()
            if parts[0][:1] != b"/" and (word := msgpack.unpackb(parts[0]))["op"] == op:
                return dict(word)

    def close(self) -> None:
        self.context.destroy(linger=0)


def trusting(home: Host, away: Host) -> None:
    """Give both hosts keys, and let the second call the first."""
    home.keys.generate("home")
    home.keys.allow(away.keys.generate("away").public, "away")


def joining(home: Host, graph: Launched, *arguments: object) -> list[object]:
    """Return how a node of another host is run so that it joins."""
    key = home.keys.path / "home.public"
    return ["run", *arguments, "--join", graph.address, "--server-key", key]


def keeping(
    home: Host, graph: Launched, away: Host, name: str, topic: str = "/ticker/tick"
) -> tuple[NoteBook, subprocess.Popen[str]]:
    """Start a node away that writes down what it reads; return where, and its command."""
    book = away.book()
    wires = ("-r", f"tick:={topic}", "-p", f"notes:={book.path}")
    return book, away.start(*joining(home, graph, "nodes.toys:Keeper", "--name", name, *wires))
