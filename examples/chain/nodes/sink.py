"""Count what arrives at the end of the chain."""

from __future__ import annotations

import json
from pathlib import Path

from msgs.sample import Sample
from palp_core import Node, Params, State, Sub, on
from palp_core.units import Count


class SinkParams(Params):
    """Set in the launch file; ``out`` is a JSON file, written when the last block has come."""

    count: Count = 100
    out: str = ""


class SinkState(State):
    """What a replacement inherits."""

    indices: list[int] = []


class Sink(Node):
    """End the run after the last block."""

    params: SinkParams
    state: SinkState
    sample = Sub(Sample)

    @on(sample)
    def count(self, sample: Sample) -> None:
        self.state.indices.append(sample.index)
        if sample.index == self.params.count - 1:
            if self.params.out:
                Path(self.params.out).write_text(json.dumps(self.state.indices), encoding="utf-8")
            self.finish()
