"""Who does the swaps of a graph: between processes, or within the one process of a composed graph."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from palp_core.graph.lockstep.conductor import Crew
from palp_core.graph.swap.swap import SwapCrew

if TYPE_CHECKING:
    from palp_core.graph.lockstep.composition import Composition


def swap_crew(
    crew: Crew | Composition, folder: Path, workspace: Path, elapse: Callable[[int], None]
) -> SwapCrew:
    """Return who swaps the nodes of a crew.

    Args:
        crew: The nodes.
        folder: The run directory.
        workspace: Folder that holds ``nodes/``.
        elapse: Lets so much simulated time go by.
    """
    from palp_core.graph.supervision.supervisor import Supervisor

    if isinstance(crew, Supervisor):
        from palp_core.graph.swap.process_swap import ProcessSwaps

        return ProcessSwaps(crew, folder, workspace, elapse)
    from palp_core.graph.lockstep.composition import Composition
    from palp_core.graph.swap.composed_swap import ComposedSwaps

    assert isinstance(crew, Composition)
    return ComposedSwaps(crew, workspace, elapse)
