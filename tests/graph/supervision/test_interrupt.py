"""What an interruption is to whoever meets it."""

import pickle
import signal

import pytest

from palp_core.graph.supervision.interrupt import Interrupted


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_comes_out_of_a_worker_as_it_was(number: signal.Signals) -> None:
    """An exception that a process pool cannot unpickle ends in a traceback of the pool's own."""
    back = pickle.loads(pickle.dumps(Interrupted(number)))
    assert (type(back), back.signal, str(back)) == (Interrupted, number, f"interrupted by {number.name}")
