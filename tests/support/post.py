"""A workspace whose reader is killed and robbed, and which takes commands."""

import json
from pathlib import Path
from typing import Any

from tests.support.palp import Palp
from tests.support.supervised import write_files

POST = '''
import json, os, random, select, signal
from typing import Annotated, Literal
import msgspec
from palp_core import Client, Message, Node, Params, Progress, Pub, Qos, QosEvent, ReadOnly, Srv, State, Sub
from palp_core import every, on, on_event, serve
from palp_core.graph.transport import reorder_buffer, subscriber_socket

reorder_buffer.FILL_NS = 60_000_000_000  # a source that waits for its turn on a busy machine loses nothing


class Letter(Message):
    index: int


class Question(Message):
    number: int


class Answer(Message):
    number: int


class SourceParams(Params):
    rate_hz: float = 500.0
    count: int = 500
    until: str = ""


class Sent(State):
    count: int = 0
    last: int = 0


class Source(Node):
    """Sends so many letters, and more until a file is there; then -1 until it is ended."""

    params: SourceParams
    state: Sent
    many = Pub(Letter, qos=Qos(depth=50_000))
    few = Pub(Letter, qos=Qos(depth=20))
    progress = Pub(Progress)

    @every("rate_hz")
    def send(self):
        self.state.count += 1
        index = -1 if self.state.last else self.state.count
        if index >= self.params.count and (not self.params.until or os.path.exists(self.params.until)):
            self.state.last = index
        self.many.publish(Letter(index=index))
        self.few.publish(Letter(index=index))
        if self.state.count == 1:
            self.progress.publish(
                Progress(stamp_ns=0, phase="letters", done_count=1, total_count=self.params.count)
            )


class ReaderParams(Params):
    deed: str = ""
    at: int = 100
    out: str = ""


def rob():
    """Drop one frame of twenty before it is seen."""
    honest, chance = subscriber_socket.SubscriberSocket.dispatch, random.Random(5)

    def dispatch(self, arrive, slice_ns, wait_ms=0):
        def sieve(raw, now_ns):
            if chance.random() >= 0.05:
                arrive(raw, now_ns)

        return honest(self, sieve, slice_ns, wait_ms)

    subscriber_socket.SubscriberSocket.dispatch = dispatch


class Reader(Node):
    """Writes down every letter, and at one of them does a deed, once."""

    params: ReaderParams
    letter = Sub(Letter)

    def on_configure(self):
        self.ended = False
        if self.params.deed == "rob":
            rob()

    def on_activate(self):
        if os.path.exists(self.params.out + ".done"):
            open(self.params.out + ".back", "w").close()

    @on(letter)
    def take(self, letter):
        if self.ended:
            return
        if letter.index < 0:
            self.ended = True
            self.finish()
            return
        with open(self.params.out + ".letters", "a") as out:
            out.write(f"{letter.index}\\n")
        if letter.index == self.params.at and self.params.deed not in ("", "rob"):
            done = self.params.out + ".done"
            if not os.path.exists(done):
                open(done, "w").close()
                getattr(self, self.params.deed)()

    def kill(self):
        os.kill(os.getpid(), signal.SIGKILL)

    @on_event(letter)
    def mind(self, event):
        with open(self.params.out + ".events", "a") as out:
            out.write(f"{event.kind} {event.count_change}\\n")

    def on_deactivate(self):
        counter = self._context.ends.accounts[self._context.spec.inputs["letter"]]
        with open(self.params.out + ".account", "w") as out:
            json.dump(msgspec.to_builtins(counter), out)


class ClerkParams(Params):
    """Parameters of a clerk: ``desk`` is where it sits."""

    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] = 100.0
    offset: Annotated[int, msgspec.Meta(ge=0, le=10, description="what is added to a number")] = 0
    mood: Literal["kind", "stern"] = "kind"
    desk: ReadOnly[str] = "left"
    limit: int = 300


class Clerk(Node):
    """Answers questions; publishes numbers that depend on its parameters."""

    params: ClerkParams
    state: Sent
    number = Pub(Letter)
    progress = Pub(Progress)
    ask = Srv(Question, Answer)
    hint = Sub(Question)

    def on_parameters(self, params):
        if params.mood == "stern" and params.offset == 7:
            raise ValueError("a stern clerk has no offset of 7")

    @every("rate_hz")
    def count(self):
        self.state.count += 1
        self.number.publish(Letter(index=self.state.count + 1000 * self.params.offset))
        if self.state.count == 1:
            self.progress.publish(Progress(stamp_ns=0, phase="office", done_count=1, total_count=1))
        if self.state.count >= self.params.limit:
            self.finish()

    @serve(ask)
    def answer(self, question):
        if question.number == 13:
            raise RuntimeError("thirteen")
        self.state.count += question.number
        return Answer(number=self.state.count)

    @on(hint)
    def take(self, question):
        self.state.count += question.number


class TickerParams(Params):
    rate_hz: float = 100.0
    wait_s: float = 0.005


class Ticker(Node):
    """Keeps simulated time going while the clerk rests, no faster than needed."""

    params: TickerParams

    @every("rate_hz")
    def tick(self):
        select.select((), (), (), self.params.wait_s)


class CallerParams(Params):
    rate_hz: float = 50.0
    out: str = ""
    count: int = 20


class Caller(Node):
    """Asks once a tick and writes down what it hears."""

    params: CallerParams
    state: Sent
    ask = Client(Question, Answer, timeout_ms=200.0, retries=300)

    @every("rate_hz")
    def call(self):
        if self.state.count < self.params.count:
            self.state.count += 1
            self.ask.call(Question(number=1))

    def note(self, text):
        with open(self.params.out, "a") as out:
            out.write(text + "\\n")
        self.received = getattr(self, "received", 0) + 1
        if self.received == self.params.count:
            self.finish()

    @on(ask)
    def hear(self, answer):
        self.note(f"answer {answer.number}")

    @on_event(ask)
    def mind(self, event):
        for _ in range(event.count_change):
            self.note("none")


class Mortal(Node):
    """A service that dies at a question, each time it lives."""

    params: ReaderParams
    ask = Srv(Question, Answer)

    @serve(ask)
    def answer(self, question):
        self.count = getattr(self, "count", 0) + 1
        if self.count == self.params.at:
            os.kill(os.getpid(), signal.SIGKILL)
        return Answer(number=self.count)
'''

