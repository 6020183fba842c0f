"""The server: one socket on loopback, bound before anything slow is imported; the pages behind the gate."""

from __future__ import annotations

import gc
import importlib.util
import socket
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.view.server.apart import Apart
from palp_core.view.server.gate import PageGate
from palp_core.view.server.presses import Presses
from palp_core.view.server.stderr import nonblocking_stderr
from palp_core.view.server.unwatched import end_unwatched

if TYPE_CHECKING:
    import uvicorn

HOST = "127.0.0.1"
LONGEST_WORD = 1 << 20
"""Bytes of what a browser may say at once."""
TURN_S = 1e-3
"""So long one thread computes while another wants to: a press has its turn after no more than this."""
INSTALL = f"palp view needs NiceGUI, which is not installed; type: {install_line('view')}"


def check_installed() -> None:
    """Check that the extra ``view`` is there.

    Raises:
        PalpError: It is not; what to type is in the message.
    """
    if importlib.util.find_spec("nicegui") is None:
        raise PalpError(INSTALL)


def listening_socket(port: int) -> socket.socket:
    """Return a socket that listens on loopback: a browser that comes before the pages are up waits.

    Args:
        port: 0: any that is free.

    Raises:
        PalpError: It is taken.
    """
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if port:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((HOST, port))
        found.listen(128)
    except OSError as error:
        found.close()
        text = f"--port {port}: {error.strerror}; another program may have it: give another, or none"
        raise PalpError(text) from error
    return found


def address(listening: socket.socket, token: str) -> str:
    return f"http://{HOST}:{listening.getsockname()[1]}/?token={token}"


def serve(
    listening: socket.socket,
    token: str,
    put_up: Callable[[], None],
    *,
    gives_way: bool = False,
    over: Callable[[], bool] | None = None,
) -> None:
    """Serve pages until SIGINT or SIGTERM.

    Args:
        listening: Where.
        token: By which one gets in.
        put_up: Declares the pages.
        gives_way: As of :class:`.Apart`.
        over: Tells whether what is shown has ended: a minute after that without a browser this returns.
    """
    sys.setswitchinterval(TURN_S)
    with nonblocking_stderr():
        running = server(token, put_up, gives_way=gives_way)
        gc.freeze()  # what is imported by now stays: it need not be looked through again and again
        if over is not None:
            gate = running.config.app
            assert isinstance(gate, PageGate)
            end_unwatched(running, over, lambda: gate.connected_count)
        running.run(sockets=[listening])


def server(token: str, put_up: Callable[[], None], *, gives_way: bool) -> uvicorn.Server:
    """Return a server of pages that is not running yet; see :func:`serve`."""
    import uvicorn
    from fastapi import FastAPI
    from nicegui import core, ui

    core.sio.eio.transports = ["websocket"]  # every page has a socket, by which the gate counts it
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    put_up()
    ui.run_with(
        app, mount_path=f"/{token}", title="palp view", dark=None, tailwind=False, show_welcome_message=False,
        gzip_middleware_factory=None, message_history_length=100, reconnect_timeout=10.0,
    )  # fmt: skip
    gate: Any = PageGate(Presses(Apart(app, gives_way=gives_way)), token)
    config = uvicorn.Config(
        gate, log_level="warning", access_log=False, ws_max_size=LONGEST_WORD, ws_max_queue=8,
        timeout_graceful_shutdown=1, server_header=False, proxy_headers=False, ws_per_message_deflate=False,
    )  # fmt: skip
    return uvicorn.Server(config)
