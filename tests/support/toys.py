"""A workspace of nodes that do what no node should."""

import os
import select
import subprocess
from pathlib import Path

from tests.support.palp import PATIENCE_S, Palp, wait_for_line
from tests.support.supervised import write_files

TOYS = '''
import asyncio, ctypes, os, select, signal, subprocess, sys, threading
from palp_core import Message, Node, Params, Progress, Pub, State, Sub, every, on


class Blob(Message):
    index: int
    data: bytes = b""


class SourceParams(Params):
    rate_hz: float = 100.0
    size: int = 0
    count: int = 20


class Count(State):
    index: int = 0


class Source(Node):
    params: SourceParams
    state: Count
    blob = Pub(Blob)
    progress = Pub(Progress)

    @every("rate_hz")
    def send(self):
        if self.state.index < self.params.count:
            self.blob.publish(Blob(index=self.state.index, data=bytes(self.params.size)))
            self.state.index += 1
            done, total = self.state.index, self.params.count
            self.progress.publish(Progress(stamp_ns=0, phase="blobs", done_count=done, total_count=total))


class BadParams(Params):
    deed: str = ""
    notes: str = ""
    ready: str = ""


class Bad(Node):
    """Does a deed at the fourth message, and notes what it went through."""

    params: BadParams
    blob = Sub(Blob)
    passed = Pub(Blob)

    def note(self, text):
        with open(self.params.notes, "a") as notes:
            notes.write(text + "\\n")

    def on_configure(self):
        self.note("configure")
        begun = open(self.params.notes).read().count("configure")
        if self.params.deed == "flaky" and begun in (2, 3):
            raise OSError("the device is not back yet")

    def on_deactivate(self):
        self.note("deactivate")
        if self.params.deed == "unsafe":
            raise OSError("the device does not answer")

    @on(blob)
    def take(self, blob):
        deed = self.params.deed
        if deed == "slow":
            select.select((), (), (), 0.02)
        if blob.index == 3 and deed:
            self.note("deed")
            if self.params.ready:
                with open(self.params.ready, "w") as ready:
                    ready.write("!")
            getattr(self, deed, int)()
        self.passed.publish(blob)

    def fork(self):
        if os.fork() == 0:
            signal.pause()

    def fork_and_die(self):
        self.fork()
        os.kill(os.getpid(), signal.SIGKILL)

    def daemon(self):
        text = "trap 'echo in order >> $0; exit' TERM; echo; while :; do sleep 0.05; done"
        for command in (["sleep", "1000"], ["sh", "-c", text, self.params.notes]):
            process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.PIPE)
        process.stdout.readline()

    def leave(self):
        os._exit(0)

    def leave_in_c(self):
        ctypes.CDLL(None)._exit(0)

    def replace(self):
        os.execvp("true", ["true"])

    def paint(self):
        print("\\x1b[2Jhandler")
        thread = threading.Thread(target=print, args=("\\x1b[2Jthread",))
        thread.start()
        thread.join()
        os.write(1, b"\\x1b[2Jbelow\\n")
        subprocess.run(["echo", "\\x1b[2Jchild"])
        raise ValueError("enough")

    def cancel(self):
        raise asyncio.CancelledError

    def interrupt(self):
        raise KeyboardInterrupt

    def loop(self):
        while True:
            select.select((), (), (), 0.001)

    def flaky(self):
        if open(self.params.notes).read().count("configure") == 1:
            raise OSError("the device is gone")


class SinkParams(Params):
    count: int = 20
    arrived: str = ""


class Sink(Node):
    params: SinkParams
    blob = Sub(Blob)
    order = Pub(Blob)

    @on(blob)
    def take(self, blob):
        if self.params.arrived:
            with open(self.params.arrived, "a") as arrived:
                arrived.write(f"{blob.index} {len(blob.data)}\\n")
        if blob.index == self.params.count - 1:
            self.order.publish(Blob(index=0, data="".join({"a", "b", "c", "d", "e"}).encode()))
            self.finish()


class Odd(Node):
    def on_activate(self):
        self.finish(256)
'''

LAUNCH = """
graph: hostile
clock: $(var clock)
args:
  clock: {default: sim, choices: [sim, wall], help: clock}
  deed: {default: "", help: of the bad node}
  notes: {default: "", help: file}
  arrived: {default: "", help: file for what arrives}
  ready: {default: "", help: pipe to write to before the deed}
  count: {default: 20, help: messages}
  size: {default: 0, help: bytes of a message}
  rate_hz: {default: 100.0, help: messages per second}
  max_restarts: {default: 0, help: of the bad node}
nodes:
  source:
    run: nodes.toys:Source
    params: {count: $(var count), size: $(var size), rate_hz: $(var rate_hz)}
  bad:
    run: nodes.toys:Bad
    params: {deed: $(var deed), notes: $(var notes), ready: $(var ready)}
    inputs: {blob: source/blob}
    restart: {when: on_failure, max_restarts: $(var max_restarts), backoff_s: 0.05}
  sink:
    run: nodes.toys:Sink
    params: {count: $(var count), arrived: $(var arrived)}
    inputs: {blob: bad/passed}
    on_exit: shutdown
"""


class Hostile:
    """A workspace of toys."""

    def __init__(self, palp: Palp, folder: Path) -> None:
        self.palp = palp
        self.folder = folder
        self.file = folder / "launch/hostile.yaml"
        self.notes = folder / "notes"
        write_files(folder, {"nodes/__init__.py": "", "nodes/toys.py": TOYS, "launch/hostile.yaml": LAUNCH})

    def write(self, name: str, text: str) -> Path:
        write_files(self.folder, {name: text})
        return self.folder / name

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        how = self.palp.run if "--compose" in arguments else self.palp.here
        return how("launch", self.file, f"notes:={self.notes}", *arguments)

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start and wait for the first message."""
        process = self.palp.start("launch", self.file, f"notes:={self.notes}", *arguments)
        wait_for_line(process, "blobs: 1/")
        return process


class Pipe:
    """A named pipe by which a node says that it has come to some point."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self.path = path
        self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    def wait(self) -> None:
        assert select.select((self._descriptor,), (), (), PATIENCE_S)[0], f"{self.path} remains empty"
        os.close(self._descriptor)
