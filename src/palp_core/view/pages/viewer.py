"""What every page of one ``palp view`` shares."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec

from palp_core.errors import in_words
from palp_core.graph.discovery.troubles import Trouble
from palp_core.view.source.live import LiveSource
from palp_core.view.source.operator import GraphOperator
from palp_core.view.source.protocol import ViewSource

if TYPE_CHECKING:
    from palp_core.view.source.recorded import RecordedSource
    from palp_core.view.source.timeline import TimelineEvent


class OwnPage:
    """A launch file's own page, as its key ``view: module:function`` names it.

    Args:
        function: Is called with the viewer each time the page is opened, and fills it. It may have these
            attributes: ``strip``, a function for the strip on top of every page; ``title``; ``over_bags``:
            whether it is shown over a recording, too; ``heading``, called with the troubles: returns the
            word that heads every page and the other troubles, or None. If one fails, the page reports it.
    """

    def __init__(self, function: Callable[[Viewer], None]) -> None:
        self._function = function

    @property
    def title(self) -> str:
        return str(getattr(self._function, "title", "Own page"))

    @property
    def over_bags(self) -> bool:
        return getattr(self._function, "over_bags", False) is True

    def fill(self, viewer: Viewer) -> None:
        _try(self._function, viewer)

    def heading(self, troubles: list[Trouble]) -> tuple[str, list[Trouble]] | None:
        """Return the word that heads every page, and the other troubles; None if it has none."""
        find: Callable[[list[Trouble]], tuple[str, list[Trouble]] | None] | None
        find = getattr(self._function, "heading", None)
        if find is None:
            return None
        try:
            found: tuple[str, list[Trouble]] | None = find(troubles)
        except Exception:  # noqa: BLE001 - user code may raise anything: then all troubles are shown
            return None
        return found

    def fill_strip(self, viewer: Viewer) -> None:
        strip: Callable[[Viewer], None] | None = getattr(self._function, "strip", None)
        if strip is not None:
            _try(strip, viewer)


def _try(function: Callable[[Viewer], None], viewer: Viewer) -> None:
    from palp_core.view.pages.parts import text_element

    try:
        function(viewer)
    except Exception as error:  # noqa: BLE001 - user code may raise anything
        text_element("div", f"the launch file's own page failed: {in_words(error)}", "error")


class Viewer(msgspec.Struct, kw_only=True):
    """One ``palp view``; over a bag nothing can be pressed, so there is no operator but a time to choose."""

    source: ViewSource
    operator: GraphOperator | None = None
    own_page: OwnPage | None = None
    time: RecordedSource | None = None

    @property
    def live(self) -> LiveSource | None:
        """The running graph; None where what is shown is over."""
        return self.source if isinstance(self.source, LiveSource) else None

    @property
    def timeline_events(self) -> Callable[[], list[TimelineEvent]] | None:
        """The function that reads the events; None if there is none."""
        from palp_core.view.source.timeline import recorded, timeline_events

        if (live := self.live) is not None:
            return lambda: timeline_events(live)
        if (bag := self.time) is not None:
            return lambda: recorded(bag)
        return None

    def refusal(self, *, stops: bool = False) -> str:
        """Return why nothing may be pressed; "" if it may."""
        if self.operator is None:
            return "what is shown is over"
        return self.operator.refusal(stops=stops)
