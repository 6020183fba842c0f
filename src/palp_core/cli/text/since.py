"""Points of time as one types them."""

import re
from datetime import UTC, datetime, time, timedelta

from palp_core.errors import PalpError
from palp_core.graph.clock import unix_ns

_AGO = re.compile(r"(\d+(?:\.\d+)?)([smhd])")
_UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days"}


def since(text: str) -> datetime:
    """Return the time that is meant: so long ago, of today, or written out.

    >>> since("2026-11-22T12:00:00+00:00").isoformat()
    '2026-11-22T12:00:00+00:00'

    Raises:
        PalpError: It is none of these.
    """
    now = datetime.fromtimestamp(unix_ns() / 1e9, UTC).astimezone()
    if ago := _AGO.fullmatch(text):
        return now - timedelta(**{_UNITS[ago[2]]: float(ago[1])})
    try:
        return datetime.combine(now.date(), time.fromisoformat(text)).astimezone()
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).astimezone()
    except ValueError:
        raise PalpError(
            f"'{text}' is no time; write 30s, 5m, 2h or 1d ago, 14:30 of today, or 2026-01-31T14:30"
        ) from None
