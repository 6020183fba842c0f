"""The graph's ends of the bridge: one sends samples to ROS 2, one takes those that come from there."""

from __future__ import annotations

import numpy as np

from msgs.torque import Sample
from palp_core import Node, Params, Pub, State, Sub, every, on
from palp_core.graph.clock import monotonic_ns
from palp_core.units import Hertz


class SourceParams(Params):
    """How fast."""

    rate_hz: Hertz = 1000.0


class SourceState(State):
    """What a replacement inherits."""

    count: int = 0


class Source(Node):
    """Send samples."""

    params: SourceParams
    state: SourceState
    sample = Pub(Sample)

    @every("rate_hz")
    def send(self) -> None:
        self.state.count += 1
        self.sample.publish(Sample(index=self.state.count, sent_ns=float(monotonic_ns()), torque_n_m=0.5))


class SinkParams(Params):
    """Where what has arrived is written."""

    file: str = ""


class Sink(Node):
    """Take samples: index, when each was sent, when it arrived."""

    params: SinkParams
    sample = Sub(Sample)

    def on_configure(self) -> None:
        self.rows: list[tuple[float, float, int]] = []

    @on(sample)
    def take(self, sample: Sample) -> None:
        self.rows.append((sample.index, sample.sent_ns, monotonic_ns()))

    def on_deactivate(self) -> None:
        np.save(self.params.file, np.array(self.rows, np.float64).reshape(-1, 3))
