"""The rig behind the emulated wires: stage, ring, phantom and muscles, one truth for all devices.

The force follows from the stage's position and the ring by the same mechanics as the simulated rig. Above the
scanning height the contact fades with indentation to the power 1.5 (Hertz, sphere on a half space) and ends
where the ball leaves the surface; at the ends of the solved stretch it stays as it is. While the ring moves,
the contact is that of the place it goes to: on a rig that palpates, the probe is raised then.
"""

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.emulator.axis import Axis, AxisSettings
from palp_core.palpation.devices.sim.emg import SimEmg
from palp_core.palpation.devices.sim.ring import SimRing, SimRingState
from palp_core.palpation.mechanics import ContactModel, solve
from palp_core.palpation.mechanics.scene.guard import speed_guard
from palp_core.palpation.mechanics.scene.rig import Rig, rig
from palp_core.palpation.nano17 import FORCE_RESOLUTION_N, RESOLUTION_N_M
from palp_core.palpation.world.live import LiveSweeps, live_world
from palp_core.palpation.world.model import PAPER, WorldModel
from palp_core.units import Float64Array

_STEP_M = 50e-6
_LOWEST_RING_M = -0.6e-3  # twice the actuator's repeatability; the joint is unstable from -1 mm on
_LOG_LENGTH = 100_000
_NOISE_ROWS = 256
SPEED_M_S = 0.02
"""Of the sweeps whose stick-slip is solved for: the published one."""
_EQUAL = ((0.2, 0.2, 0.2, 0.2, 0.2),) * 5


@dataclass(frozen=True)
class WorldSettings:
    """What the emulated rig is made of.

    Attributes:
        seed: Of every random number.
        phantoms: File of phantoms by code; empty for the paper's three.
        scene: Scene file of gel, probe, indentation and tolerance; empty for the numbers here.
        code: The phantom that is mounted first; empty for the first of the file.
        height_offset_m: How much higher than nominal it is mounted.
        indentation_m: Indentation at scanning height (assumed, as in the simulated rig).
        from_m: Lower end of the solved stretch.
        to_m: Upper end.
        y_axis: The axis along the sweep.
        z_axis: The axis that lifts the probe.
        ring_zero_m: Extension of the actuator at ring position 0.
        repeatability_m: Of the actuator's landing (data sheet).
        ring_error: How that is read: ``uniform`` as hard limits, ``normal`` as the band of 95 %.
        torque_noise_sd_n_m: Noise of each torque (assumed: one step of the sensor's resolution).
        force_noise_sd_n: Noise of each force (assumed: one step of the sensor's resolution).
        beside: What phantoms, probe and sensor have beside the paper's own design.
        lands_m: Where the probe is lowered for a sweep towards +Y, and towards -Y; None: the stretch's ends.
    """

    seed: int = 1
    phantoms: str = ""
    scene: str = ""
    read: str = "peak"
    code: str = ""
    height_offset_m: float = 0.0
    indentation_m: float = 0.004
    from_m: float = -0.032
    to_m: float = 0.052
    y_axis: AxisSettings = field(default_factory=AxisSettings)
    z_axis: AxisSettings = field(default_factory=lambda: AxisSettings(soft_low_m=-0.001))
    ring_zero_m: float = 0.001
    repeatability_m: float = 0.3e-3
    ring_error: Literal["uniform", "normal"] = "uniform"
    torque_noise_sd_n_m: float = RESOLUTION_N_M
    force_noise_sd_n: float = FORCE_RESOLUTION_N
    beside: WorldModel = PAPER
    lands_m: tuple[float, float] | None = None


@dataclass(frozen=True)
class GuardMet:
    """What the mechanics have to say of the contact that the probe felt: a region in which a method fails."""

    code: str
    ring_m: float
    words: tuple[str, ...]


