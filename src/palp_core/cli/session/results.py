"""``palp session list``, ``report``, ``reanalyse``, ``people`` and ``export``: what sessions came to."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text
from palp_core.counted import counted
from palp_core.errors import PalpError


def list_sessions(
    folder: Annotated[Path, argument("A folder with sessions at any depth.", "DIR")],
    *,
    unfinished: Annotated[
        bool, option("Sessions that did not come to their end count, too.", "--unfinished")
    ] = False,
    out: Annotated[Path | None, option("Folder for page (HTML), tables (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Unfinished, running, damaged and empty sessions are listed, too; whole ones are pooled, without
    excluded trials. Status 1: none counts.
    """
    from palp_core.palpation.session.many import pooled
    from palp_core.palpation.session.many.overview import find_sessions

    if out is not None:
        make_folder(out)
    entries = find_sessions(folder)
    record = pooled.pool(entries, unfinished=unfinished)
    if as_json:
        print_json(record)
    else:
        tables = [pooled.rows_of(entries, folder)]
        tables += [pooled.pooled_rows(record)] if record["groups"] else []
        tables += [pooled.difference_rows(record)] if record["differences"] else []
        for table in tables:
            print_table(table)
            print_text("")
        for text in pooled.remarks(record):
            print_text(text)
    if not record["groups"]:
        note("no session counts, so nothing is pooled")
        raise typer.Exit(1)
    if out is not None:
        note(f"written: {pooled.write_pooled(record, entries, folder, out)}")


def report(
    path: Annotated[Path, argument("A session's folder, or a bag of its run.", "DIR|BAG")],
    out: Annotated[
        Path | None,
        option("Of a bag: for record and report; default: BAG_report.", "--out", "-o", metavar="DIR"),
    ] = None,
    overwrite: Annotated[bool, option("Of a bag: replace the session in the folder.", "--overwrite")] = False,
    charts: Annotated[
        bool, option("Keep each chart as PNG, SVG and CSV, too, in charts/.", "--charts")
    ] = False,
) -> None:
    """Write result.json and report.html with all charts, from the session's rows and sweeps (human.json and
    human.html, of a session with a person). Of a bag the rows and sweeps are made first, from what the nodes
    published.
    """
    from palp_core.palpation.session.bag_record import is_bag, write_record
    from palp_core.palpation.session.human.record import is_human_session
    from palp_core.palpation.session.human.report import write_human
    from palp_core.palpation.session.report import write
    from palp_core.palpation.session.run_note import read_note
    from palp_core.palpation.session.sheet.of_run import sheet_of

    if is_bag(path):
        whole = path.resolve()
        folder = out or path.parent / f"{whole.name.removesuffix('.mcap')}_report"
        print_text(write(folder, write_record(path, folder, overwrite=overwrite), files=charts))
    elif out is not None or overwrite:
        raise PalpError(
            f"{path} is not a bag; a session's report stays in its folder: leave out --out and --overwrite"
        )
    elif is_human_session(path):
        print_text(write_human([path], path, sheet_of(read_note(path)), charts=charts))
    else:
        print_text(write(path, read_note(path), files=charts))


def reanalyse(
    outs: Annotated[list[Path], argument("Sessions' folders, folders of sessions, or bags.", "OUT...")],
    *,
    denoise: Annotated[
        str, option("How noise is taken off: a comma-separated list, or all.")
    ] = "soft_universal",
    feature: Annotated[str, option("What is read off a sweep: a comma-separated list, or all.")] = "peak",
    filter: Annotated[str, option("What is known to stay: a comma-separated list, or all.")] = "naive",
    likelihood: Annotated[str, option("Of the naive filter: a comma-separated list, or all.")] = "normal",
    trace_filter: Annotated[str, option("Filter of whole traces instead: second_order.")] = "",
    stop: Annotated[str | None, option("Stop rule; default: paper_guarded (traces: .99 posterior).")] = None,
    stop_value: Annotated[float, option("The stop rule's number; 0: its default.")] = 0.0,
    depths: Annotated[int, option("Size of the grid of depths; 0: the trained ones.", min=0)] = 0,
    max_probes: Annotated[int, option("Probes after which a trial is undecided.", min=1)] = 15,
    noise: Annotated[Path | None, option("Noise file: what stays; for latent filters.")] = None,
    scene: Annotated[
        Path | None, option("Scene file of the latent filter; default: the assumed one.")
    ] = None,
    out: Annotated[Path | None, option("Folder for page (HTML), table (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """A row per combination of methods."""
    from palp_core.palpation import read_scene, read_sessions
    from palp_core.palpation.perception.belief.rig_noise import read_noise
    from palp_core.palpation.session import analysis
    from palp_core.palpation.session.many.overview import sessions_below

    if out is not None:
        make_folder(out)
    if trace_filter and stop is None:
        stop, stop_value = "posterior_threshold", stop_value or 0.99
    paths: list[Path] = []
    for one in outs:
        below, left_out = sessions_below(one)
        paths += below
        for left in left_out:
            note(f"left out: {left['path']}: {left['why']}")
    combinations = analysis.combinations(
        denoise=denoise,
        feature=feature,
        filter=filter,
        likelihood=likelihood,
        stop=stop or "paper_guarded",
        trace_filter=trace_filter,
        more={"stop_value": stop_value, "max_probes": max_probes, "depth_count": depths},
    )
    record = analysis.analyse(
        read_sessions(paths),
        combinations,
        noise=read_noise(noise) if noise else None,
        scene=read_scene(scene) if scene else None,
    )
    if as_json:
        print_json(record)
    else:
        print_table(analysis.rows_of(record))
        print_text("")
        print_text(f"{counted(len(paths), 'session')}; intervals: {record['interval']}")
        for line in analysis.remarks_of(record):
            print_text(line)
    if out is not None:
        note(f"written: {analysis.write_analysis(record, out)}")


def people(
    folders: Annotated[list[Path], argument("Folders of sessions.", "DIR...")],
    *,
    out: Annotated[Path | None, option("Folder for human.html, human.json and charts.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Trials that were excluded or are to be done again do not count. Of simulated people, recordings and
    scripts no accuracy is ever given.
    """
    from palp_core.palpation.session.human.analysis import analyse, gather
    from palp_core.palpation.session.human.report import headline, write_human

    found = analyse(gather(folders))
    if as_json:
        print_json(found)
    else:
        print_text(headline(found))
        for mm, one in found.get("by_depth", {}).items():
            print_text(f"{mm} mm: {one['right']} of {one['of']}, {one['share']:.0%}")
    if out is not None:
        make_folder(out)
        write_human(folders, out)
        note(f"written: {out / 'human.html'}")


def export(
    path: Annotated[Path, argument("A session's folder, or a bag of its run.", "DIR|BAG")],
    to: Annotated[Literal["csv", "parquet", "mat"], option("The format.")],
    *,
    out: Annotated[
        Path | None, option("Folder; of mat the file. Default: next to DIR or BAG.", "--out", "-o")
    ] = None,
    overwrite: Annotated[bool, option("An earlier export is replaced.", "--overwrite")] = False,
) -> None:
    from palp_core.palpation.export.export import default_out, write_export
    from palp_core.palpation.export.source import read_source

    source = read_source(path)
    target = out or default_out(path, to)
    write_export(source, to, target, overwrite=overwrite)
    counts = ", ".join(f"{len(table)} {name}" for name, table in source.tables.items())
    for text in source.notes:
        note(text)
    print_text(f"{target}: {counts}")
