"""Publish numbered blocks of random torque."""

from __future__ import annotations

from msgs.sample import Sample
from palp_core import Node, Params, Progress, Pub, State, every
from palp_core.units import Count, HertzPositive


class SourceParams(Params):
    """Set in the launch file."""

    rate_hz: HertzPositive = 100.0
    block_samples: Count = 50
    count: Count = 100


class SourceState(State):
    """What a replacement inherits."""

    index: int = 0


class Source(Node):
    """Publish ``count`` blocks, then rest."""

    params: SourceParams
    state: SourceState
    sample = Pub(Sample)
    progress = Pub(Progress)

    @every("rate_hz")
    def publish(self) -> None:
        state, params = self.state, self.params
        if state.index >= params.count:
            return
        torque_n_m = self.rng.normal(scale=1e-3, size=params.block_samples)
        self.sample.publish(Sample(stamp_ns=self.now_ns(), index=state.index, torque_n_m=torque_n_m))
        state.index += 1
        self.progress.publish(
            Progress(stamp_ns=self.now_ns(), phase="blocks", done_count=state.index, total_count=params.count)
        )
