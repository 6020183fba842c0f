"""A button for what must not wait: one click or the space bar, without the page's socket.

A press is a request of its own, which the browser sends straight to the server: it needs no reload, and works
while the page's socket is away or has just come back.
"""

from __future__ import annotations

from collections.abc import Callable

from nicegui.element import Element

from palp_core.view.server.presses import answer


class UrgentButton(Element, component="urgent_button.js"):  # type: ignore[misc, call-arg]
    """A button that is pressed by one click or by the space bar, wherever on the page one is but in a field.

    Args:
        name: By which the server knows it; the buttons of one name on several pages are one.
        label: What stands on it.
        press: What it does, on a thread of its own; returns what came of it, in words.
        done: How good it is that it was done: ``ok``, ``warn``.
    """

    def __init__(self, name: str, label: str, press: Callable[[], str], done: str = "ok") -> None:
        super().__init__()
        answer(name, press)
        self._props.update(name=name, label=label, done=done)

    def allow(self, refusal: str) -> None:
        """Let it be pressed if there is no refusal; else it says why not."""
        if self._props.get("refusal", "") != refusal:
            self._props["refusal"] = refusal
            self.update()

    def forget(self) -> None:
        """Say no longer what came of the last press: something else has come since."""
        self.run_method("tell", "", "")