class World:
    """The state of the emulated rig. Used by one thread; a second one solves sweeps ahead of need.

    Attributes:
        log: Every command that the stage's controller got: when, from which client, the line.
        load_n_m: Torque that somebody puts on the sensor beside the phantom, about its axis x.
        felt_ns: When the sensor took the first sample with it; 0: none yet.
        felt_y_m: Where the stage was then.
        swept_m_s: Speed that the latest move in touch with the phantom was ordered with; 0: none yet.
        guards: What was met, once per mounting and ring that touched; whoever tells it takes it away.
    """

    def __init__(self, settings: WorldSettings) -> None:
        self.settings = settings
        self.axes = {"y": Axis(settings.y_axis), "z": Axis(settings.z_axis)}
        self.ring = SimRing(
            speed_m_per_s=5e-3, zero_m=0.0, repeatability_m=settings.repeatability_m, settle_s=0.0
        )
        self.ring_state = SimRingState()
        self.ring_stalled = False
        self.saturated_gauges: tuple[int, ...] = ()
        self.apply_load(0.0)
        self.sensor_status = 0
        self.swept_m_s = 0.0
        self._met: GuardMet | None = None
        self._met_m_s = 0.0
        self._met_words: tuple[str, ...] = ()
        self._rng = np.random.default_rng(settings.seed)
        self._noise_rng = np.random.default_rng((settings.seed, 1))
        self._noise: list[list[float]] = []
        self._zero_rng = np.random.default_rng((settings.seed, 2))
        self._zero_n_m, self._zero_ns = 0.0, 0
        self._way_m, self._last_m, self._mounting = 0.0, 0.0, 0
        self.emg = SimEmg(matrix=_EQUAL)
        self.log: deque[tuple[int, int, str]] = deque(maxlen=_LOG_LENGTH)
        self.guards: deque[GuardMet] = deque(maxlen=_LOG_LENGTH)
        self._rig = rig(
            phantoms=settings.phantoms,
            scene=settings.scene,
            read=settings.read,
            indentation_m=settings.indentation_m,
            ends_m=settings.lands_m,
        )
        self._models = {code: self._rig.model(code) for code in self._rig.by_depth}
        ends_m = settings.from_m, settings.to_m
        self._live = live_world(self._rig, settings.beside, settings.seed, *ends_m)
        self._lands_m = settings.lands_m or ends_m
        self._forward = True
        self._solver = ThreadPoolExecutor(1, thread_name_prefix="palp-emulator-mechanics")
        self.ring.open(0, self.ring_state, self._rng)
        self.mount(settings.code or min(self._rig.phantoms), settings.height_offset_m)

    @property
    def rig(self) -> Rig:
        """The phantoms, the probe and what stands for their contact."""
        return self._rig

    def mount(self, code: str, height_offset_m: float) -> None:
        """Put a phantom under the probe.

        Raises:
            DeviceError: There is none of that code.
        """
        known = self._rig.phantoms
        if code not in known:
            raise DeviceError(f"emulator: no phantom '{code}'; there are {', '.join(sorted(known))}")
        self._code, self._indentation_m = code, self._rig.indentation_m + height_offset_m
        self._height_m, self._mounting = height_offset_m, self._mounting + 1
        self._model = self._models[code]
        self._solve()

    def latents(self) -> Float64Array:
        """Return what the mounted phantom is off by, shape (7,), as of :data:`.LATENTS`."""
        return self._live.row(self._code, self._mounting, self._height_m, self._way_m)

    def move_rod(self, extension_m: float, speed_m_per_s: float, now_ns: int) -> None:
        """Send the actuator to an extension; the true landing error is drawn here."""
        if self.ring_stalled:
            return
        ring = SimRing(
            speed_m_per_s=speed_m_per_s,
            zero_m=0.0,
            repeatability_m=self.settings.repeatability_m,
            distribution=self.settings.ring_error,
            settle_s=0.0,
        )
        self.ring = ring
        ring.command(min(max(extension_m, 0.0), ring.stroke_m), now_ns, self.ring_state, self._rng)
        self._solve()

    def apply_load(self, load_n_m: float) -> None:
        """Put a torque on the sensor beside the phantom's; 0 takes it off."""
        self.load_n_m, self.felt_ns, self.felt_y_m = load_n_m, 0, 0.0

    def stall(self, now_ns: int) -> None:
        """Block the actuator where it is."""
        self.ring.stop(now_ns, self.ring_state)
        self.ring_stalled = True
        self._solve()

    def extension_m(self, now_ns: int) -> float:
        """Return where the rod is by its own potentiometer."""
        state = self.ring_state
        if now_ns >= state.settled_ns:
            return state.nominal_m[-1]
        return float(np.interp((now_ns - state.start_ns) * 1e-9, state.after_s, state.nominal_m))

    def true_ring_m(self, now_ns: int) -> float:
        """Return where the ring is in truth."""
        return self.ring.true_position_m(now_ns, self.ring_state) - self.settings.ring_zero_m

    def true_wrench(self, now_ns: int) -> Float64Array:
        """Return forces in N and torques in N m about x, y, z at the sensor, shape (6,)."""
        return np.array(self._touch(now_ns))

    def _touch(self, now_ns: int) -> list[float]:
        """Return the same as plain numbers: it is asked for at every sample."""
        wrench = [0.0] * 6
        above_m = self._indentation_m - self.axes["z"].position_m(now_ns)  # of the ball's lowest point
        share = above_m / self._pressed_m
        if share > 0.0:
            contact, guard = self._contact.result()
            move = self.axes["y"].profile
            if now_ns < move.end_ns:
                self.swept_m_s = move.speed_m_per_s
            if guard is not self._met or self.swept_m_s != self._met_m_s:
                self._meet(guard)
            at_m = self.axes["y"].position_m(now_ns)
            if at_m != self._last_m:
                self._forward = at_m > self._last_m
                self._way_m += abs(at_m - self._last_m)
            place = (at_m - self.settings.from_m) / _STEP_M
            contact = contact[0 if self._forward else -1]
            place = min(max(place, 0.0), len(contact) - 1.001)
            below, part = int(place), place % 1.0
            faded = min(share, 1.0) ** 1.5
            wrench[1:4] = [
                (before * (1.0 - part) + after * part) * faded
                for before, after in zip(contact[below].tolist(), contact[below + 1].tolist(), strict=True)
            ]
        self._last_m = self.axes["y"].position_m(now_ns)
        return wrench

    def _meet(self, met: GuardMet) -> None:
        """Note what a contact meets at the present speed of the stage, where that has not been said of it."""
        words = met.words
        if self.swept_m_s:
            words += speed_guard(self._rig.motion(self.swept_m_s))
        before = self._met_words if met is self._met else ()
        self._met, self._met_m_s, self._met_words = met, self.swept_m_s, words
        if words != before:
            self.guards.append(replace(met, words=words))

    def truth(self, now_ns: int) -> dict[str, float]:
        """Return where everything is and the true torque, by name."""
        return {
            "y_m": self.axes["y"].position_m(now_ns),
            "z_m": self.axes["z"].position_m(now_ns),
            "ring_m": self.true_ring_m(now_ns),
            "torque_n_m": float(self.true_wrench(now_ns)[3]),
        }

    def wrench(self, now_ns: int) -> list[float]:
        """Return what the sensor feels, with its noise: forces in N and torques in N m about x, y, z."""
        settings = self.settings
        if not self._noise:
            self._noise = self._noise_rng.standard_normal((_NOISE_ROWS, 6))[::-1].tolist()
        noise = self._noise.pop()
        beside = self.load_n_m + self._zero(now_ns)
        if self.load_n_m and not self.felt_ns:
            self.felt_ns, self.felt_y_m = now_ns, self.axes["y"].position_m(now_ns)
        force_n, torque_n_m = settings.force_noise_sd_n, settings.torque_noise_sd_n_m
        felt = [
            load + draw * (force_n if i < 3 else torque_n_m)
            for i, (load, draw) in enumerate(zip(self._touch(now_ns), noise, strict=True))
        ]
        felt[3] += beside
        return felt

    def _zero(self, now_ns: int) -> float:
        """Return what the sensor tells of no torque, which walks in some worlds."""
        if (walk := self.settings.beside.bias_walk_n_m_per_sqrt_s) > 0.0 and now_ns > self._zero_ns:
            seconds = (now_ns - self._zero_ns) * 1e-9 if self._zero_ns else 0.0
            self._zero_n_m += walk * seconds**0.5 * float(self._zero_rng.standard_normal())
            self._zero_ns = now_ns
        return self._zero_n_m

    def close(self) -> None:
        """End the solver's thread."""
        self._solver.shutdown(wait=True, cancel_futures=True)

    def _solve(self) -> None:
        self._contact, self._pressed_m = self._solved(), self._pressed()

    def _pressed(self) -> float:
        """Return how deep the probe is where it sweeps."""
        return self._rig.indentation_m + self._height_m

    def _solved(self) -> Future[tuple[Float64Array, GuardMet]]:
        ring_m = max(_LOWEST_RING_M, self.ring_state.true_m[-1] - self.settings.ring_zero_m)
        if not self.settings.beside.plain:
            sweeps = self._live.sweeps(self._code, self._mounting, ring_m, self._height_m, self._way_m)
            return self._solver.submit(
                _contact_in_world, self._rig, self._code, sweeps, self._mounting, self._lands_m
            )
        return self._solver.submit(
            _contact,
            self._rig,
            self._code,
            self._model,
            ring_m,
            self._pressed(),
            self.settings.from_m,
            self.settings.to_m,
        )


