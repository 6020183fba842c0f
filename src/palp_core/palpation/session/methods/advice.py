"""What in a run no method has a bound for, or will not be as it is asked for: reported before it begins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from palp_core.methods import left_out
from palp_core.palpation.devices.blocks import Stream, late_blocks, longest_s
from palp_core.palpation.mechanics.scene.guard import speed_guard
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.session.methods.used import rig_of
from palp_core.palpation.session.plan import planned, policy_name
from palp_core.palpation.session.roles import Roles, roles_of

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary


def advice(summary: RunSummary) -> list[str]:
    """Return what in a run its methods have no bound for, or will not happen, and what to do."""
    roles, wall_clock = roles_of(summary), summary.clock == "wall"
    broken = [f"left out: {words}" for words in left_out()]
    late = _late(roles, wall_clock=wall_clock)
    return [*broken, *_speed(roles), *late, *_too_late_swaps(roles), *_unfelt(roles, summary)]


def _unfelt(roles: Roles, summary: RunSummary) -> Iterator[str]:
    """Yield which device moves without the emulated phantom, which follows emulated devices alone."""
    heard = summary.listens.get(roles.node.get("phantom", ""), [])
    if not roles.touch_simulated or any(topic.startswith(f"/{roles.node['stage']}/") for topic in heard):
        return
    from palp_core.palpation.devices.emulator import DEVICES

    for role in ("stage", "actuator"):
        device = roles.params(role).get("device")
        if device not in DEVICES:
            yield (
                f"/{roles.node[role]}: device: {device}: the emulated phantom follows emulated devices alone "
                f"({', '.join(DEVICES)}): what this one does changes no torque"
            )


def _too_late_swaps(roles: Roles) -> Iterator[str]:
    """Yield which policies are to take over in a trial that there will not be."""
    params = roles.params("experiment")
    swaps = planned(params.get("swaps") or "")
    if not swaps or "trials" not in params:  # of an experiment of one's own
        return
    each = params["trials"] if params.get("plan", "paper") == "paper" else 0
    beads = [one.bead for one in load_phantoms(params.get("phantoms", "")).values() if one.bead is not None]
    count = each * len(beads)
    why = f"trials are counted from 1 to {count}, over all phantoms" if count else "it has no trials"
    for trial, run in swaps.items():
        if not 1 <= trial <= count:
            policy = f"{trial}={run}: {policy_name(run)}"
            yield f"/{roles.node['experiment']}: swaps: {policy} never takes over: {why}"


def _speed(roles: Roles) -> Iterator[str]:
    """Yield that the stage sweeps faster than a computed touch without inertia is bounded for."""
    speed_m_s = roles.params("stage").get("sweep_speed_m_s")
    if not roles.touch_simulated or speed_m_s is None:
        return
    motion = rig_of(roles.params("phantom")).motion(speed_m_s)
    bounds = [bound for bound in motion.method.bounds if bound.output == motion.output]
    enough = [bound.within["speed_m_s"][1] for bound in bounds if bound.error <= motion.tolerance]
    for words in speed_guard(motion):
        yield (
            f"/{roles.node['stage']}: sweep_speed_m_s: {speed_m_s:g}: {words}; every palpation will be "
            f"marked so; sweep at {max(enough, default=0.0):g} m/s or slower"
        )


def _late(roles: Roles, *, wall_clock: bool) -> Iterator[str]:
    """Yield which samples come later than their reader wants them."""
    streams: Mapping[str, Stream] = {"torque": "torque", "emg": "emg"}
    if "block_samples" not in roles.params("torque"):  # simulated: as the stage's poses come
        within = roles.params("stage").get("within_sweep", True)
        streams = {"stage": "torque" if within else "sweep", "emg": "emg"}
    for role, stream in streams.items():
        params = roles.params(role)
        if "block_samples" not in params:
            continue
        rate_hz, most_s = params["rate_hz"], longest_s(stream, wall_clock=wall_clock)
        if late := late_blocks(stream, params["block_samples"] / rate_hz, wall_clock=wall_clock):
            most = f"give {int(most_s * rate_hz * (1.0 + 1e-9))} at most, at {rate_hz:g} Hz"
            yield f"/{roles.node[role]}: block_samples: {params['block_samples']}: {late}; {most}"
    load_hz = roles.params("torque").get("load_hz")
    if load_hz and (late := late_blocks("load", 1.0 / load_hz, wall_clock=wall_clock)):
        least_hz = math.ceil(1.0 / longest_s("load", wall_clock=wall_clock))
        yield f"/{roles.node['torque']}: load_hz: {load_hz:g}: {late}; give {least_hz} at least"
