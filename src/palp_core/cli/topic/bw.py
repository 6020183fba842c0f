"""``palp topic bw``."""

from typing import Annotated

import typer

from palp_core.cli.options import GraphOption, JsonOption, TopicsArgument, until_ctrl_c
from palp_core.cli.output import print_json, print_text
from palp_core.cli.running import find_graph, find_topics
from palp_core.counted import counted


def bw(
    topics: TopicsArgument,
    *,
    window: Annotated[int, typer.Option("--window", "-w", min=1, help="Messages to measure.")] = 100,
    once: Annotated[bool, typer.Option("--once", help="One report: when the window is full.")] = False,
    timeout: Annotated[float, typer.Option(metavar="S", min=0.0, help="Longest time for one report.")] = 10.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """It is the mean size on the wire, header included, times the rate by the publisher's own sequence
    numbers on this machine's clock, to each reader. A report each second, or a single one with --once or
    --json.
    """
    from palp_core.cli.topic.measure import Window, measure

    running = find_graph(graph)
    entries = find_topics(running, topics)
    windows = {entry.name: Window(window) for entry in entries}

    def report() -> None:
        for name, found in windows.items():
            sizes = found.sizes_bytes()
            if not sizes:
                continue
            mean = sum(sizes) / len(sizes)
            clock_hz, wall_hz = found.rates_hz()
            result = {
                "topic": name,
                "bytes_per_s": None if wall_hz is None else mean * wall_hz,
                "bytes_per_clock_s": None if clock_hz is None else mean * clock_hz,
                "mean_bytes": mean,
                "min_bytes": min(sizes),
                "max_bytes": max(sizes),
                "messages": found.messages,
                "lost": found.lost,
            }
            if as_json:
                print_json(result)
                continue
            head = f"{name}: " if len(entries) > 1 else ""
            rate = "no rate yet" if wall_hz is None else f"{_size(mean * wall_hz)}/s"
            print_text(f"{head}{rate} from {counted(found.messages, 'message')}")
            print_text(
                f"\tMessage size mean: {_size(mean)} min: {_size(min(sizes))} max: {_size(max(sizes))}"
            )

    with until_ctrl_c():
        measure(running, entries, windows, report, once=once or as_json, timeout_s=timeout)


def _size(count: float) -> str:
    for unit, scale in (("MB", 1e6), ("KB", 1e3)):
        if count >= scale:
            return f"{count / scale:.2f} {unit}"
    return f"{count:.0f} B"
