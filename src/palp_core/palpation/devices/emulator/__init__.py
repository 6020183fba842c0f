"""Emulated devices that speak the real ones' bytes, over one simulated rig.

>>> from palp_core.palpation.devices.emulator import EmulatedRig
>>> with EmulatedRig(devices=("ati",)) as rig:
...     sorted(rig.addresses)
['ati']
"""

from palp_core.palpation.devices.emulator.rig import DEVICES, EmulatedRig, RigSettings

__all__ = ["DEVICES", "EmulatedRig", "RigSettings"]
