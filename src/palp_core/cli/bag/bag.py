"""``palp bag``: recordings, looked at, saved, cut and converted."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.bag.convert import convert_bag
from palp_core.cli.bag.play import play
from palp_core.cli.bag.record import CompressionName, record, snapshot
from palp_core.cli.bag.replay import replay
from palp_core.cli.bag.topics import check_topics
from palp_core.cli.options import ExcludeRegexOption, JsonOption, RegexOption
from palp_core.cli.output import print_json, print_text, show
from palp_core.counted import counted

if TYPE_CHECKING:
    from palp_core.graph.bag.info import BagInfo

app = typer.Typer()
app.command("record")(record)
app.command("snapshot")(snapshot)
app.command("play")(play)
app.command("replay")(replay)


BagArgument = Annotated[Path, typer.Argument(help="A bag's folder or one of its files.", show_default=False)]
OutOption = Annotated[Path, typer.Option("-o", "--output", help="The new bag.", show_default=False)]
TopicsOption = Annotated[list[str] | None, typer.Option("--topics", "-t", help="Only this one; repeatable.")]
CompressionOption = Annotated[CompressionName, typer.Option(help="Of the new bag's chunks.")]


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


@app.command("list")
def list_bags(
    folder: Annotated[Path, typer.Argument(help="Where to look.")] = Path(), *, as_json: JsonOption = False
) -> None:
    """List the bags in a folder."""
    sizes = {
        str(path): [file.stat().st_size for file in files]
        for path in sorted(folder.iterdir() if folder.is_dir() else [])
        if (files := sorted(path.glob("*.mcap")) if path.is_dir() else [path] * (path.suffix == ".mcap"))
    }
    show(
        [{"name": name, "files": len(of), "size_bytes": sum(of)} for name, of in sizes.items()],
        (f"{name}  {counted(len(of), 'file')}  {_size(sum(of))}" for name, of in sizes.items()),
        as_json=as_json,
    )


@app.command("recover")
def recover(
    bag: BagArgument,
    out: OutOption,
    *,
    compression: CompressionOption = CompressionName.ZSTD,
    as_json: JsonOption = False,
) -> None:
    """Save everything intact of a damaged bag into a new one."""
    from palp_core.graph.bag.recover import recover as save

    report = save(bag, out, compression.value)
    show(report, [report.text()], as_json=as_json)


@app.command("filter")
def filter_(
    bag: BagArgument,
    out: OutOption,
    *,
    topics: TopicsOption = None,
    regex: RegexOption = None,
    exclude_regex: ExcludeRegexOption = None,
    start: Annotated[float | None, typer.Option(help="Seconds on the graph's clock.")] = None,
    end: Annotated[float | None, typer.Option(help="Seconds on the graph's clock; not included.")] = None,
    compression: CompressionOption = CompressionName.ZSTD,
) -> None:
    """Write some topics or some time of a bag into a new one."""
    from palp_core.graph.bag.edit import filter_bag
    from palp_core.graph.bag.reader import topic_selection

    select = topic_selection(topics or (), regex, exclude_regex)
    check_topics(topics or (), bag)
    count = filter_bag(
        bag, out, select=select, start_ns=_ns(start), end_ns=_ns(end), compression=compression.value
    )
    print_text(counted(count, "message"))


@app.command("merge")
def merge(
    bags: Annotated[list[Path], typer.Argument(help="Bags.", show_default=False)],
    out: OutOption,
    *,
    compression: CompressionOption = CompressionName.ZSTD,
) -> None:
    """Merge bags into a new one, by time."""
    from palp_core.graph.bag.edit import merge_bags

    print_text(counted(merge_bags(bags, out, compression.value), "message"))


@app.command("split")
def split(
    bag: BagArgument,
    out: OutOption,
    *,
    max_bag_size: Annotated[int, typer.Option("-b", "--max-bag-size", help="Bytes per file.")] = 0,
    max_bag_duration: Annotated[
        float, typer.Option("-d", "--max-bag-duration", help="Seconds per file.")
    ] = 0.0,
    compression: CompressionOption = CompressionName.ZSTD,
) -> None:
    """Write a bag again with files of limited size or duration."""
    from palp_core.graph.bag.edit import split_bag

    count = split_bag(
        bag,
        out,
        max_bytes=max_bag_size,
        max_duration_ns=_ns(max_bag_duration) or 0,
        compression=compression.value,
    )
    print_text(f"{counted(count, 'message')} in {counted(len(list(out.glob('*.mcap'))), 'file')}")


app.command("convert")(convert_bag)


@app.command("echo")
def echo(
    bag: BagArgument,
    topics: Annotated[list[str] | None, typer.Argument(help="Topics; default: all.")] = None,
    *,
    times: Annotated[int, typer.Option("--times", "-n", help="This many messages; 0: all.")] = 0,
    start: Annotated[float | None, typer.Option(help="Seconds on the graph's clock.")] = None,
    end: Annotated[float | None, typer.Option(help="Seconds on the graph's clock; not included.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Print a bag's messages."""
    import yaml

    from palp_core.graph.bag.reader import read
    from palp_core.graph.messages.schema_types import plain

    check_topics(topics or (), bag)
    messages = read(bag, topics or None, _ns(start), _ns(end))
    for message in itertools.islice(messages, times or None):
        entry = {
            "topic": message.topic,
            "epoch": message.epoch,
            "sequence": message.sequence,
            "log_ns": message.log_ns,
            "publish_ns": message.publish_ns,
            "message": plain(message.value),
        }
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
    tolerance: Annotated[float, typer.Option(help="Largest difference of numbers that passes.")] = 0.0,
    relative: Annotated[float, typer.Option(help="The same, as a part of the number.")] = 0.0,
    ignore: Annotated[list[str] | None, typer.Option(help="A field that does not count; repeatable.")] = None,
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
    lines += [f"  {name} {version}" for name, version in found.versions.items()]
    lines += [f"problem: {problem}" for problem in found.problems]
    if bare := [name for name, topic in found.topics.items() if topic.count and not topic.numbered]:
        lines.append(f"no sequence numbers, so lost messages do not show: {', '.join(bare)}")
    if not found.accounted:
        lines.append("without the recorder's account: what was lost after the last message does not show")
    lines.append("complete" if found.complete else "NOT complete")
    return "\n".join(lines)
