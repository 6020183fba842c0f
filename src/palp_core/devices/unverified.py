"""Say aloud which of a driver's parameters nobody has checked on the device yet."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping

from palp_core.errors import DeviceError

__all__ = ["UnverifiedWarning", "warn_unverified"]


class UnverifiedWarning(UserWarning):
    """A parameter rests on documents or memory; check it on the device and name it in ``verified``."""


def warn_unverified(device: str, advice: Mapping[str, str], verified: Collection[str]) -> None:
    """Warn of each parameter in ``advice`` that is not ``verified``; ``*`` verifies all (an emulator).

    Raises:
        DeviceError: ``verified`` names what needs no verification.
    """
    unknown = set(verified) - set(advice) - {"*"}
    if unknown:
        raise DeviceError(
            f"{device}: verified names {', '.join(sorted(unknown))};"
            f" what can be verified: {', '.join(sorted(advice))}"
        )
    for name in sorted(set(advice) - set(verified)) if "*" not in verified else []:
        warnings.warn(
            f"{device}: {name} is not verified on this device: {advice[name]}",
            UnverifiedWarning,
            stacklevel=3,
        )
