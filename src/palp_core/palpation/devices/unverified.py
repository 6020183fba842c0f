"""Warn of the driver's parameters that were not checked on the device yet."""

import warnings
from collections.abc import Collection, Mapping

from palp_core.errors import DeviceError


class UnverifiedWarning(UserWarning):
    """A parameter rests on documents or memory; check it on the device and name it in ``verified``."""


def not_verified(device: str, advice: Mapping[str, str], verified: Collection[str]) -> dict[str, str]:
    """Return what in ``advice`` is not ``verified``, by name; ``*`` verifies all (an emulator)."""
    unknown = set(verified) - set(advice) - {"*"}
    if unknown:
        raise DeviceError(
            f"{device}: verified names {', '.join(sorted(unknown))};"
            f" what can be verified: {', '.join(sorted(advice))}"
        )
    return {} if "*" in verified else {name: advice[name] for name in sorted(set(advice) - set(verified))}


def warn_unverified(device: str, advice: Mapping[str, str], verified: Collection[str]) -> None:
    """Warn of each parameter that is not verified; errors as for :func:`not_verified`."""
    for name, check in not_verified(device, advice, verified).items():
        warnings.warn(
            f"{device}: {name} is not verified on this device: {check}", UnverifiedWarning, stacklevel=3
        )
