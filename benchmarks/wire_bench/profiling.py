"""What palp's time is made of: the profile of publisher and reader, per message."""

from __future__ import annotations

import pstats
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table
from wire_bench.contenders import run_palp
from wire_bench.plan import Phase

__all__ = ["profile"]

PLACES = (
    ("waiting", ("select.", "poll", "sleep")),
    ("bench", ("wire_bench", "plan.py", "nodes/")),
    ("order record", ("node/journal.py",)),
    ("executor", ("node/executor.py", "node/bindings.py", "node/timers.py", "node/qos_events.py")),
    ("publisher", ("node/publisher.py",)),
    (
        "accounts",
        (
            "node/subscription.py",
            "node/sequence_account.py",
            "graph/latency.py",
            "transport/receiver.py",
            "transport/reorder_buffer.py",
            "transport/acks.py",
        ),
    ),
    ("sockets and zmq", ("zmq", "enum.py", "graph/transport/")),  # an enum at each socket option
    ("messages", ("graph/messages/", "msgspec", "numpy", "struct")),
    ("main loop", ("process/wall_loop.py", "process/channel.py", "socket")),
)
SHOWN = 14


def _place(where: str) -> str:
    return next((name for name, words in PLACES if any(word in where for word in words)), "other")


def profile(console: Console, count: int = 3000) -> None:
    """Run the 1 kHz stream under a profile and print own time per message, by place and by function."""
    with tempfile.TemporaryDirectory(prefix="wires-", ignore_cleanup_errors=True) as name:
        run_palp([Phase("stream", 48, 1000.0, count / 1000.0)], profile=Path(name))
        for end in ("pitcher", "catcher0"):
            found = pstats.Stats(str(Path(name) / f"{end}.prof")).stats  # type: ignore[attr-defined]
            places: dict[str, float] = {}
            rows = []
            for (file, line, function), (_, calls, own_s, all_s, _) in found.items():
                place = _place(f"{file}/{function}")
                places[place] = places.get(place, 0.0) + own_s
                label = f"{Path(file).name}:{line} {function}" if line else function
                if place not in ("waiting", "bench"):
                    rows.append((own_s, all_s, calls, label))
            table = Table("place", "own us a message", title=f"{end}, {count} messages at 1 kHz, profiled")
            for place, own_s in sorted(places.items(), key=lambda item: -item[1]):
                table.add_row(place, f"{own_s / count * 1e6:.2f}")
            console.print(table)
            table = Table("function", "calls a message", "own us", "with callees us")
            for own_s, all_s, calls, label in sorted(rows, reverse=True)[:SHOWN]:
                figures = (f"{calls / count:.2f}", f"{own_s / count * 1e6:.2f}", f"{all_s / count * 1e6:.2f}")
                table.add_row(label, *figures)
            console.print(table)
