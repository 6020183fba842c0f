"""The table of what devices promise, made from the suite that checks it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from palp_core.palpation.devices.contract import CONTRACTS, Subject, promises_of


def promises() -> Iterator[tuple[str, str, str]]:
    """Yield each promise with the devices that make it."""
    yield "device", "promise", "meaning"
    kinds: dict[str, list[str]] = {}
    checks: dict[str, Callable[[Subject], None]] = {}
    for kind in CONTRACTS:
        for promise, check in promises_of(kind).items():
            kinds.setdefault(promise, []).append(kind)
            checks[promise] = check
    for promise, check in checks.items():
        yield ", ".join(kinds[promise]), promise, (check.__doc__ or "").strip()
