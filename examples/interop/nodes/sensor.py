"""A torque sensor whose load is put on from outside."""

from __future__ import annotations

import numpy as np

from msgs.torque import Load, TareReply, TareRequest, TorqueBlock
from palp_core import Node, Params, Pub, Srv, State, Sub, every, on, serve
from palp_core.units import HertzPositive


class SensorParams(Params):
    """Two blocks of six samples at a time."""

    block_hz: HertzPositive = 50.0


class SensorState(State):
    """What a replacement inherits."""

    load_n_m: float = 0.0
    offset_n_m: float = 0.0


class Sensor(Node):
    """Publish the load less the tare."""

    params: SensorParams
    state: SensorState
    load = Sub(Load)
    torque = Pub(TorqueBlock)
    tare = Srv(TareRequest, TareReply)

    @on(load)
    def bear(self, load: Load) -> None:
        self.state.load_n_m = load.torque_n_m

    @every("block_hz")
    def read(self) -> None:
        torque_n_m = np.full(6, self.state.load_n_m - self.state.offset_n_m)
        self.torque.publish(TorqueBlock(stamp_ns=self.now_ns(), torque_n_m=torque_n_m))

    @serve(tare)
    def zero(self, request: TareRequest) -> TareReply:
        self.state.offset_n_m = self.state.load_n_m
        return TareReply(offset_n_m=self.state.offset_n_m)
