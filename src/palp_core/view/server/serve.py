"""The server: one socket on loopback, bound before anything slow is imported; the pages behind the gate."""

from __future__ import annotations

import gc
import importlib.util
import socket
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from palp_core.errors import PalpError
from palp_core.extras import install_line
from palp_core.graph.clock import monotonic_ns
from palp_core.view.server.asgi import PageThread, Presses
from palp_core.view.server.gate import PageGate
from palp_core.view.server.stderr import nonblocking_stderr

if TYPE_CHECKING:
    import uvicorn

HOST = "127.0.0.1"
LONGEST_WORD = 1 << 20
"""Bytes of one message of a browser."""
TURN_S = 1e-3
"""So long one thread computes while another wants to: a press has its turn after no more than this."""
IDLE_S = 60.0
"""So long a browser may be away: a page that is loaded again, or whose host slept, still finds the viewer."""
LOOK_S = 1.0
INSTALL = f"palp view needs NiceGUI, which is not installed; type: {install_line('view')}"


def check_installed() -> None:
    if importlib.util.find_spec("nicegui") is None:
        raise PalpError(INSTALL)


def listening_socket(port: int) -> socket.socket:
    """Return a socket that listens on loopback: a browser that comes before the pages are up waits."""
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
    register: Callable[[], None],
    *,
    low_priority: bool = False,
    over: Callable[[], bool] | None = None,
) -> None:
    """Serve the pages that ``register`` declares until SIGINT or SIGTERM.

    ``over`` is whether what is shown has ended: a minute after that without a browser this returns.
    """
    sys.setswitchinterval(TURN_S)
    with nonblocking_stderr():
        running = server(token, register, low_priority=low_priority)
        gc.freeze()  # what is imported by now stays: it need not be looked through again and again
        if over is not None:
            gate = running.config.app
            assert isinstance(gate, PageGate)
            _end_unused(running, over, gate)
        running.run(sockets=[listening])


def server(token: str, register: Callable[[], None], *, low_priority: bool) -> uvicorn.Server:
    """Return a server of pages that is not running yet; see :func:`serve`."""
    import uvicorn
    from fastapi import FastAPI
    from nicegui import core, ui

    core.sio.eio.transports = ["websocket"]  # every page has a socket, by which the gate counts it
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    register()
    ui.run_with(
        app, mount_path=f"/{token}", title="palp view", dark=None, tailwind=False, show_welcome_message=False,
        gzip_middleware_factory=None, message_history_length=100, reconnect_timeout=10.0,
    )  # fmt: skip
    gate: Any = PageGate(Presses(PageThread(app, low_priority=low_priority)), token)
    config = uvicorn.Config(
        gate, log_level="warning", access_log=False, ws_max_size=LONGEST_WORD, ws_max_queue=8,
        timeout_graceful_shutdown=1, server_header=False, proxy_headers=False, ws_per_message_deflate=False,
    )  # fmt: skip
    return uvicorn.Server(config)


class IdleTimer:
    """For how long a viewer has not been in use."""

    def __init__(self, patience_s: float) -> None:
        self._patience_ns = round(patience_s * 1e9)
        self._since_ns: int | None = None

    def expired(self, now_ns: int, *, in_use: bool) -> bool:
        """Tell whether it has been out of use for as long as the patience lasts."""
        if in_use:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= self._patience_ns


def _end_unused(running: uvicorn.Server, over: Callable[[], bool], gate: PageGate) -> None:
    """End a server, from a thread, once what it shows has ended and no browser was connected for a while."""
    timer, pause = IdleTimer(IDLE_S), threading.Event()

    def look() -> None:
        while not running.should_exit:
            in_use = gate.connected_count > 0 or not over()
            running.should_exit = timer.expired(monotonic_ns(), in_use=in_use)
            pause.wait(LOOK_S)

    threading.Thread(target=look, name="palp view: unused", daemon=True).start()
