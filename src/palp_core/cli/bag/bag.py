"""``palp bag``: recordings, made, looked at, saved, cut and converted."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from palp_core.cli.bag.play import check_topics, play
from palp_core.cli.options import ExcludeRegexOption, GraphOption, JsonOption, RegexOption, argument, option
from palp_core.cli.output import note, print_json, print_text, show
from palp_core.cli.running import find_graph
from palp_core.counted import counted
from palp_core.errors import BagError

if TYPE_CHECKING:
    from palp_core.graph.bag.info import BagInfo
    from palp_core.graph.replay.replay import NodeReplay

app = typer.Typer()
app.command("play")(play)

Compression = Literal["zstd", "lz4", "none"]
BagArgument = Annotated[Path, argument("A bag's folder or one of its files.")]
OutOption = Annotated[Path, option("The new bag.", "-o", "--output", show_default=False)]
TopicsOption = Annotated[list[str] | None, option("Only this one; repeatable.", "--topics", "-t")]
CompressionOption = Annotated[Compression, option("Of the new bag's chunks.")]
StartOption = Annotated[float | None, option("Seconds on the graph's clock.")]
EndOption = Annotated[float | None, option("Seconds on the graph's clock; not included.")]


@app.command("record")
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
    max_bag_files: Annotated[int, option("Keep only the last N files.", metavar="N", min=0)] = 0,
    snapshot: Annotated[float, option("Keep S seconds until palp bag snapshot.", metavar="S", min=0.0)] = 0.0,
    compression: CompressionOption = "zstd",
    graph: GraphOption = None,
) -> None:
    """Record topics of a running graph until Ctrl-C or its end.

    The exit status is 1 if anything is missing; what is missing is printed per topic.
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
        max_bag_files=max_bag_files,
        snapshot_s=snapshot,
        compression=compression,
    )
    complete, text = record_until_asked(running, params, note)
    print_text(text)
    if not complete:
        raise typer.Exit(1)


@app.command("snapshot")
def snapshot(graph: GraphOption = None) -> None:
    """Write the last seconds that recorders keep into bags."""
    from palp_core.graph.recording.attached_recorder import save_snapshots

    for line in save_snapshots(find_graph(graph, changes=True)):
        print_text(line)


