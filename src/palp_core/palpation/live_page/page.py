"""Pages that a launch file names: ``view: palp_core.palpation.live_page.page:rig``, or ``:human``.

NiceGUI is imported when the page is opened: the graph is launched where it is not installed, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from palp_core.palpation.live_page.safety import heading

if TYPE_CHECKING:
    from palp_core.view.pages.viewer import Viewer


def rig(viewer: Viewer) -> None:
    """Fill the page: sweep, drawing, belief, trials, muscles, guards."""
    from palp_core.palpation.live_page.drawing.page import fill_rig

    fill_rig(viewer)


def strip(viewer: Viewer) -> None:
    """Fill the strip on top of every page: the state of safety, and stop."""
    from palp_core.palpation.live_page.drawing.strip import fill

    fill(viewer)


def human(viewer: Viewer) -> None:
    """Fill the page of an experiment with people: what is asked of the operator, trials, muscles."""
    from palp_core.palpation.live_page.drawing.page import fill_human

    fill_human(viewer)


rig.strip = strip  # type: ignore[attr-defined]
rig.heading = heading  # type: ignore[attr-defined]
rig.title = "Rig"  # type: ignore[attr-defined]
rig.over_bags = True  # type: ignore[attr-defined]
human.heading = heading  # type: ignore[attr-defined]
human.title = "Operator"  # type: ignore[attr-defined]
human.over_bags = True  # type: ignore[attr-defined]
