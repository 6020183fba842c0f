"""NiceGUI's own simulated user: a page without a browser. Import it where NiceGUI is known to be there."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from nicegui.testing.user_simulation import user_simulation

from tests.support.palp import PATIENCE_S

_LOOK_S = 0.05
"""Between two looks of the simulated user, at least."""


def simulated(put: Callable[[], None], look: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
    """Let a simulated user open a page and look at it, as patiently as any test waits."""
    patient = {"retries": round(PATIENCE_S / _LOOK_S)}

    async def run() -> None:
        async with user_simulation(root=put) as user:
            user.should_see = partial(user.should_see, **patient)
            user.should_not_see = partial(user.should_not_see, **patient)
            await user.open("/")
            await look(user)

    gc.freeze()  # NiceGUI collects garbage before and after, which takes long where much is loaded
    try:
        asyncio.run(run())
    finally:
        gc.unfreeze()
