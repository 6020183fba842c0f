"""Emulated devices that speak the real ones' bytes, over one simulated rig.

>>> from palp_core.palpation.devices.emulator import EmulatedRig
>>> with EmulatedRig(devices=("netft",)) as rig:
...     sorted(rig.addresses)
['netft']
"""

from palp_core.palpation.devices.emulator.rig import DEVICES, EmulatedRig
from palp_core.palpation.devices.emulator.settings import RigSettings

__all__ = ["DEVICES", "EmulatedRig", "RigSettings"]
