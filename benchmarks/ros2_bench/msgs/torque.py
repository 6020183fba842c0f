"""A sample of torque that says which it is and when it was sent."""

from palp_core import Message
from palp_core.units import NewtonMetres


class Sample(Message):
    """``index`` counts from 1; ``sent_ns`` is on the host's monotonic clock; both as a wrench has them."""

    index: float
    sent_ns: float
    torque_n_m: NewtonMetres
