"""``palp topic hz``."""

from typing import Annotated, Any

import typer

from palp_core.cli.options import GraphOption, JsonOption, TopicsArgument, until_ctrl_c
from palp_core.cli.output import print_json, print_text
from palp_core.cli.running import find_graph, find_topics


def hz(
    topics: TopicsArgument,
    *,
    window: Annotated[
        int | None,
        typer.Option(
            "--window", "-w", min=1, help="Messages to measure; default: 10000, for one report 100."
        ),
    ] = None,
    wall_time: Annotated[
        bool, typer.Option("--wall-time", help="The rate on this machine's clock, not the graph's.")
    ] = False,
    once: Annotated[bool, typer.Option("--once", help="One report: when the window is full.")] = False,
    timeout: Annotated[float, typer.Option(metavar="S", min=0.0, help="Longest time for one report.")] = 10.0,
    graph: GraphOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rate and periods are of the publisher's sequence numbers and stamps, so they are exact even where this
    process is too slow to hear every message. Each reader's own account follows. A report each second, or a
    single one with --once or --json.
    """
    from palp_core.cli.topic.measure import Window, account, measure, reader_lines, readers

    running = find_graph(graph)
    entries = find_topics(running, topics)
    length = window or (100 if once or as_json else 10_000)
    windows = {entry.name: Window(length) for entry in entries}

    def report() -> None:
        accounts = readers(running, entries)
        for entry in entries:
            found = windows[entry.name]
            clock_hz, wall_hz = found.rates_hz()
            rate_hz = wall_hz if wall_time else clock_hz
            if as_json:
                print_json(
                    {
                        "topic": entry.name,
                        "clock": running.record.clock,
                        "hz": clock_hz,
                        "wall_hz": wall_hz,
                        **found.periods_s(),
                        "messages": found.messages,
                        "lost": found.lost,
                        "readers": [account(edge) for edge in accounts[entry.name]],
                    }
                )
                continue
            if found.messages < 2:
                continue
            head = f"{entry.name}: " if len(entries) > 1 else ""
            rate = f"average rate: {rate_hz:.3f}" if rate_hz else "no rate: all at one instant"
            pace = running.record.clock == "sim" and not wall_time and wall_hz
            print_text(head + rate + (f" ({wall_hz:.1f} Hz of wall time)" if pace else ""))
            low, high, deviation = found.periods_s().values()
            if low is not None:
                print_text(
                    f"\tmin: {low:.6f}s max: {high:.6f}s std dev: {deviation:.6f}s window: {found.messages}"
                )
            for line in [*reader_lines(accounts[entry.name]), *_missed(found)]:
                print_text(line)

    with until_ctrl_c():
        measure(running, entries, windows, report, once=once or as_json, timeout_s=timeout)


def _missed(window: Any) -> list[str]:
    return [f"\t{window.lost} did not reach this command; the rate counts them"] if window.lost else []
