"""``palp bag record`` and ``palp bag snapshot``."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import ExcludeRegexOption, GraphOption, RegexOption, argument, option
from palp_core.cli.output import note, print_text
from palp_core.cli.running import find_graph
from palp_core.errors import BagError


class CompressionName(StrEnum):
    """Of a bag's chunks."""

    ZSTD = "zstd"
    LZ4 = "lz4"
    NONE = "none"


def record(
    topics: Annotated[list[str] | None, argument("Topics.")] = None,
    *,
    output: Annotated[
        Path | None, option("The bag; default: graph and time.", "--output", "-o", metavar="DIR")
    ] = None,
    every: Annotated[bool, option("Every topic, the hidden ones too.", "--all", "-a")] = False,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
    max_bag_size: Annotated[int, option("Bytes per file.", "--max-bag-size", "-b", min=0)] = 0,
    max_bag_duration: Annotated[
        float, option("Seconds per file.", "--max-bag-duration", "-d", min=0.0)
    ] = 0.0,
    snapshot: Annotated[
        float,
        option("Keep S seconds until palp bag snapshot or SIGUSR1.", "--snapshot", metavar="S", min=0.0),
    ] = 0.0,
    compression: Annotated[CompressionName, option("Of the chunks.")] = CompressionName.ZSTD,
    graph: GraphOption = None,
) -> None:
    """Record topics of a running graph until Ctrl-C or its end.

    The exit status is 1 if anything is missing: it is said per topic.
    """
    from palp_core.graph.clock import unix_ns
    from palp_core.graph.recording.recorder_messages import RecordOptions
    from palp_core.graph.recording.recorder_run import record_until_asked

    if not every and not topics and regex is None:
        raise BagError(
            "what to record? Name topics, give a regular expression with -e, or record all with -a"
        )
    if every and (topics or regex is not None):
        raise BagError("-a records every topic: leave out topics and -e, or leave out -a")
    running = find_graph(graph)
    options = RecordOptions(
        out=str((output or Path(f"{running.record.graph}-{unix_ns() // 10**9}")).absolute()),
        topics=[name if name.startswith("/") else f"/{name}" for name in topics or []],
        regex=regex,
        exclude_regex=exclude_regex,
        max_bytes=max_bag_size,
        max_duration_s=max_bag_duration,
        snapshot_s=snapshot,
        compression=compression.value,
    )
    complete, text = record_until_asked(running, options, note)
    print_text(text)
    if not complete:
        raise typer.Exit(1)


def snapshot(graph: GraphOption = None) -> None:
    """Write the last seconds that recorders keep into bags."""
    from palp_core.graph.recording.recorder_run import save_snapshots

    for line in save_snapshots(find_graph(graph, changes=True)):
        print_text(line)
