"""The reference of units, made from the aliases themselves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from msgspec import Meta

from palp_core import units

_HEAD = """# Python: units

`from palp_core.units import Metres, ...`: annotations for fields of messages and parameters. Each has a unit
and bounds. Decoding refuses numbers out of bounds, NaN and infinity. All values on the wire are in SI units.

```python
# with_units.py
from palp_core import Message
from palp_core.units import Newtons, Seconds


class Press(Message):
    force_n: Newtons
    held_s: Seconds
```

Declare a missing unit in one line:

```python
# own_unit.py
from typing import Annotated

from palp_core import Message
from palp_core.units import quantity

Moles = Annotated[float, quantity("mol", 0.0, 1e3)]


class Dose(Message):
    salt_mol: Moles
```

::: palp_core.units.quantity

::: palp_core.units.array_of

## All

| name | type | unit | least | largest |
|---|---|---|---|---|
"""


def units_page() -> str:
    """Return the page as Markdown."""
    rows = [
        f"| `{name}` | {kind} | {unit} | {low} | {high} |\n" for name, kind, unit, low, high in quantities()
    ]
    return _HEAD + "".join(rows)


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