@app.command("replay")
def replay(
    bag: BagArgument,
    *,
    nodes: Annotated[str, option("Running names, as in estimator,policy.", show_default=False)],
    launch: Annotated[
        Path | None, option("Launch file in the nodes' workspace; default: from here up.")
    ] = None,
    compare: Annotated[
        bool, option("With the recorded outputs; status 1 if they differ.", "--compare/--no-compare")
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Drive nodes from a bag in lockstep; compare outputs.

    Status 1: an output differs from the recorded one.
    """
    from palp_core.graph.description.launch_file import find_workspace
    from palp_core.graph.replay.replay import replay as drive

    workspace = find_workspace(launch or Path("launch.yaml"))
    try:
        done = drive(bag, nodes.split(","), workspace)
    except ModuleNotFoundError as error:
        raise BagError(
            f"{error}: the nodes' classes are not in {workspace}; name their workspace by --launch FILE"
        ) from error
    show(done, map(_replay_line, done), as_json=as_json)
    if compare and any(node.divergence is not None for node in done):
        raise typer.Exit(1)


def _replay_line(node: NodeReplay) -> str:
    if (first := node.divergence) is not None:
        return (
            f"{node.node}: differs first on {first.topic} {first.sequence} at {first.now_s:.6f} s, after "
            f"{first.after}: {first.what} ({node.compared} outputs were equal before; it had consumed "
            f"{', '.join(first.inputs)})"
        )
    pace = node.clock_s / node.wall_s if node.wall_s else 0.0
    beyond = f"; {node.uncovered} outputs are beyond what its order covers" if node.uncovered else ""
    return (
        f"{node.node}: {node.compared} outputs equal to the recorded ones, byte for byte, from "
        f"{node.consumed} inputs and ticks; {node.clock_s:.1f} s in {node.wall_s:.2f} s "
        f"({pace:.0f} times real time){beyond}"
    )


@app.command("convert")
def convert_bag(
    bag: Annotated[Path, argument("A bag's folder or file; with --from: a rosbag2.")],
    out: OutOption,
    *,
    to: Annotated[Literal["ros2", "json", "csv", "parquet"] | None, option("What it becomes.")] = None,
    from_: Annotated[
        Literal["ros2"] | None, option("Make a palp bag of a rosbag2 (MCAP or SQLite).", "--from")
    ] = None,
    types: Annotated[
        str | None, option("With --to ros2: a map (nodes.ros2_map: the rig's).", metavar="MAP")
    ] = None,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
) -> None:
    """Convert a bag to and from ROS 2, JSON or tables.

    What came --from ros2 goes back --to ros2 as the same bytes.
    """
    if (to is None) == (from_ is None):
        raise BagError("give either --to FORM or --from ros2")
    if types is not None and to != "ros2":
        raise BagError("--types is for --to ros2")
    from palp_core.graph.bag.forms import convert, writing

    if from_ is not None:
        from palp_core.graph.bag.reader import topic_selection
        from palp_core.graph.bag.ros2.import_bag import import_bag

        count = import_bag(bag, out, select=topic_selection((), regex, exclude_regex))
    elif regex or exclude_regex:
        raise BagError("--regex and --exclude-regex are for --from; `palp bag filter` makes the choice first")
    elif types is not None:
        from palp_core.graph.bag.ros2.export_bag import write
        from palp_core.graph.ros2.message_types import known_types
        from palp_core.graph.ros2.plan import outlets_of

        with writing(out) as folder:
            count = write(bag, folder, outlets_of(types, bag), known_types())
    else:
        assert to is not None
        count = convert(bag, out, to)
    print_text(counted(count, "message"))


@app.command("info")
def info(bag: BagArgument, *, as_json: JsonOption = False) -> None:
    """Show what a bag holds and what is missing.

    Status 1: something is missing or damaged.
    """
    from palp_core.graph.bag.info import bag_info

    found = bag_info(bag)
    show(found, [_info_text(found)], as_json=as_json)
    if not (found.complete and found.healthy):
        raise typer.Exit(1)


@app.command("recover")
def recover(
    bag: BagArgument,
    out: OutOption,
    *,
    compression: CompressionOption = "zstd",
    as_json: JsonOption = False,
) -> None:
    """Save everything intact of a damaged bag into a new one.

    Status 1: something is missing.
    """
    from palp_core.graph.bag.recover import recover as save

    report = save(bag, out, compression)
    show(report, [report.text()], as_json=as_json)
    if not report.complete:
        raise typer.Exit(1)


@app.command("filter")
def filter_(
    bag: BagArgument,
    out: OutOption,
    *,
    topics: TopicsOption = None,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
    start: StartOption = None,
    end: EndOption = None,
    compression: CompressionOption = "zstd",
) -> None:
    """Write some topics or some time of a bag into a new one."""
    from palp_core.graph.bag.edit import rewrite
    from palp_core.graph.bag.reader import topic_selection

    select = topic_selection(topics or (), regex, exclude_regex)
    check_topics(topics or (), bag)
    count = rewrite([bag], out, select=select, start_ns=_ns(start), end_ns=_ns(end), compression=compression)
    print_text(counted(count, "message"))


@app.command("merge")
def merge(
    bags: Annotated[list[Path], argument("Bags.")],
    out: OutOption,
    *,
    compression: CompressionOption = "zstd",
) -> None:
    """Merge bags into a new one, by time."""
    from palp_core.graph.bag.edit import rewrite

    print_text(counted(rewrite(bags, out, compression=compression), "message"))


@app.command("split")
def split(
    bag: BagArgument,
    out: OutOption,
    *,
    max_bag_size: Annotated[int, option("Bytes per file.", "-b", "--max-bag-size")] = 0,
    max_bag_duration: Annotated[float, option("Seconds per file.", "-d", "--max-bag-duration")] = 0.0,
    compression: CompressionOption = "zstd",
) -> None:
    """Write a bag again with files of limited size or duration."""
    from palp_core.graph.bag.edit import rewrite

    if not max_bag_size and not max_bag_duration:
        raise BagError("a split needs a largest size (-b) or a longest duration (-d)")
    most_ns = _ns(max_bag_duration) or 0
    count = rewrite([bag], out, max_bytes=max_bag_size, max_duration_ns=most_ns, compression=compression)
    print_text(f"{counted(count, 'message')} in {counted(len(list(out.glob('*.mcap'))), 'file')}")


@app.command("echo")
def echo(
    bag: BagArgument,
    topics: Annotated[list[str] | None, argument("Topics; default: all.")] = None,
    *,
    times: Annotated[int, option("This many messages; 0: all.", "--times", "-n")] = 0,
    start: StartOption = None,
    end: EndOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print a bag's messages."""
    import yaml

    from palp_core.graph.bag.reader import read
    from palp_core.graph.messages.schema_types import plain

    check_topics(topics or (), bag)
    messages = read(bag, topics or None, _ns(start), _ns(end))
    for message in itertools.islice(messages, times or None):
        names = ("topic", "epoch", "sequence", "log_ns", "publish_ns")
        entry = {name: getattr(message, name) for name in names} | {"message": plain(message.value)}
        if as_json:
            print_json(entry)
        else:
            print_text(yaml.safe_dump(entry, sort_keys=False, default_flow_style=None) + "---")


@app.command("diff")
def diff(
    a: BagArgument,
    b: BagArgument,
    *,
    topics: TopicsOption = None,
    tolerance: Annotated[float, option("Largest difference of numbers that passes.")] = 0.0,
    relative: Annotated[float, option("The same, as a part of the number.")] = 0.0,
    ignore: Annotated[list[str] | None, option("A field that does not count; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare two bags topic by topic.

    Status 1: they differ.
    """
    from palp_core.graph.bag.diff import diff_bags

    check_topics(topics or (), a, b)
    found = diff_bags(a, b, topics or None, tolerance=tolerance, relative=relative, ignore=ignore or ())
    lines = []
    for topic, result in found.items():
        within = f", {result.close_count} within the tolerance" if result.close_count else ""
        equal = f"{result.equal_count} equal{within}"
        lines.append(f"{topic}: {result.first.text() if result.first else equal}")
    show(found, lines, as_json=as_json)
    if any(result.first for result in found.values()):
        raise typer.Exit(1)


def _ns(seconds: float | None) -> int | None:
    return None if seconds is None else round(seconds * 1e9)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.1f} kB"


def _info_text(found: BagInfo) -> str:
    lines = [
        f"{found.path}: {counted(len(found.files), 'file')}, {_size(found.size_bytes)}, "
        f"{counted(found.message_count, 'message')}, {found.duration_s:.3f} s from {found.start_s:.3f} s"
    ]
    width = max((len(name) for name in found.topics), default=0)
    for name, topic in found.topics.items():
        restarts = f", {counted(topic.epochs - 1, 'restart')}" if topic.epochs > 1 else ""
        repeated = f", {topic.repeated} repeated" if topic.repeated else ""
        lost = f", {topic.lost} MISSING" if topic.lost else ""
        lines.append(
            f"  {name:<{width}}  {topic.count:>8}  {topic.rate_hz:10.2f} Hz  {topic.type}"
            f"{restarts}{repeated}{lost}"
        )
        if topic.backward_count:
            times = counted(topic.backward_count, "time")
            lines.append(f"    its clock goes back {times}, by {topic.backward_s:.6g} s at most")
        lines += [f"    missing {g.first}..{g.last} of epoch {g.epoch}" for g in topic.gaps[:5]]
        if len(topic.gaps) > 5:
            lines.append(f"    and {counted(len(topic.gaps) - 5, 'more gap')}")
    if found.backward_count:
        times = counted(found.backward_count, "time")
        lines.append(f"  log time goes back {times} over all topics, by {found.backward_s:.6g} s at most")
    lines += [f"  {name} {version}" for name, version in found.versions.items()]
    lines += [f"problem: {problem}" for problem in found.problems]
    if bare := [name for name, topic in found.topics.items() if topic.count and not topic.numbered]:
        lines.append(f"no sequence numbers, so lost messages do not show: {', '.join(bare)}")
    if not found.accounted:
        lines.append("without the recorder's account: what was lost after the last message does not show")
    lines.append("complete" if found.complete else "NOT complete")
    return "\n".join(lines)
