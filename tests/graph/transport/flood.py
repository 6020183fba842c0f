"""A workspace in which a source sends as fast as it can to a reader that is slower."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any, ClassVar

from tests.support.palp import Palp

FLOOD = '''
import json, os, signal, threading
from palp_core import Alarm, Message, Node, Params, Pub, Sub, on, on_event


class Letter(Message):
    index: int


class FloodParams(Params):
    count: int = 0
    out: str = ""
    deed: str = ""


class Source(Node):
    """Sends all its letters in one handler, then waits until its reader knows of the last."""

    params: FloodParams
    letter = Pub(Letter)
    done = Sub(Letter, optional=True)
    begin, look = Alarm(), Alarm()

    def on_activate(self):
        self.told, self.waits = [], 0
        self.begin.set(self.now_ns())

    @on(begin)
    def send(self):
        end = self._context.ends.publishers["/source/letter"]
        honest = end.wait_for_room

        def counted():
            self.waits += 1
            honest()

        end.wait_for_room = counted
        for index in range(1, self.params.count + 1):
            self.letter.publish(Letter(index=index))

    @on_event(letter)
    def mind(self, event):
        self.told.append(event.count_change)
        self.write()

    @on(done)
    def end(self, letter):
        self.look.set(self.now_ns())

    @on(look)
    def wait(self):
        """Wait until what the reader has lost has been said."""
        end = self._context.ends.publishers["/source/letter"]
        if sum(self.told) == end.lost_count == self.lost_at_reader():
            self.write()
            self.finish()
        else:
            self.look.set(self.now_ns() + 10_000_000)

    def lost_at_reader(self):
        with open(self.params.out + ".read") as read:
            return json.load(read)["lost"]

    def write(self):
        end = self._context.ends.publishers["/source/letter"]
        found = {"sequence": end.sequence, "lost_by_readers": end.lost_count, "waits": self.waits}
        for name, what in (("sent", found), ("told", self.told)):
            with open(f"{self.params.out}.{name}", "w") as out:
                json.dump(what, out)


class Reader(Node):
    """Takes its time over each letter; says when the account is closed."""

    params: FloodParams
    letter = Sub(Letter)
    done = Pub(Letter)
    look = Alarm()

    def on_activate(self):
        self.look.set(self.now_ns())

    @on(letter)
    def take(self, letter):
        dead = self.params.out + ".dead"
        if self.params.deed == "kill" and letter.index >= 10 and not os.path.exists(dead):
            open(dead, "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        if self.params.deed == "sleep" and letter.index == 1:
            threading.Event().wait(600.0)
        sum(range(2000))

    @on(look)
    def count(self):
        account = self._context.ends.accounts["/source/letter"]
        if account.sequence < self.params.count:
            self.look.set(self.now_ns() + 10_000_000)
            return
        with open(self.params.out + ".read", "w") as out:
            json.dump({"received": account.received, "lost": account.lost}, out)
        self.done.publish(Letter(index=account.sequence))
'''

GRAPH = """
graph: flood
clock: wall
args:
  history: {default: keep_last, choices: [keep_last, keep_all], help: of the edge}
  blocking_ms: {default: 60000, help: longest wait}
  count: {default: 0, help: letters}
  out: {default: "", help: beginning of the files}
  deed: {default: "", help: of the reader}
nodes:
  source:
    run: nodes.flood:Source
    params: {count: $(var count), out: $(var out), deed: $(var deed)}
    inputs: {done: reader/done}
    on_exit: shutdown
  reader:
    run: nodes.flood:Reader
    params: {count: $(var count), out: $(var out), deed: $(var deed)}
    inputs:
      letter: {from: source/letter, history: $(var history), depth: 64, max_blocking_ms: $(var blocking_ms)}
    restart: {when: on_failure, max_restarts: 3, backoff_s: 0.05}
"""


class Flood:
    """The workspace, and what its run leaves behind."""

    DEPTH: ClassVar = 64

    def __init__(self, palp: Palp, folder: Path) -> None:
        self.palp, self.folder, self.out = palp, folder, folder / "out"
        for name, text in (
            ("nodes/__init__.py", ""),
            ("nodes/flood.py", FLOOD),
            ("launch/flood.yaml", GRAPH),
        ):
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")

    def run(self, history: str, count: int, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run it to the end."""
        file = self.folder / "launch/flood.yaml"
        return self.palp.run(
            "launch", file, f"history:={history}", f"count:={count}", f"out:={self.out}", *arguments
        )

    def found(self) -> dict[str, Any]:
        """What reader and source have written down."""
        return {name: json.loads(Path(f"{self.out}.{name}").read_text()) for name in ("read", "sent", "told")}
