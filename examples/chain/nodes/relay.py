"""Pass blocks on with a gain."""

from __future__ import annotations

from msgs.sample import Sample
from palp_core import Node, Params, Pub, State, Sub, on
from palp_core.units import Ratio


class RelayParams(Params):
    """Set in the launch file; ``fail_at`` makes the node fail at that block, to see what happens then."""

    gain: Ratio = 2.0
    fail_at: int = -1


class RelayState(State):
    """What a replacement inherits."""

    passed_count: int = 0


class Relay(Node):
    """Publish each block times the gain."""

    params: RelayParams
    state: RelayState
    sample = Sub(Sample)
    amplified = Pub(Sample)

    @on(sample)
    def amplify(self, sample: Sample) -> None:
        if sample.index == self.params.fail_at:
            raise ValueError(f"block {sample.index} is the one to fail at")
        self.state.passed_count += 1
        self.amplified.publish(
            Sample(
                stamp_ns=self.now_ns(),
                index=sample.index,
                torque_n_m=sample.torque_n_m * self.params.gain,
            )
        )
