"""What a policy asks of a trace's reader, and what it is told: between messages and the trial's memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.perception.trace.terms import Offer, SweepTerms
from palp_core.palpation.session.trace.reader import TraceMemory
from palp_core.palpation.session.trace.watch import TraceWatch
from palp_core.units import Float64Array


def terms_of(action: Any) -> SweepTerms:
    """Return how a palpation is made, from the message of an action."""
    return SweepTerms(action.indentation_m, action.speed_m_s, action.from_m, action.to_m)


def offer_of(question: Any) -> Offer:
    """Return what is asked about, from the message of a question."""
    columns = (question.indentation_m, question.speed_m_s, question.from_m, question.to_m)
    terms = (SweepTerms(*row) for row in zip(*(one.tolist() for one in columns), strict=True))
    sweeps = tuple(zip(question.ring_m.tolist(), terms, strict=True))
    return Offer(sweeps, question.torque_limit_n_m, question.force_limit_n)


def promised(watch: TraceWatch | None, memory: TraceMemory, question: Any) -> tuple[Float64Array, list[str]]:
    """Return the bits that each palpation of a question is expected to tell, and why some are none.

    Args:
        watch: What reads traces; None: nothing does.
        memory: Of the trial.
        question: The message.

    Returns:
        As of :meth:`.TraceWatch.promise`; where nothing can be promised, -1.0 for all.
    """
    nothing = np.full(len(question.ring_m), -1.0)
    if watch is None:
        return nothing, ["the estimator reads features; sweeps are chosen by the reading trace"]
    try:
        return watch.promise(memory, offer_of(question))
    except PalpError as error:
        return nothing, [str(error)]
