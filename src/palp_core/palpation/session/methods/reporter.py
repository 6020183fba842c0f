"""Base of a node that reports which methods it uses: a topic, and what was published last."""

from palp_core.graph.messages.builtin import MethodsUsed, MethodUse
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.node import Node, State
from palp_core.graph.node.ports import Pub
from palp_core.methods import left_out


class MethodReporterState(State):
    """What a replacement inherits: the methods that were reported last, so that none is reported twice."""

    methods_told: list[MethodUse] = []


class MethodReporter(Node):
    """A node that reports which methods it uses: at its start, after a swap, and as its methods change.

    The topic is latched, so that a later recorder has all of it, too.
    """

    state: MethodReporterState
    methods = Pub(MethodsUsed, qos=Qos(durability="transient_local", depth=100))

    def uses(self) -> list[MethodUse]:
        """Return the methods in use now, as :func:`.used.used` words each; none: not yet known."""
        return []

    def on_activate(self) -> None:
        uses = self.uses()
        for why in left_out() if uses else ():
            self.log.warning("left out: %s", why)
        self.publish_methods(uses)

    def on_resume(self) -> None:
        self.publish_methods(self.uses())

    def publish_methods(self, uses: list[MethodUse]) -> None:
        """Publish which methods are used from now on, where any are known that were not published last."""
        if uses and uses != self.state.methods_told:
            self.state.methods_told = uses
            self.methods.publish(MethodsUsed(stamp_ns=self.now_ns(), uses=uses))
