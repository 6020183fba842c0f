"""The reference of what devices promise, made from the suite that checks it."""

from __future__ import annotations

from palp_core.palpation.devices.contract import PROMISES

_HEAD = """# What a driver promises

`palp devices contract MODULE:CLASS` checks these promises on your driver and reports which one is broken,
and how. To write a driver, see [a driver](../how_to/driver.md). For what its methods take and return, see
[the protocols](python_rig.md#devices).

| device | promise | meaning |
|---|---|---|
"""


def promises_page() -> str:
    """Return the page as Markdown."""
    rows = [f"| {', '.join(one.kinds)} | {one} | {(one.check.__doc__ or '').strip()} |\n" for one in PROMISES]
    return _HEAD + "".join(rows)
