"""Import NiceGUI in less time: what it brings for clients of other servers is left where it is."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Iterator

FOR_CLIENTS = ("aiohttp", "requests", "tornado")
"""What engineio imports where it is installed, as a client or for another event loop: a third of the time."""


@contextlib.contextmanager
def serving_alone() -> Iterator[None]:
    """Import, meanwhile, nothing that is for clients, and look for no garbage; afterwards all is as before.

    Who imports requests later, a page of a lab's own, gets it. Clients of engineio and socketio in this
    process do not: they are told that it is not installed.
    """
    hidden = [name for name in FOR_CLIENTS if name not in sys.modules]
    collects = gc.isenabled()
    gc.disable()
    sys.modules.update(dict.fromkeys(hidden))  # type: ignore[arg-type]  # None: an import of it fails
    try:
        yield
    finally:
        if collects:
            gc.enable()
        for name in hidden:
            if sys.modules.get(name) is None:
                sys.modules.pop(name, None)
