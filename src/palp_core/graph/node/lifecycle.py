"""Managed-node states, as in ROS 2."""

from __future__ import annotations

from enum import StrEnum

from palp_core.errors import LifecycleError


class Lifecycle(StrEnum):
    """Primary states."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class Transition(StrEnum):
    """What can be asked of a node."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    CLEANUP = "cleanup"
    SHUTDOWN = "shutdown"


_TABLE: dict[tuple[Lifecycle, Transition], Lifecycle] = {
    (Lifecycle.UNCONFIGURED, Transition.CONFIGURE): Lifecycle.INACTIVE,
    (Lifecycle.INACTIVE, Transition.ACTIVATE): Lifecycle.ACTIVE,
    (Lifecycle.ACTIVE, Transition.DEACTIVATE): Lifecycle.INACTIVE,
    (Lifecycle.INACTIVE, Transition.CLEANUP): Lifecycle.UNCONFIGURED,
    (Lifecycle.UNCONFIGURED, Transition.SHUTDOWN): Lifecycle.FINALIZED,
    (Lifecycle.INACTIVE, Transition.SHUTDOWN): Lifecycle.FINALIZED,
    (Lifecycle.ACTIVE, Transition.SHUTDOWN): Lifecycle.FINALIZED,
}


def successor(state: Lifecycle, transition: Transition) -> Lifecycle:
    """Return the state that a transition leads to.

    Raises:
        LifecycleError: The transition is not allowed from this state.
    """
    target = _TABLE.get((state, transition))
    if target is None:
        allowed = ", ".join(t.value for (s, t) in _TABLE if s is state) or "none"
        raise LifecycleError(f"cannot {transition.value} a node that is {state.value}; allowed: {allowed}")
    return target
