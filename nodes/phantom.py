"""Simulate the phantom under the probe: the true torque of each stage position."""

from collections.abc import Sequence
from typing import Annotated, Any

from msgs.actuator import RingTruth
from msgs.experiment import Mount, PhantomTruth, WorldTruth
from msgs.stage import StagePose
from msgs.torque import Contact, ContactGuard
from palp_core import Params, Pub, ReadOnly, Sub, on
from palp_core.graph.messages.builtin import MethodUse
from palp_core.graph.node.node import Mistakes
from palp_core.methods import errors_name
from palp_core.palpation.mechanics.contact.model import ContactModel
from palp_core.palpation.mechanics.equilibrium.joint import GridMoments
from palp_core.palpation.mechanics.equilibrium.sweep_table import SweepTable, solve
from palp_core.palpation.mechanics.scene.rig import Rig, rig
from palp_core.palpation.perception.belief.rig_noise import read_noise
from palp_core.palpation.session.method_choices import FeatureName, Reading, what_is_read
from palp_core.palpation.session.methods.reporter import MethodReporter, MethodReporterState
from palp_core.palpation.session.methods.used import rig_uses
from palp_core.palpation.session.named_files import find_file_mistakes
from palp_core.palpation.world.draws import SessionSweeps, SessionWorld, derive_seed, name_offsets, open_world
from palp_core.palpation.world.model import read_world
from palp_core.palpation.world.trace import WorldTrace
from palp_core.units import (
    Float64Array,
    Kilograms,
    Metres,
    Millimetres,
    Probability,
    RatioNonNegative,
    quantity,
)

MARGIN_M = 0.002
HeightSpread = Annotated[float, quantity("mm", 0.0, 100.0)]
SPEED_M_S = 0.02
"""The published one, until a block of poses shows it."""


class PhantomParams(Params):
    """What the probe touches in a simulated or an emulated rig, set in the launch file.

    ``phantoms`` is a YAML file of phantoms by code; empty means the paper's three. ``reading`` and
    ``feature`` are the estimator's: the contact model must get right what is read, within ``tolerance``.
    ``scene`` is a scene file: where given, gel, probe, indentation and tolerance are its own, and the
    parameters of that name are not used. ``height_sd_mm`` is the spread of
    the surface's height over remounts (assumed: set down by hand against a stop); a noise file in ``noise``
    has its own. ``world`` is the paper's own design, ``lab``, or a YAML file of what else is on. Friction,
    tip mass and indentation are assumed, as the paper gives none.
    """

    phantoms: ReadOnly[str] = ""
    scene: ReadOnly[str] = ""
    reading: ReadOnly[Reading] = "feature"
    feature: ReadOnly[FeatureName] = "peak"
    tolerance: ReadOnly[Probability] = 0.02
    from_m: ReadOnly[Metres] = -0.03
    to_m: ReadOnly[Metres] = 0.05
    indentation_mm: ReadOnly[Millimetres] = 4.0
    height_sd_mm: ReadOnly[HeightSpread] = 0.1
    noise: ReadOnly[str] = ""
    friction: ReadOnly[RatioNonNegative] = 0.3
    tip_mass_kg: ReadOnly[Kilograms] = 0.008
    world: ReadOnly[str] = "paper"

    @property
    def touch(self) -> dict[str, Any]:
        """The arguments of :func:`.rig`."""
        return {
            "phantoms": self.phantoms,
            "scene": self.scene,
            "read": what_is_read(self.reading, self.feature),
            "tolerance": self.tolerance,
            "indentation_m": self.indentation_mm * 1e-3,
            "friction": self.friction,
            "tip_mass_kg": self.tip_mass_kg,
            "ends_m": (self.from_m, self.to_m),
        }


