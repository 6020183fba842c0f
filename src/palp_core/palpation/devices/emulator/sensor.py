"""What the emulated force and torque sensor feels: contact, extra load, and a simulated sensor's noise."""

from dataclasses import replace

import numpy as np

from palp_core.palpation.devices.emulator.axis import Axes
from palp_core.palpation.devices.emulator.contact import ProbeContact
from palp_core.palpation.devices.sim.torque import SimTorque, SimTorqueState

_WIDE_N_M = 10.0  # the gauges of the wire have the range, and the steps


class LoadedSensor:
    """Forces and torques at the sensor, of which the simulated one says the torque about x."""

    def __init__(
        self, torque: SimTorque, force_noise_sd_n: float, contact: ProbeContact, axes: Axes, seed: int
    ) -> None:
        self._torque = replace(torque, resolution_n_m=0.0, range_n_m=_WIDE_N_M)
        self._contact, self._axes = contact, axes
        self._state, self._rng = SimTorqueState(), np.random.default_rng((seed, 1))
        self._noise_sd = np.array([force_noise_sd_n] * 3 + [0.0] + [torque.noise_sd_n_m] * 2)
        self._torque.open(0, self._state, self._rng)
        self.put_load(0.0)

    def put_load(self, load_n_m: float) -> None:
        """Put a torque on the sensor besides the phantom's; 0 takes it off."""
        self.load_n_m, self.felt_ns, self.felt_y_m = load_n_m, 0, 0.0

    def wrench(self, now_ns: int) -> list[float]:
        """Return a sample: forces in N and torques in N m about x, y, z."""
        if self.load_n_m and not self.felt_ns:
            self.felt_ns, self.felt_y_m = now_ns, self._axes.y.position_m(now_ns)
        lateral_n, normal_n, torque_n_m = self._contact.loads(now_ns)
        times_ns = np.array([max(now_ns, self._state.last_ns)])  # clients ask in any order
        true_n_m = np.array([torque_n_m + self.load_n_m])
        block = self._torque.read(true_n_m, times_ns, self._state, self._rng)
        wrench: list[float] = (self._rng.standard_normal(6) * self._noise_sd).tolist()
        wrench[1] += lateral_n
        wrench[2] += normal_n
        wrench[3] = float(block.torque_n_m[0])
        return wrench
