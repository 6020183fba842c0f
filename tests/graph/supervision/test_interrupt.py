"""What an interruption is to whoever meets it."""

import pickle
import signal

import pytest

from palp_core.graph.supervision.interrupt import Interrupted


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
