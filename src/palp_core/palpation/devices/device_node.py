"""What a node with a device is made of: the link opens with the node, the memory goes over with its state."""

from typing import Any

from palp_core.graph.node.node import Node, State
from palp_core.palpation.devices.protocols import restored


class DeviceNodeState(State):
    """What a replacement inherits: what the device remembers."""

    device: Any = None


class DeviceNode(Node):
    """A node that holds a device, simulated or real, which it makes in ``on_configure``."""

    state: DeviceNodeState
    device: Any

    @property
    def memory(self) -> Any:
        """What the device remembers, held here; of a predecessor's state its plain values are left."""
        self.state.device = restored(self.device, self.state.device)
        return self.state.device

    def on_activate(self) -> None:
        self.device.open(self.now_ns(), self.memory, self.rng)

    def on_resume(self) -> None:
        self.device.open(self.now_ns(), self.memory, self.rng)

    def on_deactivate(self) -> None:
        self.device.close()
