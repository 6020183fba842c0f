"""Publish at a steady rate, like a sensor."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from msgs.load import Block
from nodes.ticks import Ticks
from palp_core import Node, Params, Pub, State, every
from palp_core.units import Count, HertzPositive, Seconds


class StreamerParams(Params):
    """``samples`` of float64 a message, for ``seconds``."""

    out: str = ""
    rate_hz: HertzPositive = 1000.0
    samples: Count = 1
    seconds: Seconds = 600.0


class Streamer(Node):
    """Note how late each tick begins."""

    params: StreamerParams
    state: State
    block = Pub(Block)

    def on_configure(self) -> None:
        self.ticks = Ticks(self.params.rate_hz, self.params.seconds)
        self.values = np.full(self.params.samples, 1e-3)
        self.number = 0
        self.count = round(self.params.rate_hz * self.params.seconds)

    def on_activate(self) -> None:
        self.ticks.begin(self.now_ns())

    def on_deactivate(self) -> None:
        np.save(Path(self.params.out) / f"{self.name}.tick.npy", self.ticks.late_ns())
        np.save(Path(self.params.out) / f"{self.name}.sent.npy", np.array([self.number]))

    @every("rate_hz")
    def sample(self) -> None:
        self.ticks.note(self.now_ns())
        if self.number < self.count:
            self.number += 1
            block = Block(index=self.number, sent_ns=time.monotonic_ns(), torque_n_m=self.values)
            self.block.publish(block)
