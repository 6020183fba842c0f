"""Log every change of the torque: what the clients outside do, seen inside."""

from __future__ import annotations

from msgs.torque import TorqueBlock
from palp_core import Node, Params, State, Sub, on


class MonitorState(State):
    """What a replacement inherits."""

    torque_n_m: float = 0.0


class Monitor(Node):
    """Read what the sensor publishes."""

    params: Params
    state: MonitorState
    torque = Sub(TorqueBlock)

    @on(torque)
    def note(self, block: TorqueBlock) -> None:
        torque_n_m = float(block.torque_n_m[-1])
        if torque_n_m != self.state.torque_n_m:
            self.log.info("torque %g -> %g N m", self.state.torque_n_m, torque_n_m)
            self.state.torque_n_m = torque_n_m
