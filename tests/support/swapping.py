"""A workspace whose middle node is swapped under load, by classes that fail at every step in every way."""

from pathlib import Path

from tests.support.supervised import write_files

NODES = '''
import os, signal, time
from pathlib import Path
from palp_core import Client, Message, Node, Params, Progress, Pub, Qos, Srv, State, Sub, every, on, serve
from palp_core import ReadOnly, Swap


class Num(Message):
    index: int
    by: str = ""


class Word(Message):
    text: str


class SourceParams(Params):
    rate_hz: float = 1000.0
    count: int = 10**9


class Count(State):
    index: int = 0


class Source(Node):
    params: SourceParams
    state: Count
    out = Pub(Num)
    progress = Pub(Progress)

    @every("rate_hz")
    def go(self):
        if self.state.index >= self.params.count:
            return
        self.state.index += 1
        self.out.publish(Num(index=self.state.index))
        if self.state.index == 1:
            self.progress.publish(Progress(stamp_ns=0, phase="numbers", done_count=1, total_count=2))


class LastWords(Source):
    """Its first process says more than can be sent before it is killed, the next one nothing but progress."""

    @every("rate_hz")
    def go(self):
        killed = Path(__file__).with_name("killed")
        if not killed.exists():
            killed.touch()
            for number in range(20_000):
                self.out.publish(Num(index=number, by="x" * 1000))
            os.kill(os.getpid(), signal.SIGKILL)
        self.progress.publish(Progress(stamp_ns=0, phase="numbers", done_count=1, total_count=2))


class RelayState(State):
    total: int = 0
    drawn: list[float] = []

    @classmethod
    def adopt(cls, old):
        return cls(total=old.values["total"])


class RelayParams(Params):
    gain: int = 1


class Relay(Node):
    """Passes numbers on, in their order, and knows how many there were."""

    params: RelayParams
    state: RelayState
    num = Sub(Num, qos=Qos(reliability="best_effort", depth=100_000))
    ask = Srv(Num, Num)
    out = Pub(Num, qos=Qos(depth=1000))
    other = Pub(Num)
    strict = True

    @on(num)
    def pass_on(self, num):
        if self.strict and self.state.total and num.index != self.state.total + 1:
            raise ValueError(f"{num.index} came after {self.state.total}")
        self.state.total = num.index
        self.out.publish(Num(index=num.index, by=type(self).__name__))

    @serve(ask)
    def answer(self, num):
        return Num(index=num.index, by=f"{type(self).__name__} {self.params.gain}")


class Other(Relay):
    pass


class Brief(Relay):
    """Remembers few messages: a reader that asks for more has lost them."""

    out = Pub(Num, qos=Qos(depth=10))


class LaboriousState(RelayState):
    @classmethod
    def adopt(cls, old):
        time.sleep(0.1)
        return cls(total=old.values["total"])


class Laborious(Brief):
    """Takes long to adopt a state, as if it were a large one."""

    state: LaboriousState


class HeavyState(RelayState):
    bulk: bytes = b""

    @classmethod
    def adopt(cls, old):
        return cls(total=old.values["total"], bulk=bytes(60_000_000))


class Heavy(Brief):
    """Has a large state."""

    state: HeavyState


class Loose(Relay):
    """What it missed while it was not there is no fault."""

    strict = False


class LooseOther(Loose):
    pass


class Plain(Relay):
    """Its state is another, and it has no way to take a stranger's."""

    class PlainState(State):
        total: int = 0
        kind: str = ""

    state: PlainState


class NoOut(Node):
    num = Sub(Num)

    @on(num)
    def take(self, num): ...


class Agreeing(Relay):
    """It must know its source's rate, and has another."""

    class AgreeingParams(RelayParams):
        rate_hz: float = 7.0

    params: AgreeingParams
    same_params = {"num": ("rate_hz",)}


class WrongType(Node):
    num = Sub(Num)
    out = Pub(Word)

    @on(num)
    def take(self, num): ...


class Wants(Relay):
    more = Sub(Num)

    @on(more)
    def take_more(self, num): ...


class Mover(Relay):
    moves = True


class FixedParams(RelayParams):
    base: ReadOnly[int] = 0


class Fixed(Relay):
    """Has a read-only parameter."""

    params: FixedParams


class DeedParams(RelayParams):
    deed: str = ""
    step: str = ""
    pid: int = 0


DEEDS = {}


def do(params):
    if params.deed == "raise":
        raise RuntimeError("as asked")
    if params.deed == "exit":
        raise SystemExit(3)
    if params.deed == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if params.deed == "hang":
        signal.pause()
    if params.deed == "stop_other":
        os.kill(params.pid, signal.SIGSTOP)
    if params.deed == "kill_other":
        os.kill(params.pid, signal.SIGKILL)


class FaultyState(RelayState):
    @classmethod
    def adopt(cls, old):
        if DEEDS["params"].step == "state":
            do(DEEDS["params"])
        if DEEDS["params"].deed == "misfit":
            return Count()
        return cls(total=old.values["total"])


class Faulty(Relay):
    """Does a deed at a step of the swap that gives it the part."""

    params: DeedParams
    state: FaultyState

    def on_configure(self):
        DEEDS["params"] = self.params
        if self.params.deed == "finish early":
            self.finish()
        if self.params.step == "configure":
            do(self.params)

    def on_resume(self):
        if self.params.deed != "kill_other":
            self.out.publish(Num(index=-1, by="too early"))
        if self.params.deed == "finish":
            self.finish()
        if self.params.step == "take over":
            do(self.params)


class Fleeting(Faulty):
    """Dies as soon as it has reported that it has taken over; a stopped launcher learns both together."""

    def on_resume(self):
        do(self.params)

    @on(Relay.num)
    def pass_on(self, num):
        os.kill(os.getpid(), signal.SIGKILL)


class NoviceParams(DeedParams):
    after: int = 0


class Novice(Relay):
    """Does a deed when so many numbers have passed."""

    params: NoviceParams

    def on_configure(self):
        self.count = 0

    @on(Relay.num)
    def pass_on(self, num):
        self.count += 1
        due = self.count == self.params.after + 1
        if due:
            do(self.params)
        Relay.pass_on(self, num)
        if due and self.params.deed == "lie":
            self.state.drawn = "no list"
        if due and self.params.deed == "lose":
            self.state = None
        if due and self.params.deed == "finish":
            self.finish()


class Forgetful(Novice):
    out = Pub(Num, qos=Qos(depth=10))


class Brittle(Novice):
    """Cannot bear a number, whichever node it is."""

    @on(Relay.num)
    def pass_on(self, num):
        if num.index == self.params.after:
            raise ValueError("too much")
        Relay.pass_on(self, num)


class Vague(Novice):
    """Its state cannot be written down after so many numbers."""

    @on(Relay.num)
    def pass_on(self, num):
        Novice.pass_on(self, num)
        if self.count > self.params.after:
            self.state.drawn = [object()]


class Trainee(Novice):
    """Is tried on a number before it takes over."""

    on_probation = True
    strict = False


class Seldom(Trainee):
    """Proves itself by every fiftieth number."""

    proven_by = "feat_count"
    feat_count = property(lambda self: self.count // 50)


class Boaster(Seldom):
    """Counts what proves it in words."""

    feat_count = "many"


class Idle(Seldom):
    """Nothing that would prove it happens."""

    feat_count = 0


class LonerState(State):
    index: int = 0

    @classmethod
    def adopt(cls, old):
        return cls(index=old.values["total"])


class Loner(Novice):
    """No class can take its state back."""

    state: LonerState

    @on(Relay.num)
    def pass_on(self, num):
        self.count += 1
        if self.count == self.params.after + 1:
            do(self.params)
        if num.index != self.state.index + 1:
            raise ValueError(f"{num.index} came after {self.state.index}")
        self.state.index = num.index
        self.out.publish(Num(index=num.index, by=type(self).__name__))

    @serve(Relay.ask)
    def answer(self, num):
        if self.count <= self.params.after:
            do(self.params)
        return Relay.answer(self, num)


class SinkParams(Params):
    out: str = ""


class SinkState(State):
    index: int = 0
    bad: list[str] = []
    makers: list[str] = []


class Sink(Node):
    """An independent reader: every number once and in order, or it says what was wrong."""

    params: SinkParams
    state: SinkState
    num = Sub(Num, qos=Qos(reliability="best_effort", depth=100_000))
    judge = Srv(Num, Word)

    @on(num)
    def take(self, num):
        state = self.state
        if num.index != state.index + 1:
            state.bad.append(f"{num.index} after {state.index}")
        state.index = max(num.index, state.index)
        if not state.makers or state.makers[-1] != num.by:
            state.makers.append(num.by)

    @serve(judge)
    def answer(self, num):
        state = self.state
        text = f"{state.index}|{','.join(state.bad)}|{','.join(state.makers)}"
        if num.by == "forget":
            state.makers = state.makers[-1:]
        return Word(text=text)


class PlannerParams(Params):
    rate_hz: float = 10.0
    run: str = "swap_toys:Other"
    params: str = '{"gain": 5}'


class Planner(Node):
    params: PlannerParams
    state: Count
    swap = Pub(Swap)

    @every("rate_hz")
    def go(self):
        self.state.index += 1
        if self.state.index == 3:
            run = self.params.run
            self.swap.publish(Swap(stamp_ns=self.now_ns(), node="relay", run=run, params=self.params.params))
        if self.state.index == 6:
            self.finish()


class AskerParams(Params):
    rate_hz: float = 200.0


class AskerState(State):
    asked: int = 0
    answers: set[int] = set()


class Asker(Node):
    """Calls the node that is swapped, all the time."""

    params: AskerParams
    state: AskerState
    ask = Client(Num, Num, timeout_ms=20_000.0, retries=2)

    @every("rate_hz")
    def go(self):
        self.state.asked += 1
        self.ask.call(Num(index=self.state.asked))

    @on(ask)
    def hear(self, num):
        if num.index in self.state.answers:
            raise ValueError(f"call {num.index} was answered twice")
        self.state.answers.add(num.index)
'''