class SimulatedPhantom(MethodReporter):
    """What a simulated phantom says of itself, in whatever rig it is put on."""

    simulates = True
    params: PhantomParams
    truth = Pub(PhantomTruth)
    guard = Pub(ContactGuard)
    world_truth = Pub(WorldTruth)

    @classmethod
    def find_mistakes(cls, params: PhantomParams, mistakes: Mistakes) -> None:
        find_file_mistakes(params, mistakes)

    def on_configure(self) -> None:
        params = self.params
        self.noise = read_noise(params.noise) if params.noise else None
        self.height_sd_m = self.noise.height_sd_m.value if self.noise else params.height_sd_mm * 1e-3
        self.world = read_world(params.world)

    def draw_height_m(self) -> float:
        """Return how much higher than nominal the surface lies this time; two numbers are drawn."""
        return self.height_sd_m * float(self.rng.standard_normal(2)[0])

    def publish_truth(self, mount: Mount, rig: Rig, height_m: float) -> None:
        """Publish what the phantom is that was put on, and which contact model is used for it."""
        bead, choice = rig.phantoms[mount.code].bead, rig.choices[mount.code]
        self.truth.publish(
            PhantomTruth(
                stamp_ns=self.now_ns(),
                code=mount.code,
                remount=mount.remount,
                depth_m=bead.depth_m if bead is not None else 0.0,
                height_offset_m=height_m,
                rung=choice.method.name,
                bound=choice.bound or 0.0,
            )
        )

    def publish_offsets(self, mount: Mount, row: Float64Array) -> None:
        """Publish what this mounting is off by in its world."""
        self.world_truth.publish(
            WorldTruth(
                stamp_ns=self.now_ns(),
                world=self.world.name,
                code=mount.code,
                remount=mount.remount,
                **name_offsets(row),
            )
        )

    def publish_guard(self, code: str, remount: int, ring_m: float, words: Sequence[str]) -> None:
        """Publish in which regions sweeps over this mounting meet a method that fails."""
        self.guard.publish(
            ContactGuard(stamp_ns=self.now_ns(), code=code, remount=remount, ring_m=ring_m, words=list(words))
        )


class PhantomState(MethodReporterState):
    """What a replacement inherits."""

    code: str = ""
    remount: int = 0
    height_offset_m: float = 0.0
    ring_m: float = 0.0
    speed_m_s: float = 0.0
    guard_published: bool = False
    world_seed: int = 0
    path_m: float = 0.0
    goal_path_m: float = 0.0
    worn_m: float = 0.0
    goal_id: int = -1
    goal_from_m: float = 0.0


