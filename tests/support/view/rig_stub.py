"""A small running graph that speaks as a rig does, on the machine's clock: for pages that are looked at.

One node is safety, the other one all the rest. Depth and accuracy have digits that stand nowhere else.
"""

from __future__ import annotations

from pathlib import Path

from tests.support.palp import Palp, wait_for_line
from tests.support.supervised import write_files

DEPTH_M = 0.00432179865
"""Of the phantom that is mounted."""
POSTERIOR = (0.061415926, 0.871828182, 0.066755892)
PEAK_N_M = 0.0316227766

NODE = f'''
import numpy as np

from msgs.actuator import RingState
from msgs.emg import CoContraction
from msgs.estimation import Belief, PrimitivesLearnt
from msgs.experiment import PhantomTruth, Trial, TrialResult
from msgs.safety import AcknowledgeReply, AcknowledgeRequest, SafetyBeat, StatusReply, StopRequest
from msgs.stage import StagePose, SweepStatus
from msgs.torque import ContactGuard, TorqueBlock
from palp_core import DiagnosticStatus, Node, Params, Progress, Pub, Qos, Srv, State, every, serve
from palp_core.units import HertzPositive

DEPTHS_M = [0.002, {DEPTH_M}, 0.008]
POSTERIOR = np.array({POSTERIOR})
PEAK_N_M = {PEAK_N_M}
KEPT = Qos(durability="transient_local", depth=20)


class RigParams(Params):
    depth_m: float = {DEPTH_M}
    rate_hz: HertzPositive = 20.0


class RigState(State):
    block: int = 0


class Rig(Node):
    """Everything of a rig that a page looks at."""

    moves = True
    params: RigParams
    state: RigState
    pose = Pub(StagePose)
    torque = Pub(TorqueBlock)
    trial = Pub(Trial, qos=KEPT)
    belief = Pub(Belief, qos=KEPT)
    result = Pub(TrialResult, qos=KEPT)
    truth = Pub(PhantomTruth, qos=KEPT)
    learnt = Pub(PrimitivesLearnt, qos=KEPT)
    guard = Pub(ContactGuard, qos=KEPT)
    progress = Pub(Progress, qos=KEPT)
    cocontraction = Pub(CoContraction)
    diagnostics = Pub(DiagnosticStatus, qos=Qos(durability="transient_local", depth=1))

    def on_activate(self):
        now = self.now_ns()
        print(f"the bead is near: {{self.params.depth_m}}", flush=True)
        words = "the bead is near"
        self.diagnostics.publish(DiagnosticStatus(stamp_ns=now, level="warn", text=words, advice=words))
        self.truth.publish(PhantomTruth(
            stamp_ns=now, code="K7", depth_m=DEPTHS_M[1], remount=0, height_offset_m=0.0,
            rung="l2", bound=0.0))
        means = np.array([0.02, PEAK_N_M, 0.01, 0.02, PEAK_N_M, 0.01])
        self.learnt.publish(PrimitivesLearnt(
            stamp_ns=now, depths_m=np.array(DEPTHS_M), rings_m=np.array([0.008, 0.016]),
            mean_n_m=means, sd_n_m=means / 20, count=np.full(6, 25.0),
            floor_n_m=1e-6))
        self.guard.publish(ContactGuard(
            stamp_ns=now, code="K7", remount=0, ring_m=0.016, words=["the bead is near: l4 takes over"]))
        self.result.publish(TrialResult(
            stamp_ns=now + 1, trial=1, estimate_m=DEPTHS_M[1], confidence=POSTERIOR[1], probe_count=3,
            verdict="decided"))
        self.result.publish(TrialResult(
            stamp_ns=now + 2, trial=2, estimate_m=0.008, confidence=POSTERIOR[1], probe_count=2,
            verdict="decided"))
        self.trial.publish(Trial(
            stamp_ns=now, trial=3, number=1, phase="estimation", code="", label_known=False, depth_m=0.0))
        self.belief.publish(Belief(
            stamp_ns=now, trial=3, iteration=1, depths_m=np.array(DEPTHS_M), posterior=POSTERIOR,
            gain=POSTERIOR * np.log(3 * POSTERIOR), gamma=0.0, gamma_defined=False, verdict="continue",
            estimate_m=DEPTHS_M[1], confidence=POSTERIOR[1], outlier=False))
        self.progress.publish(Progress(
            stamp_ns=now, phase="estimation", done_count=2, total_count=30, score=0.5, score_defined=True,
            text="trials, right: 4.32179865 mm 1 of 2"))

    @every("rate_hz")
    def go_on(self):
        now, state = self.now_ns(), self.state
        goal, place = divmod(state.block, 80)
        state.block += 1
        places = -0.03 + 0.08 * (place * 50 + np.arange(50)) / 4000
        start = now - 50_000_000
        self.pose.publish(StagePose(
            stamp_ns=now, goal_id=goal + 1, start_ns=start, rate_hz=1000.0, position_m=places))
        torque = PEAK_N_M * np.exp(-((places / 0.01) ** 2))
        self.torque.publish(TorqueBlock(
            stamp_ns=now, start_ns=start, rate_hz=1000.0, over_phantom=True, saturated_count=0,
            torque_n_m=torque))
        self.cocontraction.publish(CoContraction(
            stamp_ns=now, start_ns=start, rate_hz=1500.0, reference_v=1.0, value=np.full(75, 0.25),
            burst_count=4, level=2, level_defined=True))


class SafetyState(State):
    state: str = "ready"
    cause: str = ""
    text: str = ""
    acknowledged_count: int = 0


class SafetyParams(Params):
    rate_hz: HertzPositive = 20.0


class Safety(Node):
    """Stops when it is asked to; stage and ring stand as they are."""

    moves = True
    params: SafetyParams
    state: SafetyState
    beat = Pub(SafetyBeat)
    status = Pub(SweepStatus, qos=KEPT)
    ring = Pub(RingState, qos=KEPT)
    stop = Srv(StopRequest, StatusReply)
    acknowledge = Srv(AcknowledgeRequest, AcknowledgeReply)

    def on_activate(self):
        now = self.now_ns()
        self.status.publish(SweepStatus(stamp_ns=now, goal_id=1, status="sweeping"))
        self.ring.publish(RingState(
            stamp_ns=now, trial=3, iteration=1, rehome=False, target_m=0.016, measured_m=0.0161,
            settled=True))

    @every("rate_hz")
    def go_on(self):
        self.publish_beat()

    def publish_beat(self):
        state = self.state
        self.beat.publish(SafetyBeat(
            stamp_ns=self.now_ns(), state=state.state, permits=not state.cause, permits_sweep=not state.cause,
            cause=state.cause,
            text=state.text, acknowledged_count=state.acknowledged_count,
            warning="the bead is near" if state.cause else ""))

    @serve(stop)
    def obey(self, request):
        state = self.state
        state.state, state.cause, state.text = "latched", "operator", request.reason
        self.publish_beat()
        return StatusReply(
            stamp_ns=self.now_ns(), state=state.state, permits=False, permits_sweep=False, cause=state.cause,
            text=state.text, warning="", acknowledged_count=state.acknowledged_count, checks=[])

    @serve(acknowledge)
    def release(self, request):
        state = self.state
        state.acknowledged_count += bool(state.cause)
        state.state, state.cause, state.text = "ready", "", ""
        self.publish_beat()
        return AcknowledgeReply(done=True, state=state.state, text="")
'''

LAUNCH = """
graph: NAME
clock: wall
nodes:
  safety: {run: "nodes.rig_stub:Safety"}
  rig: {run: "nodes.rig_stub:Rig"}
view: palp_core.palpation.live_page.page:rig
"""


def launch_stub(palp: Palp, folder: Path, name: str, *arguments: str) -> None:
    """Launch it under a name, and wait until it runs."""
    write_files(folder, {"nodes/rig_stub.py": NODE, "launch/stub.yaml": LAUNCH.replace("NAME", name)})
    process = palp.start("launch", folder / "launch" / "stub.yaml", *arguments)
    wait_for_line(process, "estimation: ")
