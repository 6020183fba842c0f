"""Managed-node states, as in ROS 2."""

from enum import StrEnum

from palp_core.errors import LifecycleError


class Lifecycle(StrEnum):
    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class Transition(StrEnum):
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
    """Return the state that a transition leads to."""
    target = _TABLE.get((state, transition))
    if target is None:
        allowed = ", ".join(t.value for (s, t) in _TABLE if s is state) or "none"
        raise LifecycleError(f"cannot {transition.value} a node that is {state.value}; allowed: {allowed}")
    return target


def transitions(state: Lifecycle) -> dict[Transition, Lifecycle]:
    """Return the transitions that a state allows, each with the state that it leads to."""
    return {t: _TABLE[state, t] for t in Transition if (state, t) in _TABLE}


class LifecycleHooks:
    """What a node does on a transition; a class overrides what it needs; one that raises fails the node."""

    def on_configure(self) -> None:
        """Prepare what does not move: load files, build tables."""

    def on_graph_ready(self, run_dir: str) -> None:
        """Wall clock, recorders only: every node is configured and connected, none is active yet."""

    def on_activate(self) -> None:
        """Begin work: open the device, publish the first value."""

    def on_resume(self) -> None:
        """Continue a predecessor's work instead of beginning: open the device as ``self.state`` left it."""

    def on_restore(self) -> None:
        """Make what is outside ``self.state`` fit it: an interrupted run resumes from a checkpoint.

        Devices start again; ``on_activate`` follows.
        """

    def on_deactivate(self) -> None:
        """Stop work and reach the safe state; also run when a graph ends or its supervisor dies."""

    def on_cleanup(self) -> None:
        """Undo ``on_configure``."""

    def on_shutdown(self) -> None:
        """Last words; the process ends afterwards."""
