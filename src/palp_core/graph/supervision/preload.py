"""What the fork server imports for all nodes: the light things at once, a heavy one when a node wants it.

The describing child says which heavy module it is about to import, and the same is imported beside it where
its nodes are to run: in the server that forks them, or in the launcher that they are composed in. So a graph
that needs none of them waits for none, and one that does waits once. The server imports no zmq (a child may
use an inherited socket without error) and nothing of the workspace (a swap could not load it anew).
"""

import contextlib
import importlib
import os
import sys
from collections.abc import Callable, Sequence

LIGHT = ("numpy", "numpy.random", "msgspec", "msgpack", "palp_core.graph.node.executor")
HEAVY = frozenset(
    {
        "scipy.fft", "scipy.integrate", "scipy.interpolate", "scipy.linalg", "scipy.ndimage",
        "scipy.optimize", "scipy.signal", "scipy.sparse", "scipy.spatial", "scipy.special", "scipy.stats",
        "pywt", "yaml",
    }
)  # fmt: skip
MOST_MODULES = 10_000
"""Who looks for more is at it for ever."""

_CHUNK = 4096


class ImportAnnouncer:
    """A finder that finds nothing, but writes down each heavy module that is about to be imported.

    Args:
        descriptor: Pipe to the fork server.
        begin: Called when a module is looked for that was not looked for before: importing goes on.
    """

    def __init__(self, descriptor: int, begin: Callable[[], None] = lambda: None) -> None:
        self._descriptor, self._begin = descriptor, begin
        self._seen: set[str] = set()

    def find_spec(self, name: str, _path: Sequence[str] | None = None, _target: object = None) -> None:
        """Announce a module and leave the search to others."""
        if name not in self._seen and len(self._seen) < MOST_MODULES:
            self._seen.add(name)
            with contextlib.suppress(OSError):
                self._begin()
        if name in HEAVY:
            with contextlib.suppress(OSError):
                os.write(self._descriptor, f"{name}\n".encode())

    def install(self) -> None:
        """Hear of every import from now on."""
        sys.meta_path.insert(0, self)


def preload() -> None:
    """Import what every node needs."""
    for name in LIGHT:
        importlib.import_module(name)


def read_announced(descriptor: int) -> list[str]:
    """Return the heavy modules that children have announced, without waiting for more."""
    try:
        return os.read(descriptor, _CHUNK).decode().split()
    except BlockingIOError:
        return []


def import_heavy(names: Sequence[str]) -> None:
    """Import what was announced, of what is heavy."""
    for name in names:
        if name in HEAVY:
            with contextlib.suppress(ImportError):  # the child has met it too, and says so
                importlib.import_module(name)
