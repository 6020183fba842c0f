"""Exchangeable methods: rows of tables, listed by ``palp methods list``, chosen by one function.

What can be done in several ways is a task; each way is a row of a module that is named as an entry point of
the group :data:`~palp_core.methods.register.GROUP`::

    METHODS = [
        Method(
            task="stop",
            name="patient",
            place="softlab.rules:Patient",
            cost_s=3e-6,
            bounds=[Bound("decision", 0.03, within={"class_count": (2.0, 3.0)})],
            evidence="tests/test_patient.py",
            fails="easy trials",
            survivor="posterior_threshold",
        )
    ]

:func:`choose` answers "what is the cheapest method that is good enough here?" and says why. A table may bring
tasks (``TASKS``) and quantities of its own (``QUANTITIES``). A name with a colon, ``package.module:name``,
reads the table of that module, which needs no entry point.
"""

from palp_core.methods.choice import Candidate, MethodChoice, choose, weigh
from palp_core.methods.register import (
    Bound,
    Method,
    Quantities,
    Range,
    Task,
    errors_name,
    find,
    left_out,
    methods,
    names,
    outside,
    quantities,
    task,
    tasks,
)

__all__ = [
    "Bound",
    "Candidate",
    "Method",
    "MethodChoice",
    "Quantities",
    "Range",
    "Task",
    "choose",
    "errors_name",
    "find",
    "left_out",
    "methods",
    "names",
    "outside",
    "quantities",
    "task",
    "tasks",
    "weigh",
]
