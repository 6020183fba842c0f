"""The boundary to other people's code: what it raises, logs and warns becomes palp's own."""

import importlib
import logging
import threading
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from palp_core.errors import PalpError
from palp_core.extras import advice


class _Boundary(threading.local):
    """The remarks of the library that this thread is calling; None outside every call."""

    remarks: list[str] | None = None


_IN_THREAD = _Boundary()


@contextmanager
def catch_foreign(place: str, error_type: type[PalpError], fix: str = "") -> Iterator[list[str]]:
    """Turn exceptions, log lines and warnings of the libraries that are called within into palp's own.

    Only this thread's log lines are caught, and none of palp's own. Calls may be nested. ::

        with catch_foreign(str(path), PalpError, "export it again") as remarks:
            signals = library.read(path)
        notes += remarks

    Args:
        place: What the library works on: a file, a device. The error begins with it.
        error_type: Class of the error.
        fix: What to do about an exception; the error ends with it.

    Yields:
        What the libraries have logged from WARNING on, and warned, so far; no text twice. None of it
        reaches the screen: the caller shows what matters to a user.

    Raises:
        PalpError: Of class ``error_type``, if a library raises. One that is raised within passes as it is.
    """
    remarks: list[str] = []
    before, _IN_THREAD.remarks = _IN_THREAD.remarks, remarks
    last_resort = [logging.lastResort] if logging.lastResort else []
    for handler in logging.getLogger().handlers or last_resort:
        handler.addFilter(_keep_remark)  # once only, and for good: outside a call it lets everything pass
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            show = warnings.showwarning

            def keep(message: Warning | str, category: type[Warning], *where: Any, **also: Any) -> None:
                if _is_own(category.__module__):
                    show(message, category, *where, **also)
                else:
                    _add(remarks, str(message))

            warnings.showwarning = keep
            yield remarks
    except PalpError:
        raise
    except (Exception, SystemExit) as error:
        traceback.clear_frames(error.__traceback__)  # half-made objects go now, and what they log is caught
        raise error_type("; ".join(filter(None, (f"{place}: {describe_foreign(error)}", fix)))) from error
    finally:
        _IN_THREAD.remarks = before


def import_foreign(target: str, place: str, error_type: type[PalpError]) -> Any:
    """Import what another package publishes.

    Args:
        target: ``module:attribute``, or a ``module``.
        place: What it is; the error begins with it.
        error_type: Class of the error.

    Raises:
        PalpError: Of class ``error_type``: it raises or exits as it is imported, or has no such attribute.
    """
    module, _, attribute = target.partition(":")
    with catch_foreign(f"{place}: cannot import '{target}'", error_type):
        found = importlib.import_module(module)
        return getattr(found, attribute) if attribute else found


def describe_foreign(error: BaseException) -> str:
    """Return another library's exception as one line.

    It has type and text; the system's errors have the text alone, a missing module the command to install it.

    >>> describe_foreign(KeyError("fs")), describe_foreign(OSError(28, "No space left on device"))
    ("KeyError: 'fs'", 'No space left on device')
    """
    if isinstance(error, ImportError) and (line := advice(error)):
        return line
    if isinstance(error, OSError) and error.strerror:
        return " ".join(error.strerror.split())
    return f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")


def _keep_remark(record: logging.LogRecord) -> bool:
    """Keep the log line of a library that this thread is calling; let any other pass to its handler."""
    if _IN_THREAD.remarks is None or _is_own(record.name):
        return True
    if record.levelno >= logging.WARNING:
        _add(_IN_THREAD.remarks, record.getMessage())
    return False


def _add(remarks: list[str], text: str) -> None:
    text = " ".join(text.split())
    if text not in remarks:
        remarks.append(text)


def _is_own(name: str) -> bool:
    return name.partition(".")[0] in ("palp", "palp_core", "nodes")
