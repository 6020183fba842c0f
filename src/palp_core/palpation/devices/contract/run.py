"""Check a driver's promises one after the other, each on a device that was made anew."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from palp_core.errors import DeviceError, in_words
from palp_core.palpation.devices.contract.promises import PROMISES, Promise
from palp_core.palpation.devices.contract.subject import Patience, PromiseBroken, Subject

MOVES = {
    "stage": "the stage moves up to 20 mm to either side of y = 0, and raises and lowers the probe",
    "ring": "the ring moves up to 10 mm",
}
"""What the promises of a kind move, in words."""


@dataclass(frozen=True)
class PromiseOutcome:
    """What became of a promise: why it is broken, or ""."""

    promise: Promise
    broken: str = ""


def promises_of(kind: str) -> list[Promise]:
    """Return what a kind of device promises."""
    return [promise for promise in PROMISES if kind in promise.kinds]


def check_driver(
    kind: str,
    name: str,
    options: Mapping[str, Any],
    *,
    simulated: bool = False,
    patience_s: float = 60.0,
) -> Iterator[PromiseOutcome]:
    """Yield what becomes of each promise; what moves is moved, see :data:`MOVES`.

    Args:
        kind: ``stage``, ``ring``, ``torque`` or ``emg``.
        name: A back end's, or ``module:Class`` or ``path.py:Class``.
        options: Of its driver.
        simulated: It goes by the time that it is told, not by the machine's.
        patience_s: Longest wait for something that a device does.

    Raises:
        DeviceError: The driver cannot be made: another name, an option, or a member that its kind wants.
    """
    Subject(kind, name, dict(options))
    for promise in promises_of(kind):
        subject = Subject(kind, name, dict(options), Patience(patience_s), simulated)
        try:
            promise.check(subject)
            outcome = PromiseOutcome(promise)
        except PromiseBroken as broken:
            outcome = PromiseOutcome(promise, str(broken))
        except Exception as error:  # noqa: BLE001 - a driver may raise anything, and the next promise is told
            what = "refuses" if isinstance(error, DeviceError) else "fails"
            outcome = PromiseOutcome(promise, f"it {what}: {in_words(error)}{_where(error)}")
        finally:
            subject.device.close()
        yield outcome


def _where(error: BaseException) -> str:
    """Return the place of an error that is nobody's refusal."""
    if isinstance(error, DeviceError):
        return ""
    frames = inspect.getinnerframes(error.__traceback__) if error.__traceback__ is not None else []
    return f" ({frames[-1].filename}:{frames[-1].lineno})" if frames else ""
