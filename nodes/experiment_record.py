"""What the experiment writes down of a palpation, and says of its progress."""

from typing import Any

from msgs.estimation import Belief, Palpation, PrimitivesLearnt
from msgs.experiment import Trial, TrialResult
from nodes.experiment_params import ExperimentParams, ExperimentState
from palp_core import Progress
from palp_core.palpation.session.plan import ExperimentDesign
from palp_core.palpation.session.plan_repeatability import RepeatDesign, sweep_count
from palp_core.palpation.session.trials_csv import Row


def row_of(
    params: ExperimentParams, state: ExperimentState, palpation: Palpation, belief: Belief | None
) -> Row:
    """Return the record's row of a palpation; in training there is no belief."""
    return Row(
        row=state.row,
        session=f"{params.policy}-{params.seed}",
        phase=state.phase,
        phantom=state.code,
        remount=state.remount,
        trial=state.trial,
        depth_m=state.depth_m,
        iteration=state.iteration,
        ring_m=palpation.ring_m,
        true_ring_m=state.true_ring_m,
        true_height_m=state.true_height_m,
        peak_n_m=palpation.peak_n_m,
        posterior=belief.posterior.tolist() if belief else [],
        gain=belief.gain.tolist() if belief else [],
        gamma=belief.gamma if belief and belief.gamma_defined else None,
        verdict=belief.verdict if belief else "",
        estimate_m=belief.estimate_m if belief else None,
        outlier=belief.outlier if belief else False,
        policy=state.policy or params.policy,
        seed=params.seed,
        start_ns=palpation.start_ns,
        end_ns=palpation.end_ns,
        landed=state.ring_landed or palpation.ring_m != state.last_ring_m,
        guards=list(state.guards),
    )


def primitives_of(learnt: PrimitivesLearnt) -> dict[str, Any]:
    """Return the memory primitives as the record keeps them, a row per depth and a column per ring."""
    shape = (len(learnt.depths_m), len(learnt.rings_m))
    return {
        "depths_m": learnt.depths_m.tolist(),
        "rings_m": learnt.rings_m.tolist(),
        "mean": learnt.mean_n_m.reshape(shape).tolist(),
        "sd": learnt.sd_n_m.reshape(shape).tolist(),
        "count": learnt.count.reshape(shape).tolist(),
        "floor": learnt.floor_n_m,
    }


def trial_of(state: ExperimentState, now_ns: int) -> Trial:
    """Return the trial that begins; of a trial of estimation nobody is told the depth."""
    training = state.phase == "training"
    return Trial(
        stamp_ns=now_ns,
        trial=state.trial,
        phase=state.phase,
        code=state.code if training else "",
        label_known=training,
        depth_m=state.label_m if training else 0.0,
    )


def result_of(state: ExperimentState, belief: Belief, now_ns: int) -> TrialResult:
    """Return what a trial of estimation came to."""
    return TrialResult(
        stamp_ns=now_ns,
        trial=state.trial,
        estimate_m=belief.estimate_m,
        confidence=belief.confidence,
        probe_count=belief.iteration,
        verdict=belief.verdict,
    )


def progress_of(
    design: ExperimentDesign | RepeatDesign, state: ExperimentState, phase: str, now_ns: int
) -> Progress:
    """Return how far a phase has come: palpations in training, trials afterwards."""
    if isinstance(design, RepeatDesign):
        return Progress(
            stamp_ns=now_ns,
            phase=phase,
            done_count=state.palpations_done,
            total_count=sweep_count(design),
            text="palpations",
            score=0.0,
            score_defined=False,
            busy_s=state.sweep_s,
        )
    judged_count = state.trials_done - state.dropped_count
    training, phantom_count = phase == "training", len(design.phantoms)
    palpation_count = design.repeats * phantom_count * len(design.rings_m)
    return Progress(
        stamp_ns=now_ns,
        phase=phase,
        done_count=state.palpations_done if training else state.trials_done,
        total_count=palpation_count if training else design.trials_per_phantom * phantom_count,
        text="palpations" if training else "trials",
        score=state.right_count / judged_count if judged_count else 0.0,
        score_defined=judged_count > 0,
        busy_s=state.sweep_s,
    )
