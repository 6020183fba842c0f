"""The reference of units, made from the aliases themselves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from msgspec import Meta

from palp_core import units


def units_table() -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the table of all units."""
    yield "name", "type", "unit", "min", "max"
    for name, kind, unit, low, high in quantities():
        yield f"`{name}`", kind, unit, low, high


def quantities() -> Iterator[tuple[str, str, str, str, str]]:
    """Yield name, kind of number, unit and bounds of each quantity."""
    for name, alias in vars(units).items():
        metas = [meta for meta in get_args(alias) if isinstance(meta, Meta)]
        if name.startswith("_") or not metas:
            continue
        meta = metas[0]
        kind = get_args(alias)[0]
        extra: dict[str, Any] = meta.extra_json_schema or {}
        low, high = (meta.extra or {}).get("bounds", (meta.ge, meta.le))
        of = kind.__name__ if kind in (int, float) else "array of float64"
        yield name, of, str(extra.get("x-unit", "1")), _bound(low), _bound(high)


def _bound(value: float | None) -> str:
    return "" if value is None else f"{value:g}"
