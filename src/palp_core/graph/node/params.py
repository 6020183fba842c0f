"""From plain values to a node's parameters: validated as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from palp_core.errors import GraphError
from palp_core.graph.node.node import Declaration, Params
from palp_core.graph.node.param_description import describe_params

SLOWEST_HZ, FASTEST_HZ = 1e-9, 1e9  # the grid of ticks is in whole ns


def load_params(declared: Declaration, values: Mapping[str, Any], where: str) -> Params:
    """Return validated parameters.

    Raises:
        GraphError: An unknown name, a wrong type, a value out of bounds, or a timer's rate that is none.
    """
    try:
        params = msgspec.convert(dict(values), declared.params)
    except msgspec.ValidationError as error:
        raise GraphError(f"{where}: parameters: {error}") from error
    for name, timer in declared.timers.items():
        rate_hz = getattr(params, timer.hz)
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise GraphError(
                f"{where}: parameters: '{timer.hz}' is the rate of '{name}': {rate_hz:g} is no rate"
            )
    return params


def changed_params(declared: Declaration, present: Params, changes: Mapping[str, Any], where: str) -> Params:
    """Return the parameters with some of them changed.

    Raises:
        GraphError: As :func:`load_params`, or a change of a parameter that is read-only.
    """
    before = msgspec.to_builtins(present)
    described = describe_params(declared.params)
    for name, value in changes.items():
        if name in described and described[name].read_only and value != before[name]:
            raise GraphError(
                f"{where}: parameter '{name}' is read-only: it is looked at when the node is configured; "
                "state it in the launch file"
            )
    return load_params(declared, {**before, **changes}, where)
