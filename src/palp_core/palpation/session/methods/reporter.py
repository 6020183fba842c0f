"""What a node that goes by exchangeable methods is made of: a topic that says them, and what it said last."""

from palp_core.graph.messages.builtin import MethodsUsed, MethodUse
from palp_core.graph.messages.qos import Qos
from palp_core.graph.node.node import Node, State
from palp_core.graph.node.ports import Pub
from palp_core.methods import left_out


class MethodReporterState(State):
    """What a replacement inherits: the methods that were said last, so that nothing is said twice."""

    methods_told: list[MethodUse] = []


class MethodReporter(Node):
    """A node that says which methods it uses: at its start, after a swap, and as its methods change.

    The topic is latched, so that who begins to record later hears all that was said.
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
        """Say which methods are used from now on, where any are known that were not just said."""
        if uses and uses != self.state.methods_told:
            self.state.methods_told = uses
            self.methods.publish(MethodsUsed(stamp_ns=self.now_ns(), uses=uses))
