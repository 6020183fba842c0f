"""``palp topic plot``."""

from __future__ import annotations

import math
import shutil
import sys
from collections import deque
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli import completion
from palp_core.cli.options import GraphOption, TopicArgument, until_ctrl_c
from palp_core.cli.output import note
from palp_core.cli.running import find_graph
from palp_core.counted import counted
from palp_core.errors import GraphError
from palp_core.graph.messages.schema_reader import FieldKind, fields_of, items_of, kind_of, unit_of

if TYPE_CHECKING:
    from palp_core.graph.discovery.topic_reader import ReceivedFrame
    from palp_core.graph.messages.message_text import Path
    from palp_core.graph.messages.topic import Topic

REDRAW_NS = 100_000_000
PLAIN_SIZE = (100, 30)


class Series:
    """The latest values of one field over the graph's time.

    Args:
        label: Field and unit.
        path: Leads to a number, or to an array whose elements are spread evenly since the message before.
        length: Values to keep.
    """

    def __init__(self, label: str, path: Path, length: int) -> None:
        self.label = label
        self._path = path
        self._last_s: float | None = None
        self.points: deque[tuple[float, float]] = deque(maxlen=length)

    def add(self, message: dict[str, Any], stamp_s: float) -> None:
        """Take a message's value or values."""
        from palp_core.graph.messages.message_text import pick

        value = pick(message, self._path)
        last_s, self._last_s = self._last_s, stamp_s
        if not isinstance(value, list):
            self.points.append((stamp_s, float(value)))
        elif last_s is not None:
            step_s = (stamp_s - last_s) / max(len(value), 1)
            self.points.extend((last_s + (i + 1) * step_s, float(item)) for i, item in enumerate(value))


def plot(
    topic: TopicArgument,
    fields: Annotated[
        list[str],
        typer.Argument(
            metavar="FIELD",
            help="As in peak_n_m or posterior[0].",
            autocompletion=completion.fields,
            show_default=False,
        ),
    ],
    *,
    once: Annotated[
        int | None, typer.Option("--once", min=1, metavar="N", help="Draw this many messages and end.")
    ] = None,
    window: Annotated[
        int, typer.Option("--window", "-w", min=2, help="Values of each field to show.")
    ] = 1000,
    timeout: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="With --once: draw what has come after this silence.")
    ] = 10.0,
    graph: GraphOption = None,
) -> None:
    """Plot fields of a topic in the terminal, over the graph's time."""
    from palp_core.graph.clock import monotonic_ns
    from palp_core.graph.discovery.topic_reader import TopicReader
    from palp_core.graph.messages.message_text import decoded, parse_path

    running = find_graph(graph)
    entry = running.topic(topic)
    if once is None and not sys.stdout.isatty():
        raise GraphError("standard output is no terminal to plot in live; draw N messages with --once N")
    series = [Series(*_field(field, parse_path(field, entry.json_schema), entry), window) for field in fields]
    count, last_ns, drawn_ns = 0, monotonic_ns(), 0

    def add(heard: ReceivedFrame) -> int:
        message = decoded(heard.frame.payload, entry.json_schema)
        for one in series:
            one.add(message, heard.frame.stamp_ns / 1e9)
        return 1

    with until_ctrl_c(), TopicReader(running, [entry]) as listener:
        for heard in listener.messages():
            now_ns = monotonic_ns()
            if heard is not None and heard.is_message:
                count, last_ns = count + add(heard), now_ns
            if once is not None and (count == once or now_ns - last_ns > timeout * 1e9):
                break
            if once is None and now_ns - drawn_ns > REDRAW_NS:
                drawn_ns = now_ns
                sys.stdout.write("\033[H" + _picture(entry, series, shutil.get_terminal_size()) + "\033[J")
                sys.stdout.flush()
    if count == 0:
        raise GraphError(f"{entry.name}: no message to draw within {timeout:g} s")
    if once is not None:
        if count < once:
            note(f"{entry.name}: only {counted(count, 'message')} came")
        size = shutil.get_terminal_size(PLAIN_SIZE) if sys.stdout.isatty() else PLAIN_SIZE
        sys.stdout.write(_picture(entry, series, size) + "\n")


def _field(text: str, path: Path, entry: Topic) -> tuple[str, Path]:
    """Return a field's label and path.

    Raises:
        GraphError: It holds no numbers.
    """
    schema = entry.json_schema
    for step in path:
        schema = items_of(schema) if isinstance(step, int) else fields_of(schema)[step]
    kind = kind_of(items_of(schema) or schema)
    if kind not in (FieldKind.FLOAT, FieldKind.INT, FieldKind.BOOL):
        raise GraphError(f"{entry.name}: field '{text}' holds no numbers but {schema.get('title') or kind}")
    unit = unit_of(schema)
    return text + (f" [{unit}]" if unit else ""), path


def _picture(entry: Topic, series: list[Series], size: tuple[int, int]) -> str:
    """Return the picture as text; without colour where nobody would see it."""
    import plotext

    plotext.clear_figure()
    plotext.limit_size(False, False)
    plotext.theme("clear" if not sys.stdout.isatty() else "pro")
    plotext.plotsize(size[0], max(size[1] - 1, 8))
    plotext.title(entry.name)
    plotext.xlabel("s")
    for one in series:
        points = [point for point in one.points if math.isfinite(point[1])]
        if points:
            plotext.plot(*zip(*points, strict=True), label=one.label, marker="braille")
    text: str = plotext.build()
    return plotext.uncolorize(text) if not sys.stdout.isatty() else text
