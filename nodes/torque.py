"""Measure the torque at the base of the probe."""

from typing import Any

import numpy as np

from msgs.torque import Contact, TorqueBlock
from palp_core import Params, Pub, ReadOnly, Sub, on
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.devices.device_node import DeviceNode
from palp_core.palpation.devices.protocols import TorqueSensor
from palp_core.palpation.devices.registry import find_device_mistakes, open_device
from palp_core.palpation.devices.sim.torque import SimTorque
from palp_core.palpation.nano17 import RESOLUTION_N_M
from palp_core.palpation.perception.belief.rig_noise import read_noise
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.palpation.world.model import read_world
from palp_core.units import NewtonMillimetresNonNegative, RatioNonNegative


class TorqueParams(Params):
    """Set in the launch file. The defaults are a Nano17 SI-12-0.12.

    ``noise_sd_n_mm`` is assumed: one step of the resolution (1/64 N mm, the maker's figure). Bias and gain
    drift are random walks, per square root of a second; not known, so 0. A noise file in ``noise`` has a
    sample's noise of its own, and a ``world`` other than the paper's a walk of the bias, where none is given.
    """

    device: ReadOnly[str] = "sim"
    noise_sd_n_mm: ReadOnly[NewtonMillimetresNonNegative] = RESOLUTION_N_M * 1e3
    resolution_n_mm: ReadOnly[NewtonMillimetresNonNegative] = RESOLUTION_N_M * 1e3
    bias_drift_n_mm_per_sqrt_s: ReadOnly[NewtonMillimetresNonNegative] = 0.0
    gain_drift_per_sqrt_s: ReadOnly[RatioNonNegative] = 0.0
    noise: ReadOnly[str] = ""
    world: ReadOnly[str] = "paper"


class Torque(DeviceNode):
    """Publish a block of measured torque for each block of contact; silent while nothing is swept."""

    simulates = True
    params: TorqueParams
    device: TorqueSensor[Any]
    contact = Sub(Contact)
    block = Pub(TorqueBlock)

    @classmethod
    def find_mistakes(cls, params: TorqueParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)
        find_device_mistakes("torque", params.device, None, mistakes)

    def on_configure(self) -> None:
        params = self.params
        noise_sd_n_m = params.noise_sd_n_mm * 1e-3
        if params.noise:
            noise_sd_n_m = read_noise(params.noise).sample_sd_n_m.value
        drift = params.bias_drift_n_mm_per_sqrt_s * 1e-3 or read_world(params.world).bias_walk_n_m_per_sqrt_s
        self.device = open_device(
            "torque",
            params.device,
            noise_sd_n_m=noise_sd_n_m,
            resolution_n_m=params.resolution_n_mm * 1e-3,
            bias_drift_n_m_per_sqrt_s=drift,
            gain_drift_per_sqrt_s=params.gain_drift_per_sqrt_s,
        )

    @on(contact)
    def measure(self, contact: Contact) -> None:
        if not isinstance(self.device, SimTorque):
            raise TypeError(f"torque device '{self.params.device}' is real; leave its input contact unwired")
        times_ns = contact.start_ns + np.rint(np.arange(len(contact.torque_n_m)) * (1e9 / contact.rate_hz))
        block = self.device.read(contact.torque_n_m, times_ns.astype(np.int64), self.memory, self.rng)
        self.block.publish(
            TorqueBlock(
                stamp_ns=self.now_ns(),
                start_ns=contact.start_ns,
                rate_hz=contact.rate_hz,
                over_phantom=True,
                saturated_count=block.saturated_count,
                torque_n_m=block.torque_n_m,
            )
        )
