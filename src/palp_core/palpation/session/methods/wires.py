"""The methods by which a run's samples travelled: what its parameters come to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from palp_core.graph.launch.methods_told import MethodTold
from palp_core.palpation.devices.blocks import LENGTHS
from palp_core.palpation.session.methods.used import used

if TYPE_CHECKING:
    from palp_core.graph.launch.summary import RunSummary

_RATE_HZ = 1000.0
_SAMPLE_BYTES = 8
_LAUNCHER = "launcher"


def wire_uses(summary: RunSummary) -> Iterator[MethodTold]:
    """Yield how long a run's blocks of samples were, and how they became bytes.

    Nodes do not say these: they follow from parameters.

    Args:
        summary: How the run went.
    """
    known = {"wall_clock": float(summary.clock == "wall")}
    largest = 0
    for node, params in summary.params.items():
        samples, rate_hz = params.get("block_samples"), params.get("rate_hz", _RATE_HZ)
        if not samples:
            continue
        largest = max(largest, samples)
        if name := _length(samples / rate_hz):
            yield MethodTold(node=node, at_s=0.0, use=used("block", name, given=known))
    if largest:
        known["array_bytes"] = float(_SAMPLE_BYTES * largest)
        yield MethodTold(node=_LAUNCHER, at_s=0.0, use=used("codec", given=known))


def delivery_uses(summary: RunSummary) -> Iterator[MethodTold]:
    """Yield how messages came to their readers; it follows from how the run was launched.

    In simulated time it makes no difference to what comes out.

    Args:
        summary: How the run went.
    """
    process_count = 1 if summary.composed else len(summary.params)
    known = {"wall_clock": float(summary.clock == "wall"), "process_count": float(process_count)}
    for name, inputs in summary.deliveries.items():
        use = used("delivery", given=known)
        if use.name != name:
            use = msgspec.structs.replace(used("delivery", name, given=known), of=", ".join(inputs))
        yield MethodTold(node=_LAUNCHER, at_s=0.0, use=use)


def _length(length_s: float) -> str:
    """Return the name of the register's length of blocks; empty where it has none so long."""
    return next((one.name for one in LENGTHS if abs(one.length_s - length_s) < 1e-9), "")
