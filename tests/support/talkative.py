"""A small running graph with everything that the command line can ask for."""

import json
from pathlib import Path

import pytest

from tests.support.palp import Palp, wait_for_line
from tests.support.supervised import write_files

MSGS = '''
from palp_core import Message
from palp_core.units import Count, Nanoseconds, Newtons, NewtonMetresArray


class Sample(Message):
    """A numbered block."""

    stamp_ns: Nanoseconds
    index: Count
    name: str
    torque_n_m: NewtonMetresArray


class Load(Message):
    """A weight put on from outside."""

    load_n: Newtons
    samples: NewtonMetresArray
    note: str = "none"


class Seen(Message):
    """What the reader has received."""

    load_n: Newtons
    note: str


class WeighRequest(Message):
    """How often to multiply."""

    factor: Count = 1


class WeighReply(Message):
    """The load, multiplied, and how often it was asked."""

    load_n: Newtons
    asked_count: Count
'''

NODES = '''
import select

from msgs.talk import Load, Sample, Seen, WeighReply, WeighRequest
from palp_core import Node, Params, Progress, Pub, Qos, Srv, State, Sub, every, on, serve
from palp_core.graph.node.node import ReadOnly
from palp_core.units import HertzPositive

import numpy as np


class SourceParams(Params):
    """Set in the launch file."""

    rate_hz: HertzPositive = 100.0
    rare_hz: HertzPositive = 0.001
    name: str = "block"
    device: ReadOnly[str] = "sim"


class SourceState(State):
    index: int = 0


class Source(Node):
    """Publish blocks, some kept for late joiners, some rare."""

    params: SourceParams
    state: SourceState
    sample = Pub(Sample, qos=Qos(durability="transient_local", depth=20))
    rare = Pub(Sample)
    progress = Pub(Progress)

    def block(self):
        name, index = self.params.name, self.state.index
        torque = np.arange(3.0) + index % 100
        return Sample(stamp_ns=self.now_ns(), index=index, name=name, torque_n_m=torque)

    @every("rate_hz")
    def send(self):
        self.sample.publish(self.block())
        self.state.index += 1
        if self.state.index == 1:
            self.progress.publish(Progress(stamp_ns=0, phase="talk", done_count=1, total_count=1))

    @every("rare_hz")
    def send_rarely(self):
        self.rare.publish(self.block())


class ScaleParams(Params):
    wait_s: float = 0.0


class ScaleState(State):
    load_n: float = 0.0
    note: str = ""
    asked_count: int = 0


class Scale(Node):
    """Take a load from outside, report what it is; let simulated time run no faster than that."""

    params: ScaleParams
    state: ScaleState
    sample = Sub(Sample)
    load = Sub(Load)
    seen = Pub(Seen)
    weigh = Srv(WeighRequest, WeighReply)

    @on(sample)
    def ignore(self, sample):
        if self.params.wait_s:
            select.select((), (), (), self.params.wait_s)

    @on(load)
    def bear(self, load):
        self.state.load_n, self.state.note = load.load_n + float(load.samples.sum()), load.note
        self.seen.publish(Seen(load_n=self.state.load_n, note=load.note))

    @serve(weigh)
    def answer(self, request):
        self.state.asked_count += 1
        if request.factor > 100:
            select.select((), (), (), 3.0)  # longer than its caller waits
        return WeighReply(load_n=self.state.load_n * request.factor, asked_count=self.state.asked_count)
'''

LAUNCH = """
graph: talk
clock: $(var clock)
args: {clock: {default: wall}, rate_hz: {default: 100.0}, wait_s: {default: 0.0}}
nodes:
  source:
    run: nodes.talk:Source
    params: {rate_hz: $(var rate_hz)}
  scale:
    run: nodes.talk:Scale
    params: {wait_s: $(var wait_s)}
    inputs: {sample: source/sample, load: {external: true}}
"""


class Talk:
    """The graph, running, and the command line next to it."""

    def __init__(self, palp: Palp, folder: Path, *arguments: str) -> None:
        packages = {"msgs/__init__.py": "", "nodes/__init__.py": ""}
        files = {"msgs/talk.py": MSGS, "nodes/talk.py": NODES, "launch/talk.yaml": LAUNCH}
        write_files(folder, {**packages, **files})
        self.palp = palp
        self.folder = folder
        self.process = palp.start("launch", folder / "launch" / "talk.yaml", *arguments)
        wait_for_line(self.process, "talk: ")
        self.run, self.printed, self.refused = palp.here, palp.printed, palp.refused

    def answered(self, *words: object) -> object:
        """Return the last line that a verb prints with --json."""
        return json.loads(self.printed(*words, "--json").splitlines()[-1])


@pytest.fixture(scope="module")
def talk(shared_palp: Palp, tmp_path_factory: pytest.TempPathFactory) -> Talk:
    """One graph for all the tests of a file that only look."""
    return Talk(shared_palp, tmp_path_factory.mktemp("talk"))
