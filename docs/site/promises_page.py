"""The reference of what devices promise, made from the suite that checks it."""

from __future__ import annotations

from palp_core.palpation.devices.contract import PROMISES

_HEAD = """# What a driver promises

`palp devices contract MODULE:CLASS` checks these on a driver of your own, one by one, and says which is
broken and how; [devices](../devices.md) says how a driver is written, and what its methods are given and
return.

| who | promises that | that is |
|---|---|---|
"""


def promises_page() -> str:
    """Return the page as Markdown."""
    rows = [f"| {', '.join(one.kinds)} | {one} | {(one.check.__doc__ or '').strip()} |\n" for one in PROMISES]
    return _HEAD + "".join(rows)
