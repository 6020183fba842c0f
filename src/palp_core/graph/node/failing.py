"""How a node fails: it says why, reaches its safe state, and does no more."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from palp_core.errors import NodeError, in_words
from palp_core.graph.node.lifecycle import Lifecycle

if TYPE_CHECKING:
    from palp_core.graph.node.executor import Executor


class Failing:
    """Turns whatever a node's code raises into the node's failure.

    Args:
        executor: The node's.
    """

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def guard(self, port: str, handler: Callable[..., Any]) -> Callable[..., Any]:
        """Return a handler, called without its node, whose failure is the node's."""
        node = self._executor.node

        def guarded(*arguments: Any) -> Any:
            try:
                return handler(node, *arguments)
            except (Exception, SystemExit) as error:
                raise self.failed(port, handler.__name__, error) from error

        return guarded

    def hook(self, name: str) -> None:
        """Run a lifecycle hook.

        Raises:
            NodeError: It failed.
        """
        executor = self._executor
        try:
            getattr(executor.node, name)()
        except (Exception, SystemExit) as error:
            self.fail(error)
            raise NodeError(executor.name, f"{name} failed: {in_words(error)}") from error

    def failed(self, port: str, handler: str, error: BaseException) -> NodeError:
        """Fail, because a handler did; return what to raise."""
        self.fail(error)
        text = f"{handler} (handler of '{port}') failed: {in_words(error)}"
        return NodeError(self._executor.name, text)

    def fail(self, error: BaseException) -> None:
        """Finalize the node, its safe state reached."""
        executor = self._executor
        executor.log.error("failed", exc_info=error)
        reason = error if isinstance(error, Exception) else NodeError(executor.name, in_words(error))
        executor.lifecycle = Lifecycle.FINALIZED
        hooks: list[Callable[[], None]] = [
            lambda: executor.node.on_error(reason),
            executor.node.on_deactivate,
        ]
        for hook in hooks:
            try:
                hook()
            except (Exception, SystemExit):
                executor.log.exception("a hook failed while the node was failing")
        executor.order.flush(executor.now_ns())
        executor.publishing = False
