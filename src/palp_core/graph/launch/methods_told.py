"""Which exchangeable methods the nodes of a run say they use, and from when on."""

from collections.abc import Sequence

import msgspec

from palp_core.graph.messages.builtin import MethodsUsed, MethodUse


class MethodTold(msgspec.Struct, frozen=True, kw_only=True):
    """A method that a node began to use.

    Attributes:
        node: Who uses it.
        at_s: From when on, on the graph's clock.
        until_s: When another took its place, or the node had no more use for it; None if that never was.
        use: The method, and why it.
    """

    node: str
    at_s: float
    until_s: float | None = None
    use: MethodUse


class MethodsTold:
    """Collects what the nodes of a run say in :class:`MethodsUsed` messages.

    Attributes:
        told: In the order in which they were said; what is said again unchanged, as by a successor, is once.
    """

    def __init__(self) -> None:
        self.told: list[MethodTold] = []
        self._standing: dict[tuple[str, str, str], int] = {}

    def restore(self, told: Sequence[MethodTold]) -> None:
        """Know what was said before an interruption."""
        self.told = list(told)
        self._standing = {
            (one.node, one.use.task, one.use.of): place
            for place, one in enumerate(self.told)
            if one.until_s is None
        }

    def observe(self, _: int, topic: str, used: MethodsUsed) -> None:
        """Take what a node reports."""
        self.note(topic.split("/")[1], used)

    def note(self, node: str, said: MethodsUsed) -> None:
        """Note what a node uses from now on."""
        at_s = said.stamp_ns / 1e9
        named = {(node, use.task, use.of): use for use in said.uses}
        for key in [key for key in self._standing if key[0] == node]:
            before = self._standing[key]
            if named.get(key) != self.told[before].use:
                self.told[before] = msgspec.structs.replace(self.told[before], until_s=at_s)
                del self._standing[key]
        for key, use in named.items():
            if key not in self._standing:
                self._standing[key] = len(self.told)
                self.told.append(MethodTold(node=node, at_s=at_s, use=use))