RESTARTING = """
graph: restarting
clock: wall
nodes:
  source:
    run: "swap_toys:Source"
    params: {rate_hz: 500.0}
    restart: {when: on_failure, backoff_s: 0.001, max_restarts: 1000}
  relay:
    run: "swap_toys:Loose"
    restart: {when: on_failure, backoff_s: 0.001, max_restarts: 1000}
    inputs: {num: source/out}
  sink:
    run: "swap_toys:Sink"
    restart: {when: on_failure, backoff_s: 0.001, max_restarts: 1000}
    inputs: {num: relay/out}
"""
LAUNCH = """
graph: swapping
clock: {clock}
args:
  run: {{default: "swap_toys:Relay", help: of the middle node}}
  rate_hz: {{default: 1000.0, help: of the numbers}}
  calls_hz: {{default: 200.0, help: of the calls}}
{args}nodes:
  source: {{run: "swap_toys:Source", params: {{rate_hz: $(var rate_hz)}}}}
  relay: {{run: $(var run), inputs: {{num: source/out}}}}
  sink: {{run: "swap_toys:Sink", inputs: {{num: relay/out}}}}
  asker: {{run: "swap_toys:Asker", params: {{rate_hz: $(var calls_hz)}}, inputs: {{ask: relay/ask}}}}
{more}
"""
PLANNED = """
  params: {default: '{"gain": 5}', help: of the node that takes over}
"""
PLANNER = """
  planner: {run: "swap_toys:Planner", params: {params: $(var params)}, on_exit: shutdown}
"""


def workspace(folder: Path) -> Path:
    """Write the workspace; return its launch folder."""
    wall = LAUNCH.format(clock="wall", more="", args="")
    sim = LAUNCH.format(clock="sim", more=PLANNER, args=PLANNED)
    files = {"swap_toys.py": NODES, "launch/wall.yaml": wall, "launch/sim.yaml": sim}
    write_files(folder, {"nodes/__init__.py": "", **files})
    return folder / "launch"


def restarting_workspace(folder: Path) -> Path:
    """Write one whose middle node is restarted and does not mind what it misses; return its launch folder."""
    launch = workspace(folder)
    (launch / "wall.yaml").write_text(RESTARTING)
    return launch
