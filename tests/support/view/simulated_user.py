"""NiceGUI's own simulated user: a page without a browser. Import it where NiceGUI is known to be there."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from nicegui.testing.user_simulation import user_simulation


def simulated(put: Callable[[], None], look: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
    """Let a simulated user open a page and look at it."""

    async def run() -> None:
        async with user_simulation(root=put) as user:
            await user.open("/")
            await look(user)

    asyncio.run(run())
