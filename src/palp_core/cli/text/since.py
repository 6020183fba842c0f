"""Points of time as one types them."""

import re
from datetime import UTC, datetime, time, timedelta

from palp_core.errors import PalpError
from palp_core.graph.clock import unix_ns

_AGO = re.compile(r"(\d+(?:\.\d+)?)([smhd])")
_UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days"}
_OF_A_DAY = re.compile(r"T?\d\d:")
_DAY = timedelta(days=1)


def since(text: str) -> datetime:
    """Return the time that is meant: so long ago, the last such time of a day, or written out.

    >>> since("2026-11-22T12:00:00+00:00").isoformat()
    '2026-11-22T12:00:00+00:00'
    """
    now = datetime.fromtimestamp(unix_ns() / 1e9, UTC).astimezone()
    try:
        return _meant(text, now)
    except (ValueError, OverflowError):  # the second: further away than the calendar reaches
        raise PalpError(
            f"'{text}' is no time; write 30s, 5m, 2h or 1d ago, 14:30 of today or else of yesterday, "
            "or 2026-01-31T14:30"
        ) from None


def _meant(text: str, now: datetime) -> datetime:
    if ago := _AGO.fullmatch(text):
        return now - timedelta(**{_UNITS[ago[2]]: float(ago[1])})
    if not _OF_A_DAY.match(text):
        return datetime.fromisoformat(text).astimezone()
    of_day = time.fromisoformat(text)
    today = datetime.combine(now.date(), of_day).astimezone()
    return today if today <= now else datetime.combine(now.date() - _DAY, of_day).astimezone()