class Phantom(SimulatedPhantom):
    """Answer poses with the torque of the equilibrium, solved once per ring position, mount and direction."""

    params: PhantomParams
    state: PhantomState
    mount = Sub(Mount)
    ring = Sub(RingTruth)
    pose = Sub(StagePose)
    contact = Pub(Contact)

    def on_configure(self) -> None:
        super().on_configure()
        self.rig = rig(**self.params.touch)
        self.models: dict[str, ContactModel] = {code: self.rig.model(code) for code in self.rig.by_depth}
        self.table: SweepTable | WorldTrace | None = None
        self.moments = GridMoments()
        self.sweeps: SessionSweeps | None = None
        self._live: SessionWorld | None = None

    def uses(self) -> list[MethodUse]:
        return rig_uses(self.rig, self.state.speed_m_s or None, self.world)

    @on(mount)
    def put_on(self, mount: Mount) -> None:
        phantoms = self.rig.phantoms
        if mount.code not in phantoms:
            raise ValueError(f"no phantom '{mount.code}'; there are {', '.join(sorted(phantoms))}")
        state = self.state
        state.code, state.remount = mount.code, mount.remount
        state.height_offset_m = self.draw_height_m()
        self._forget()
        self.publish_truth(mount, self.rig, state.height_offset_m)
        if not self.world.plain:
            state.world_seed = state.world_seed or derive_seed(self.rng)
            row = self.live.row(state.code, state.remount, state.height_offset_m, state.path_m)
            self.publish_offsets(mount, row)

    @on(ring)
    def stiffen(self, ring: RingTruth) -> None:
        if ring.ring_m != self.state.ring_m:
            self.state.ring_m = ring.ring_m
            self._forget()

    @on(pose)
    def touch(self, pose: StagePose) -> None:
        self._note_speed(pose)
        if not self.world.plain:
            self._note_sweep(pose)
        if self.table is None:
            self.table = self._table(pose)
            self._publish_guards(self.table)
        self.contact.publish(
            Contact(
                stamp_ns=self.now_ns(),
                goal_id=pose.goal_id,
                start_ns=pose.start_ns,
                rate_hz=pose.rate_hz,
                torque_n_m=self.table.torque_n_m(pose.position_m),
            )
        )

    def _forget(self) -> None:
        self.table, self.sweeps, self.state.guard_published = None, None, False
        self.state.worn_m = self.state.path_m

    def _note_speed(self, pose: StagePose) -> None:
        """See how fast the stage sweeps; what the mechanics guarantee depends on it."""
        way_m = pose.position_m
        if len(way_m) < 2:
            return
        speed_m_s = abs(float(way_m[-1] - way_m[0])) / (len(way_m) - 1) * pose.rate_hz
        speed_m_s = float(f"{speed_m_s:.3g}")  # positions come in steps of a nanometre
        if speed_m_s != self.state.speed_m_s:
            self.state.speed_m_s = speed_m_s
            self.publish_methods(self.uses())
            if self.table is not None:
                self._publish_guards(self.table, again=True)

    def _table(self, pose: StagePose) -> SweepTable | WorldTrace:
        if not self.state.code:
            raise ValueError("the probe sweeps but no phantom is mounted")
        with errors_name(self.rig.choices[self.state.code].method):
            return self._solve() if self.world.plain else self._solve_in_world(pose)

    def _solve(self) -> SweepTable:
        state, params = self.state, self.params
        ends_m = (params.from_m - MARGIN_M, params.to_m + MARGIN_M)
        return solve(
            self.models[state.code],
            self.rig.probe,
            state.ring_m,
            self.rig.indentation_m + state.height_offset_m,
            *ends_m,
            moments=self.moments,
        )

    @property
    def live(self) -> SessionWorld:
        """The session in its world, which follows from the seed: a replacement has the same."""
        if self._live is None:
            from_m, to_m = sorted((self.params.from_m, self.params.to_m))
            seed = self.state.world_seed
            self._live = open_world(self.rig, self.world, seed, from_m - MARGIN_M, to_m + MARGIN_M)
        return self._live

    def _note_sweep(self, pose: StagePose) -> None:
        """See where a sweep began, which is where the probe was lowered, and how far it has gone."""
        state, way_m = self.state, pose.position_m
        if pose.goal_id != state.goal_id and len(way_m):
            state.goal_id, state.goal_from_m, self.table = pose.goal_id, float(way_m[0]), None
            state.goal_path_m = state.path_m
        if len(way_m):  # from its beginning, so that it is the same however long blocks are
            state.path_m = state.goal_path_m + abs(float(way_m[-1]) - state.goal_from_m)

    def _solve_in_world(self, pose: StagePose) -> WorldTrace:
        state = self.state
        if self.sweeps is None:
            self.sweeps = self.live.sweeps(
                state.code, state.remount, state.ring_m, state.height_offset_m, state.worn_m
            )
        went_m = float(pose.position_m[-1]) - state.goal_from_m
        ends_m = self.sweeps.ends_m
        forward = went_m > 0.0 if went_m else state.goal_from_m < 0.5 * (ends_m[0] + ends_m[1])
        speed_m_s = state.speed_m_s or SPEED_M_S
        return self.sweeps.of(state.goal_from_m, state.goal_id, speed_m_s, forward=forward)

    def _publish_guards(self, table: SweepTable | WorldTrace, *, again: bool = False) -> None:
        """Say what the sweeps of this mounting and ring meet: once, and again where that has changed."""
        state = self.state
        words = list(self.rig.met(state.code, table.solved, state.speed_m_s or None))
        if (words or again) and (again or not state.guard_published):
            state.guard_published = True
            self.publish_guard(state.code, state.remount, state.ring_m, words)
