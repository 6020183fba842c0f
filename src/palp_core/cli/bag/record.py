"""``palp bag record`` and ``palp bag snapshot``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import ExcludeRegexOption, GraphOption, RegexOption
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph
from palp_core.errors import BagError


class CompressionName(StrEnum):
    """Of a bag's chunks."""

    ZSTD = "zstd"
    LZ4 = "lz4"
    NONE = "none"


def record(
    topics: Annotated[list[str] | None, typer.Argument(help="Topics.", show_default=False)] = None,
    *,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="DIR", help="The bag; default: graph and time.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", "-a", help="Every topic, the hidden ones too.")] = False,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
    max_bag_size: Annotated[int, typer.Option("--max-bag-size", "-b", min=0, help="Bytes per file.")] = 0,
    max_bag_duration: Annotated[
        float, typer.Option("--max-bag-duration", "-d", min=0.0, help="Seconds per file.")
    ] = 0.0,
    snapshot: Annotated[
        float,
        typer.Option(
            "--snapshot",
            metavar="S",
            min=0.0,
            help="Keep the last S seconds; palp bag snapshot or SIGUSR1 writes them.",
        ),
    ] = 0.0,
    compression: Annotated[CompressionName, typer.Option(help="Of the chunks.")] = CompressionName.ZSTD,
    graph: GraphOption = None,
) -> None:
    """Record topics of a running graph until Ctrl-C or its end.

    The exit status is 1 if anything is missing: it is said per topic.
    """
    from palp_core.graph.clock import unix_ns
    from palp_core.graph.recording.attached_recorder import record_until_asked
    from palp_core.graph.recording.recorder_params import RecorderParams

    if not every and not topics and regex is None:
        raise BagError(
            "what to record? Name topics, give a regular expression with -e, or record all with -a"
        )
    if every and (topics or regex is not None):
        raise BagError("-a records every topic: leave out topics and -e, or leave out -a")
    running = find_graph(graph)
    params = RecorderParams(
        out=str((output or Path(f"{running.record.graph}-{unix_ns() // 10**9}")).absolute()),
        topics=topics or [],
        regex=regex or "",
        exclude_regex=exclude_regex or "",
        max_bag_size=max_bag_size,
        max_bag_duration_s=max_bag_duration,
        snapshot_s=snapshot,
        compression=compression.value,
    )
    complete, text = record_until_asked(running, params, note)
    print_text(text)
    if not complete:
        raise typer.Exit(1)


def snapshot(graph: GraphOption = None) -> None:
    """Write the last seconds that recorders keep into bags."""
    from palp_core.graph.recording.attached_recorder import save_snapshots

    for line in save_snapshots(find_graph(graph, changes=True)):
        print_text(line)
