"""Exchangeable methods: declared beside their code, listed by ``palp methods list``, chosen by one function.

A contact rung, a root finder, a smoother, a stop rule, a policy, a codec is declared where it is written::

    @method(
        task="contact",
        name="l2",
        cost_s=0.05,
        bounds=[Bound("peak", 0.01), Bound("contrast", 0.10, within={"depth_m": (0.0, 0.004)})],
        evidence="tests/palpation/mechanics/contact/test_l2.py",
        fails="contrast over a deep bead",
        survivor="l4",
    )
    class LayeredHertz: ...

and :func:`choose` answers "what is the cheapest method that is good enough here?" and says why. Ranges are in
the quantities of :mod:`palp_core.methods.quantities`; :func:`declare_quantity` adds your own. A package
that brings methods of its own names the module that declares them as an entry point of the group
:data:`~palp_core.methods.register.GROUP`; a name with a colon, ``package.module:name``, needs none.
"""

from palp_core.methods.choice import Candidate, MethodChoice, choose, weigh
from palp_core.methods.quantities import QUANTITIES, declare_quantity
from palp_core.methods.register import (
    Bound,
    Method,
    Quantities,
    Range,
    Task,
    at_work,
    declare_task,
    find,
    left_out,
    method,
    methods,
    names,
    outside,
    task,
    tasks,
)

__all__ = [
    "QUANTITIES",
    "Bound",
    "Candidate",
    "Method",
    "MethodChoice",
    "Quantities",
    "Range",
    "Task",
    "at_work",
    "choose",
    "declare_quantity",
    "declare_task",
    "find",
    "left_out",
    "method",
    "methods",
    "names",
    "outside",
    "task",
    "tasks",
    "weigh",
]
