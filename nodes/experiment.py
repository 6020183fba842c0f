"""Run the palpation experiment: training, then estimation, and keep its record."""

from typing import Literal

from msgs.actuator import RingCommand, RingState, RingTruth
from msgs.estimation import Belief, Outlook, Palpation, PrimitivesLearnt
from msgs.experiment import Mount, PhantomTruth, PolicyChange, Trial, TrialResult
from msgs.stage import SweepGoal, SweepStatus
from msgs.torque import ContactGuard
from nodes.experiment_plan import (
    POLICY,
    ExperimentParams,
    ExperimentState,
    begin_trial_again,
    believed,
    design_of,
    find_mistakes,
    is_right,
    note_judged,
    plan_of,
    progress_of,
    take_up_marked,
)
from palp_core import Alarm, Node, Progress, Pub, Qos, Sub, Swap, on
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.session import plan
from palp_core.palpation.session.trials_csv import SessionWriter, primitives_json

Word = Literal["done", "continue", "decided", "undecided", "dropped", "failed"]
"""What came of a step, for the plan."""


class Experiment(Node):
    """Ask the plan for the next step, do it, and reply to the plan."""

    records = True
    params: ExperimentParams
    state: ExperimentState
    belief = Sub(Belief)
    outlook = Sub(Outlook, optional=True)
    palpation = Sub(Palpation)
    primitives = Sub(PrimitivesLearnt)
    ring_state = Sub(RingState)
    sweep = Sub(SweepStatus)
    ring_truth = Sub(RingTruth, optional=True)
    phantom_truth = Sub(PhantomTruth)
    guard = Sub(ContactGuard, optional=True)
    policy_change = Sub(PolicyChange, lasting=True)  # or the record would not say who chose
    trial = Pub(Trial)
    goal = Pub(SweepGoal)
    ring = Pub(RingCommand)
    mount = Pub(Mount)
    result = Pub(TrialResult, qos=Qos(depth=1000))  # who looks later still sees the session's trials
    progress = Pub(Progress)
    swap = Pub(Swap)
    waiting = Alarm()

    @classmethod
    def find_mistakes(cls, params: ExperimentParams, mistakes: Mistakes) -> None:
        find_mistakes(params, mistakes)

    def on_configure(self) -> None:
        self.design = design_of(self.params)
        self.swaps = plan.planned(self.params.swaps)
        self.record = SessionWriter(self.params.out, believed(self.params))
        self.plan: plan.Plan | None = None
        self.step: plan.Step | None = None

    def on_activate(self) -> None:
        if self.state.plan_seed < 0:
            self.state.plan_seed = int(self.rng.integers(2**31))
            self.record.start(overwrite=self.params.overwrite)
        self._advance()

    def on_restore(self) -> None:
        begin_trial_again(self.state, self.design)
        self.record.go_on(self.state.row)

    def on_deactivate(self) -> None:
        self.record.close()

    def _current_plan(self) -> plan.Plan:
        """Return the plan under way; a replacement leads a fresh one there by the replies it inherits."""
        if self.plan is None:
            self.plan = plan_of(self.design, self.state)
            replies = (plan.StepReply(word) for word in self.state.replies)  # type: ignore[arg-type]
            self.step = plan.resume(self.plan, replies)
        return self.plan

    # What the plan asks for

    def _advance(self) -> None:
        """Do steps as long as they are done at once; return when one has to be waited for."""
        current = self._current_plan()
        if not self._set_up_again():
            return
        while self.step is not None:
            word = self._do(self.step)
            if word is None:
                return
            self.state.replies.append(word)
            try:
                self.step = current.send(plan.StepReply(word))
            except StopIteration:
                self.step = None
        if not self.state.finished:
            self._report("done")
        self.state.finished = True
        self.finish(0)

    def _set_up_again(self) -> bool:
        """Put on what was on the rig and home the ring, before a trial begins again; return if done."""
        state = self.state
        if state.mount_again:
            if self._mount_phantom(plan.MountPhantom(state.mount_again)) is None:
                return False
            state.mount_again = ""
        if state.home_again:
            if self._rehome() is None:
                return False
            state.home_again = False
        return True

    def _do(self, step: plan.Step) -> Word | None:
        match step:
            case plan.MountPhantom():
                return self._mount_phantom(step)
            case plan.Rehome():
                return self._rehome()
            case plan.BeginTrial():
                state = self.state
                state.phase, state.trial, state.number = step.phase, step.index, step.number
                state.label_m = step.label_m
                state.trial_announced = False
                return "done"
            case plan.Wait():
                return self._wait(step)
            case plan.Palpate():
                return self._palpate(step)

    def _mount_phantom(self, step: plan.MountPhantom) -> Word | None:
        state = self.state
        if not state.commanded:
            state.commanded, state.code = True, ""
            state.remount += 1
            self.mount.publish(Mount(stamp_ns=self.now_ns(), code=step.phantom, remount=state.remount))
        state.commanded = state.code != step.phantom
        return None if state.commanded else "done"

    def _rehome(self) -> Word | None:
        state = self.state
        if not state.commanded:
            state.commanded, state.rehomed = True, False
            self.ring.publish(
                RingCommand(stamp_ns=self.now_ns(), trial=state.trial, iteration=0, ring_m=0.0, rehome=True)
            )
        state.commanded = not state.rehomed
        return "done" if state.rehomed else None

    def _wait(self, step: plan.Wait) -> Word | None:
        state = self.state
        if not state.commanded:
            state.commanded, state.waited = True, False
            self.waiting.set(self.now_ns() + round(step.duration_s * 1e9))
        state.commanded = not state.waited
        return "done" if state.waited else None

    def _palpate(self, step: plan.Palpate) -> Word | None:
        state, now_ns = self.state, self.now_ns()
        state.iteration = step.iteration
        if not state.trial_announced:
            self._announce_trial()
        if step.ring_given and not state.commanded:
            state.commanded = True
            self.ring.publish(
                RingCommand(stamp_ns=now_ns, trial=step.trial, iteration=step.iteration, ring_m=step.ring_m)
            )
        if not state.palpation or not (state.belief or state.phase != "estimation"):
            if not (state.swept or state.decided):
                self._sweep(step)
            return None
        palpation, belief = state.palpation[-1], state.belief[-1] if state.belief else None
        state.palpation, state.belief = [], []
        state.commanded = state.swept = state.decided = False
        self._write_row(palpation, belief)
        return belief.verdict if belief else "done"  # type: ignore[return-value]

    def _sweep(self, step: plan.Palpate) -> None:
        """Send the goal once ring and stage are ready for it."""
        state = self.state
        ring_there = (state.ring_trial, state.ring_iteration) == (step.trial, step.iteration)
        if ring_there and state.ring_settled and state.stage_ready:
            state.swept, state.stage_ready = True, False
            state.goal_id += 1
            state.begin_sweep()
            self._send_goal(cancel=False)

    def _send_goal(self, *, cancel: bool) -> None:
        self.goal.publish(
            SweepGoal(
                stamp_ns=self.now_ns(),
                goal_id=self.state.goal_id,
                from_m=self.params.from_m,
                to_m=self.params.to_m,
                cancel=cancel,
            )
        )

    def _announce_trial(self) -> None:
        state = self.state
        state.trial_announced = True
        training = state.phase == "training"  # in estimation the depth stays hidden
        self.trial.publish(
            Trial(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                phase=state.phase,
                number=state.number,
                code=state.code if training else "",
                label_known=training,
                depth_m=state.label_m if training else 0.0,
            )
        )
        run = self.swaps.get(state.trials_done + 1, "") if state.phase == "estimation" else ""
        if run:  # the policy that is there begins the trial, the next one goes on with it
            state.next_policy = plan.policy_name(run)
            self.swap.publish(Swap(stamp_ns=self.now_ns(), node=POLICY, run=run))

    # What the rig answers

    @on(phantom_truth)
    def note_phantom(self, truth: PhantomTruth) -> None:
        self.state.note_phantom(truth)
        self._advance()

    @on(ring_state)
    def note_ring(self, ring: RingState) -> None:
        state = self.state
        state.ring_settled = ring.settled
        state.note_ring(ring)
        if ring.rehome:  # it returns to its target, so the last command stays fulfilled
            state.rehomed = ring.settled and ring.trial == state.trial
        else:
            state.ring_trial, state.ring_iteration = ring.trial, ring.iteration
        self._advance()

    @on(waiting)
    def _end_wait(self) -> None:
        self.state.waited = True
        self._advance()

    @on(ring_truth)
    def note_true_ring(self, truth: RingTruth) -> None:
        state = self.state
        of_sweep = (truth.trial, truth.iteration) == (state.trial, state.iteration)
        if state.swept and of_sweep and truth.ring_m != state.true_ring_m:
            state.guards = []  # it comes after the ring's state, on which the goal was sent
            state.true_ring_m = truth.ring_m
        else:
            state.note_true_ring(truth)

    @on(guard)
    def note_guard(self, guard: ContactGuard) -> None:
        self.state.note_guard(guard)

    @on(policy_change)
    def _note_policy(self, change: PolicyChange) -> None:
        """Know who chooses from a palpation on; the one before it may not be written yet."""
        self.state.policy_changes.append(change)

    @on(sweep)
    def note_sweep(self, status: SweepStatus) -> None:
        state = self.state
        if status.status == "sweeping":
            state.note_sweeping(status)
        elif status.status == "cancelled" and not state.decided:
            state.swept = False  # it is swept again
        elif status.status == "ready" and status.goal_id == state.goal_id:
            state.stage_ready = True
            self._advance()

    @on(outlook)
    def _stop_decided(self, outlook: Outlook) -> None:
        """Stop a sweep once it is decided: the trial ends with what is felt so far."""
        state = self.state
        if outlook.verdict == "decided" and not state.decided and self._is_present(outlook):
            state.decided = True
            if state.swept:
                self._send_goal(cancel=True)

    @on(palpation)
    def note_palpation(self, palpation: Palpation) -> None:
        if self._is_present(palpation):
            self.state.palpation = [palpation]
            self._advance()

    @on(belief)
    def note_belief(self, belief: Belief) -> None:
        if self._is_present(belief):
            self.state.belief = [belief]
            self._advance()

    def _is_present(self, message: Outlook | Palpation | Belief) -> bool:
        """Return whether something is of the palpation under way, and not of one that was ended before."""
        return (message.trial, message.iteration) >= (self.state.trial, self.state.iteration)

    @on(primitives)
    def note_primitives(self, learnt: PrimitivesLearnt) -> None:
        self.record.primitives(primitives_json(learnt))

    def _write_row(self, palpation: Palpation, belief: Belief | None) -> None:
        state, params = self.state, self.params
        row = state.row_of(palpation, belief, policy=params.policy, seed=params.seed)
        self.record.append(row, palpation.torque_n_m, palpation.rate_hz)
        state.begin_next(palpation)
        state.palpations_done += 1
        state.sweep_s += len(palpation.torque_n_m) / palpation.rate_hz
        if belief is not None and belief.verdict != "continue":
            self._close_trial(belief)
        self._report(state.phase)

    def _close_trial(self, belief: Belief) -> None:
        state = self.state
        state.trials_done += 1
        if belief.verdict == "dropped":
            state.dropped_count += 1
        else:
            right = is_right(self.design, belief.estimate_m, state.depth_m)
            state.right_count += right
            note_judged(state, right=right)
        for words in take_up_marked(state, self.design, self.record.folder):
            self.log.warning("%s", words)
        self.result.publish(
            TrialResult(
                stamp_ns=self.now_ns(),
                trial=state.trial,
                estimate_m=belief.estimate_m,
                confidence=belief.confidence,
                probe_count=belief.iteration,
                verdict=belief.verdict,
            )
        )

    def _report(self, phase: str) -> None:
        self.progress.publish(progress_of(self.design, self.state, phase, self.now_ns()))
