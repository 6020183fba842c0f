"""What is known when a palpation is written down: to the experiment, and again from a bag of its run."""

from typing import Any

from palp_core.graph.node.node import State
from palp_core.palpation.session.plan import policy_name
from palp_core.palpation.session.trials_csv import Row


class RowFacts(State):
    """The facts of a row other than its palpation and belief.

    ``policy`` is the one that took over last, empty before; ``policy_changes`` are those, each from a
    palpation on, that no row has come to yet. ``touch_changed``: the next sweep meets its guards again.
    """

    row: int = 0
    phase: str = ""
    code: str = ""
    remount: int = -1
    trial: int = 0
    number: int = 0
    depth_m: float = 0.0
    true_ring_m: float | None = None
    true_height_m: float | None = None
    guards: list[str] = []
    touch_changed: bool = False
    ring_landed: bool = False
    last_ring_m: float = -1.0
    enter_ns: int | None = None
    leave_ns: int | None = None
    policy: str = ""
    next_policy: str = ""
    policy_changes: list[Any] = []

    def note_phantom(self, truth: Any) -> None:
        """Take a ``PhantomTruth``."""
        self.code, self.depth_m, self.true_height_m = truth.code, truth.depth_m, truth.height_offset_m
        self.touch_changed = True

    def note_ring(self, ring: Any) -> None:
        """Take a ``RingState``; where no simulation reports its true position, it may land elsewhere."""
        self.ring_landed |= ring.rehome
        self.touch_changed |= not ring.settled and self.true_ring_m is None

    def note_true_ring(self, truth: Any) -> None:
        """Take a ``RingTruth``."""
        self.touch_changed |= truth.ring_m != self.true_ring_m
        self.true_ring_m = truth.ring_m

    def begin_sweep(self) -> None:
        if self.touch_changed:  # what the sweep meets is published again
            self.guards, self.touch_changed = [], False

    def note_sweeping(self, status: Any) -> None:
        """Take the ``SweepStatus`` of a sweep that begins."""
        self.enter_ns, self.leave_ns = status.enter_ns, status.leave_ns

    def note_guard(self, guard: Any) -> None:
        """Take a ``ContactGuard``, unless it is of a phantom that is being taken off."""
        if guard.code == self.code:
            self.guards = list(guard.words)

    def row_of(self, palpation: Any, belief: Any, *, policy: str, seed: int) -> Row:
        """Return the row of a palpation.

        ``belief`` is None in training; the session began with ``policy``, given by name or by its class.
        """
        began_with, of = policy_name(policy), (palpation.trial, palpation.iteration)
        while self.policy_changes and (self.policy_changes[0].trial, self.policy_changes[0].iteration) <= of:
            self.policy = self.policy_changes.pop(0).policy
        return Row(
            row=self.row,
            session=f"{began_with}-{seed}",
            phase=self.phase,
            phantom=self.code,
            remount=self.remount,
            trial=self.number,
            depth_m=self.depth_m,
            iteration=palpation.iteration,
            ring_m=palpation.ring_m,
            true_ring_m=self.true_ring_m,
            true_height_m=self.true_height_m,
            peak_n_m=palpation.peak_n_m,
            posterior=belief.posterior.tolist() if belief else [],
            gain=belief.gain.tolist() if belief else [],
            gamma=belief.gamma if belief and belief.gamma_defined else None,
            verdict=belief.verdict if belief else "",
            estimate_m=belief.estimate_m if belief else None,
            outlier=belief.outlier if belief else False,
            policy=self.policy or began_with,
            seed=seed,
            start_ns=palpation.start_ns,
            end_ns=palpation.end_ns,
            landed=self.ring_landed or palpation.ring_m != self.last_ring_m,
            guards=list(self.guards),
            enter_ns=self.enter_ns,
            leave_ns=self.leave_ns,
        )

    def begin_next(self, palpation: Any) -> None:
        """Leave a palpation behind: its row is written."""
        self.row += 1
        self.ring_landed, self.last_ring_m = False, palpation.ring_m
        self.policy, self.next_policy = self.next_policy or self.policy, ""