LETTERS = """
graph: post
clock: wall
args:
  deed: {default: "", help: of the reader}
  out: {default: "", help: beginning of the files}
  until: {default: "", help: file until which there are more letters}
nodes:
  source: {run: "nodes.post:Source", params: {until: $(var until)}}
  reader:
    run: nodes.post:Reader
    params: {deed: $(var deed), out: $(var out)}
    inputs: {letter: source/FROM}
    restart: {when: on_failure, max_restarts: 3, backoff_s: 0.05}
    on_exit: shutdown
"""

OFFICE = """
graph: office
clock: $(var clock)
args:
  clock: {default: wall, choices: [sim, wall], help: clock}
  limit: {default: 1000000, help: ticks of the clerk}
nodes:
  clerk:
    run: nodes.post:Clerk
    params: {limit: $(var limit)}
    inputs: {hint: {external: true}}
    on_exit: shutdown
  clock: {run: "nodes.post:Ticker"}
"""

CALLS = """
graph: calls
clock: wall
args:
  out: {default: "", help: file}
nodes:
  server:
    run: nodes.post:Mortal
    params: {at: 12}
    restart: {when: on_failure, max_restarts: 10, backoff_s: 0.01}
  caller: {run: "nodes.post:Caller", params: {out: $(var out)}, inputs: {ask: server/ask}, on_exit: shutdown}
"""


class Post:
    """The workspace, and what its runs leave behind."""

    def __init__(self, palp: Palp, folder: Path) -> None:
        self.palp = palp
        self.folder = folder
        self.out = folder / "out"
        self.office, self.calls = folder / "launch/office.yaml", folder / "launch/calls.yaml"
        files = {"launch/office.yaml": OFFICE, "launch/calls.yaml": CALLS}
        write_files(folder, {"nodes/__init__.py": "", "nodes/post.py": POST, **files})

    def deliver(self, source: str, deed: str, *arguments: str) -> None:
        """Run the source and its reader to the end."""
        write_files(self.folder, {"launch/letters.yaml": LETTERS.replace("FROM", source)})
        self.palp.printed(
            "launch", self.folder / "launch/letters.yaml", f"deed:={deed}", f"out:={self.out}", *arguments
        )

    def letters(self) -> list[int]:
        """Every letter that the reader took up, in its order."""
        return [int(line) for line in Path(f"{self.out}.letters").read_text().split()]

    def account(self) -> dict[str, Any]:
        """The reader's own account."""
        account: dict[str, Any] = json.loads(Path(f"{self.out}.account").read_text())
        return account

    def lost_by_event(self) -> int:
        """Letters that the reader was notified of as lost."""
        path = Path(f"{self.out}.events")
        lines = path.read_text().splitlines() if path.exists() else []
        return sum(int(line.split()[1]) for line in lines if line.startswith("message_lost"))
