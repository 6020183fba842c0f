"""The reference of what devices promise, made from the suite that checks it."""

from __future__ import annotations

from collections.abc import Callable

from palp_core.palpation.devices.contract import CONTRACTS, Subject, promises_of

_HEAD = """# What a driver promises

`palp devices contract MODULE:CLASS` checks these promises on your driver and reports which one is broken,
and how. To write a driver, see [a driver](../how_to/driver.md). For what its methods take and return, see
[the protocols](python_rig.md#devices).

| device | promise | meaning |
|---|---|---|
"""


def promises_page() -> str:
    """Return the page as Markdown."""
    kinds: dict[str, list[str]] = {}
    checks: dict[str, Callable[[Subject], None]] = {}
    for kind in CONTRACTS:
        for promise, check in promises_of(kind).items():
            kinds.setdefault(promise, []).append(kind)
            checks[promise] = check
    rows = [
        f"| {', '.join(kinds[promise])} | {promise} | {(check.__doc__ or '').strip()} |\n"
        for promise, check in checks.items()
    ]
    return _HEAD + "".join(rows)
