"""The node of the other host: it listens to the end of the chain until it has heard enough."""

from __future__ import annotations

import json
from pathlib import Path

from msgs.sample import Sample
from palp_core import Node, Params, State, Sub, on
from palp_core.units import CountPositive


class ListenerParams(Params):
    """How many blocks, and the file that says which they were."""

    blocks: CountPositive = 200
    out: str = "heard.json"


class ListenerState(State):
    """What a replacement inherits."""

    indices: list[int] = []


class Listener(Node):
    """Listen, write which blocks came, and end."""

    params: ListenerParams
    state: ListenerState
    sample = Sub(Sample)

    @on(sample)
    def hear(self, sample: Sample) -> None:
        self.state.indices.append(sample.index)
        if len(self.state.indices) == self.params.blocks:
            Path(self.params.out).write_text(json.dumps(self.state.indices), encoding="utf-8")
            self.finish()
