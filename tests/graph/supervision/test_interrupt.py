"""What asks for the end, and what an interruption is to what meets it."""

import os
import pickle
import signal

import pytest

from palp_core.graph.supervision import interrupt
from palp_core.graph.supervision.interrupt import Interrupt, Interrupted


@pytest.mark.parametrize(
    ("number", "asked_by", "said"),
    [
        (signal.SIGINT, "", "interrupted by SIGINT"),
        (signal.SIGTERM, "", "interrupted by SIGTERM"),
        (signal.SIGINT, "palp graph end", "ended by palp graph end"),
    ],
)
def test_an_interruption_comes_out_of_a_worker_as_it_was(
    number: signal.Signals, asked_by: str, said: str
) -> None:
    """An exception that a process pool cannot unpickle ends in a traceback of the pool's own."""
    back = pickle.loads(pickle.dumps(Interrupted(number, asked_by)))
    assert (type(back), back.signal, str(back)) == (Interrupted, number, said)


@pytest.mark.parametrize("breaks_in", [True, False])
def test_a_second_request_breaks_into_the_work_only_where_it_may(
    monkeypatch: pytest.MonkeyPatch, breaks_in: bool
) -> None:
    monkeypatch.setattr(interrupt, "INSIST_NS", -1)
    with Interrupt(breaks_in=breaks_in) as asked:
        os.kill(os.getpid(), signal.SIGTERM)
        assert (asked.requested, asked.second_request) == (True, False)
        raised = False
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except Interrupted:
            raised = True
        assert (raised, asked.second_request) == (breaks_in, True)


def test_a_hang_up_that_is_ignored_as_under_nohup_ends_nothing() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupt(breaks_in=False) as asked:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not asked.requested
    finally:
        signal.signal(signal.SIGHUP, before)
