"""A workspace of tiny nodes, and launch files written into it."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from palp_core.graph.description.check import load
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.node_class import inspect_classes
from palp_core.graph.problems import GraphProblems

TABLE: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("mistakes.yaml").read_text(encoding="utf-8"))
FILES: dict[str, dict[str, str]] = TABLE["files"]
"""Launch files with what they include, by name."""

MESSAGES = """
from palp_core import Message
from palp_core.units import Metres, NewtonMetres, Nanoseconds

class Torque(Message):
    stamp_ns: Nanoseconds
    torque_n_m: NewtonMetres

class Belief(Message):
    stamp_ns: Nanoseconds
    depth_m: Metres

class TareRequest(Message):
    stamp_ns: Nanoseconds

class TareReply(Message):
    offset_n_m: NewtonMetres
"""

NODES = {
    "torque": """
from typing import Literal
from msgs.touch import Belief, TareReply, TareRequest, Torque
from palp_core import Node, Params, Pub, Qos, Srv, every, serve
from palp_core.units import Hertz

class TorqueParams(Params):
    rate_hz: Hertz = 1000.0
    device: Literal["sim", "uart"] = "sim"
    samples: int = 50

class TorqueSensor(Node):
    '''Stream the probe's torque.'''
    params: TorqueParams
    moves = True
    torque = Pub(Torque, qos=Qos(reliability="best_effort"))
    truth = Pub(Belief)
    tare = Srv(TareRequest, TareReply)

    @every("rate_hz")
    def sample(self) -> None: ...

    @serve(tare)
    def zero(self, request): ...

""",
    "estimator": """
from msgs.touch import Belief, TareReply, TareRequest, Torque
from palp_core import Client, Node, Params, Pub, Qos, Sub, on

class EstimatorParams(Params):
    gain: float

class Estimator(Node):
    params: EstimatorParams
    torque = Sub(Torque, qos=Qos(reliability="best_effort"))
    hint = Sub(Belief, optional=True)
    belief = Pub(Belief)
    tare = Client(TareRequest, TareReply)

    @on(torque)
    def hear(self, message): ...
    @on(hint)
    def heed(self, message): ...
    @on(tare)
    def tared(self, reply): ...
""",
    "policy_fixed": """
from msgs.touch import Belief
from palp_core import Node, Params, Pub, Sub, on

class FixedParams(Params):
    level: int = 1

class Fixed(Node):
    params: FixedParams
    belief = Sub(Belief)
    command = Pub(Belief)
    @on(belief)
    def choose(self, message): ...
""",
    "policy_markov": """
from msgs.touch import Belief, Torque
from palp_core import Node, Params, Pub, Sub, on

class MarkovParams(Params):
    order: int = 1

class Markov(Node):
    params: MarkovParams
    belief = Sub(Belief)
    torque = Sub(Torque, optional=True)
    command = Pub(Belief)
    @on(belief)
    def choose(self, message): ...
    @on(torque)
    def hear(self, message): ...

def report(summary): ...

def page(viewer): ...
""",
    "record": """
from msgs.touch import Belief
from palp_core import Node, Sub, on

class Record(Node):
    records = True
    truth = Sub(Belief)
    @on(truth)
    def note(self, message): ...
""",
}


class Workspace:
    """A folder with nodes, messages and launch files."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def write(self, name: str, text: str) -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text).lstrip("\n"), encoding="utf-8")
        return path

    def write_all(self, name: str) -> str:
        """Write what a launch file of the table includes; return its own text."""
        for path, text in FILES[name].items():
            self.write(f"launch/{path}", text)
        return FILES[name]["graph.yaml"]

    def load(self, text: str, *overrides: str) -> CheckedGraph:
        return load(self.write("launch/graph.yaml", text), overrides, inspect_classes)

    def mistakes(self, text: str, *overrides: str) -> list[str]:
        """Return each mistake of a launch file, its place without the folder."""
        with pytest.raises(GraphProblems) as caught:
            self.load(text, *overrides)
        return [str(problem).replace(f"{self.root}/launch/", "") for problem in caught.value.problems]


@pytest.fixture
def workspace(tmp_path: Path) -> Iterator[Workspace]:
    made = Workspace(tmp_path)
    made.write("msgs/__init__.py", "")
    made.write("nodes/__init__.py", "")
    made.write("msgs/touch.py", MESSAGES)
    for name, text in NODES.items():
        made.write(f"nodes/{name}.py", text)
    path, outside = (
        list(sys.path),
        {n: m for n, m in sys.modules.items() if n.split(".")[0] in ("nodes", "msgs")},
    )
    for name in outside:
        del sys.modules[name]
    yield made
    sys.path[:] = path
    for name in [n for n in sys.modules if n.split(".")[0] in ("nodes", "msgs")]:
        del sys.modules[name]
    sys.modules.update(outside)