def _contact(
    rig: Rig,
    code: str,
    model: ContactModel,
    ring_m: float,
    indentation_m: float,
    from_m: float,
    to_m: float,
) -> tuple[Float64Array, GuardMet]:
    """Return lateral and normal force and torque at every step of the stretch, shape (1, n, 3), and guards.

    A straight line over 50 um misses a curve of the nodule's width by a few nN m.
    """
    table = solve(model, rig.probe, ring_m, indentation_m, from_m, to_m)
    words = rig.met(code, table.solved)
    stage_m = np.clip(
        from_m + _STEP_M * np.arange(round((to_m - from_m) / _STEP_M) + 1), table.low_m, table.high_m
    )
    loads = np.column_stack([table.lateral_n(stage_m), table.normal_n(stage_m), table.torque_n_m(stage_m)])
    return loads[None], GuardMet(code, ring_m, words)


def _contact_in_world(
    rig: Rig,
    code: str,
    sweeps: LiveSweeps,
    mounting: int,
    lands_m: tuple[float, float],
) -> tuple[Float64Array, GuardMet]:
    """Return the same in a world, of a sweep there and of one back, shape (2, n, 3)."""
    from_m, to_m = sweeps.ends_m
    stage_m = np.asarray(from_m + _STEP_M * np.arange(round((to_m - from_m) / _STEP_M) + 1), np.float64)
    both = [
        sweeps.of(lands_m[0], mounting, SPEED_M_S, forward=True),
        sweeps.of(lands_m[1], mounting, SPEED_M_S, forward=False),
    ]
    loads = [
        np.column_stack([one.lateral_n(stage_m), one.normal_n(stage_m), one.torque_n_m(stage_m)])
        for one in both
    ]
    return np.stack(loads), GuardMet(code, sweeps.ring_m, rig.met(code, both[0].solved))
