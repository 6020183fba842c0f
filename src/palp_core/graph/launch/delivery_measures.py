"""What each delivery costs and loses here: graphs of small nodes, run as `palp launch` runs them."""

import json
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.message import Message
from palp_core.graph.node.node import Node, Params, State
from palp_core.graph.node.ports import Pub, Sub, every, on
from palp_core.methods.measured import Measured, begins_after
from palp_core.units import Count, HertzPositive, Nanoseconds, NewtonMetresArray, Seconds

COUNT = 400
RATE_HZ = 1000.0
SLOW_S = 0.002
"""What a slow reader takes for a message: twice as long as its publisher."""

_HEAD = """\
graph: measure
clock: {clock}
nodes:
  source: {{run: "{module}:Source", params: {{count: {count}, rate_hz: {rate_hz}, out: {folder}/source}}}}
"""
_READER = """\
  {name}:
    run: "{module}:Reader"
    params: {{count: {count}, wait_s: {wait_s}, out: {folder}/{name}}}
    inputs: {{block: {{from: source/block, reliability: {reliability}}}}}
{end}"""


class NumberedBlock(Message):
    """A block of 50 samples, as the rig's."""

    stamp_ns: Nanoseconds
    number: Count
    torque_n_m: NewtonMetresArray


class SourceParams(Params):
    """How many, how often, and where to write what it took."""

    count: Count = COUNT
    rate_hz: HertzPositive = RATE_HZ
    out: str = ""


class SourceState(State):
    """Nothing of it outlives the node."""

    number: int = 0
    begun_ns: int = 0


class Source(Node):
    """Publish numbered blocks and write down the CPU time that all took."""

    params: SourceParams
    state: SourceState
    block = Pub(NumberedBlock)

    def on_activate(self) -> None:
        self.torque_n_m = np.linspace(-1e-3, 1e-3, 50)
        self.state.begun_ns = time.process_time_ns()

    @every("rate_hz")
    def publish(self) -> None:
        state = self.state
        if state.number >= self.params.count:
            return
        state.number += 1
        self.block.publish(
            NumberedBlock(stamp_ns=self.now_ns(), number=state.number, torque_n_m=self.torque_n_m)
        )
        if state.number == self.params.count:
            _write(self.params.out, cpu_s=(time.process_time_ns() - state.begun_ns) / 1e9)


class ReaderParams(Params):
    """How many there are to come, how long each takes, and where to write what came."""

    count: Count = COUNT
    wait_s: Seconds = 0.0
    out: str = ""


class ReaderState(State):
    """Nothing of it outlives the node."""

    ages_s: list[float] = []
    begun_ns: int = 0


class Reader(Node):
    """Take blocks up, and write down how many came, how old they were and what it took."""

    params: ReaderParams
    state: ReaderState
    block = Sub(NumberedBlock)

    def on_activate(self) -> None:
        self.state.begun_ns = time.process_time_ns()
        self.busy, self.told = threading.Event(), False

    def on_deactivate(self) -> None:
        if not self.told:  # others have ended the run before it came to the last one
            self._tell()

    @on(block)
    def take(self, block: NumberedBlock) -> None:
        state = self.state
        state.ages_s.append((self.now_ns() - block.stamp_ns) / 1e9)
        if self.params.wait_s:
            self.busy.wait(self.params.wait_s)
        if block.number == self.params.count:
            self._tell()
            self.finish()

    def _tell(self) -> None:
        self.told = True
        spent_s = (time.process_time_ns() - self.state.begun_ns) / 1e9
        _write(self.params.out, cpu_s=spent_s, ages_s=self.state.ages_s)


def _write(path: str, **found: Any) -> None:
    if path:
        Path(path).write_text(json.dumps(found), encoding="utf-8")


def launch_text(
    folder: Path, readers: dict[str, tuple[str, float]], *, clock: str, count: int, rate_hz: float = RATE_HZ
) -> str:
    """Return a launch file of a source and its readers.

    Args:
        folder: Where each node writes what it has found.
        readers: Reliability, and the seconds that a message takes, by name; the last one ends the run.
        clock: ``sim`` or ``wall``.
        count: Messages.
        rate_hz: How often one comes.
    """
    common = {"module": __name__, "count": count, "folder": folder}
    parts = [_HEAD.format(clock=clock, rate_hz=rate_hz, **common)]
    for name, (reliability, wait_s) in readers.items():
        end = "    on_exit: shutdown\n" if name == list(readers)[-1] else ""
        parts.append(_READER.format(name=name, reliability=reliability, wait_s=wait_s, end=end, **common))
    return "".join(parts)


def run(
    readers: dict[str, tuple[str, float]], *, clock: str, compose: bool = False, count: int = COUNT
) -> tuple[dict[str, Any], float]:
    """Run a source and its readers; return what each has written, and the launcher's own CPU time, in s."""
    with tempfile.TemporaryDirectory(prefix="palp-") as name:
        folder = Path(name)
        path = folder / "measure.yaml"
        path.write_text(launch_text(folder, readers, clock=clock, count=count), encoding="utf-8")
        before = list(sys.path)
        try:
            with Graph(path, compose=compose) as graph:
                begun_ns = time.process_time_ns()
                graph.run()
                own_s = (time.process_time_ns() - begun_ns) / 1e9
        finally:
            sys.path[:] = before
        found = {one: json.loads((folder / one).read_text(encoding="utf-8")) for one in ("source", *readers)}
    return found, own_s


@begins_after(2.5)
def measure_deliveries(_scene: Any) -> Iterator[Measured]:
    """Give CPU time a message at both ends, the share that is lost, and how old what is taken up is."""
    several = {
        "fast_best_effort": ("best_effort", 0.0),
        "fast_reliable": ("reliable", 0.0),
        "slow_best_effort": ("best_effort", SLOW_S),
        "slow_reliable": ("reliable", SLOW_S),
    }
    found, _ = run(several, clock="wall")
    for name in several:
        pace, _, reliability = name.partition("_")
        both_s = (found["source"]["cpu_s"] + found[name]["cpu_s"]) / COUNT
        slow = pace == "slow"
        condition = f"reader {SLOW_S * RATE_HZ:g} times as slow" if slow else ""
        yield from _points(reliability, found[name], both_s, condition, behind=slow)
    kept_up = {"reader": ("reliable", 0.0)}
    found, own_s = run(kept_up, clock="sim", compose=True)
    yield from _points("composed", found["reader"], own_s / COUNT, "simulated clock")
    found, own_s = run(kept_up, clock="sim")
    nodes_s = found["source"]["cpu_s"] + found["reader"]["cpu_s"]
    yield from _points("lockstep", found["reader"], (own_s + nodes_s) / COUNT, "simulated clock")


def _points(
    name: str, reader: dict[str, Any], cost_s: float, condition: str, *, behind: bool = False
) -> Iterator[Measured]:
    lost = 1.0 - len(reader["ages_s"]) / COUNT
    late = "the reader hears things later and later" if behind and name == "reliable" else ""
    skips = f"{lost:.0%} of the messages are skipped" if behind and name == "best_effort" else ""
    common: dict[str, Any] = {
        "task": "delivery",
        "method": name,
        "setting": f"{RATE_HZ:g} Hz",
        "cost_s": cost_s,
        "condition": condition,
    }
    yield Measured(**common, error=lost, output="lost", against="what was published", fails=skips)
    oldest_s = float(np.quantile(reader["ages_s"], 0.99))
    yield Measured(**common, error=oldest_s, output="age_s", against="the publisher's stamp", fails=late)
