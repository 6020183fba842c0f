"""``palp analyse``: stored sessions decided again, or the trials of anybody's table judged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text
from palp_core.counted import counted
from palp_core.errors import PalpError

if TYPE_CHECKING:
    from palp_core.palpation.readings.analysis import Plan

_OF_SESSIONS = ("smoother", "feature", "filter", "trace_filter", "depths", "noise", "scene")
_OF_TABLES = ("class", "reading", "setting", "trial", "policy", "deal", "covariance", "folds", "seed")


def analyse(
    context: typer.Context,
    outs: Annotated[
        list[Path],
        typer.Argument(
            metavar="OUT...",
            help="Sessions' folders, folders of sessions, or bags; or one table.",
            show_default=False,
        ),
    ],
    *,
    smoother: Annotated[
        str, typer.Option(help="How noise is taken off; names with commas, or all.")
    ] = "db10_soft",
    feature: Annotated[str, typer.Option(help="What is read off a sweep; as above.")] = "peak",
    filter: Annotated[str, typer.Option(help="What is known to stay; as above.")] = "naive",
    likelihood: Annotated[
        str | None,
        typer.Option(
            help="Of the naive filter or a table; as above. Default: normal; of a table auto: student_t "
            "where a cell has few readings."
        ),
    ] = None,
    trace_filter: Annotated[
        str,
        typer.Option(
            help="Read whole traces by this filter (linear, second_order, grid), in place of the four above."
        ),
    ] = "",
    stop: Annotated[
        str | None,
        typer.Option(
            help="Stop rule; as above. Default: paper_guarded; of a table posterior_threshold, and of traces "
            "that with 0.99."
        ),
    ] = None,
    stop_value: Annotated[
        float, typer.Option(help="The stop rule's own number: T, probability or count; 0: its default.")
    ] = 0.0,
    depths: Annotated[
        int, typer.Option(min=0, help="Decide on a grid of so many depths; 0: among the trained ones.")
    ] = 0,
    max_probes: Annotated[
        int, typer.Option(min=1, help="Probes (readings) after which a trial is undecided.")
    ] = 15,
    noise: Annotated[Path | None, typer.Option(help="Noise file: what stays; for latent filters.")] = None,
    scene: Annotated[
        Path | None, typer.Option(help="Scene file; for the latent filter. Default: the assumed scene.")
    ] = None,
    class_column: Annotated[
        str, typer.Option("--class", metavar="C", help="Of a table: the column that says what was felt.")
    ] = "",
    reading: Annotated[
        str, typer.Option(metavar="R,...", help="Of a table: the columns of a reading's numbers.")
    ] = "",
    setting: Annotated[
        str, typer.Option(metavar="S,...", help="Of a table: how it was felt. Default: always alike.")
    ] = "",
    trial: Annotated[
        str, typer.Option(metavar="T,...", help="Of a table: in which trial. Default: every row is one.")
    ] = "",
    policy: Annotated[
        str,
        typer.Option(
            help="Of a table, which setting next: recorded, fixed, uniform, information_gain; or all."
        ),
    ] = "recorded",
    deal: Annotated[
        int,
        typer.Option(
            min=0,
            help="Of a table without trials: deal its readings into some, so many a setting; 0: do not.",
        ),
    ] = 0,
    covariance: Annotated[
        Literal["auto", "full", "diagonal"],
        typer.Option(help="Of a table's readings: full, diagonal, or auto by how many there are."),
    ] = "auto",
    folds: Annotated[
        int, typer.Option(min=0, help="Of a table: parts in which trials are left out; 0: one by one.")
    ] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of a table: of parts, of what is dealt, of uniform.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Folder for page (HTML), table (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Decide sessions' stored sweeps again with other methods, or judge the trials of any table.

    A row per combination; every trial of a table is judged by what the others taught.
    """
    from palp_core.palpation.readings.table_file import is_table

    tables = [path for path in outs if is_table(path)]
    _refuse_foreign(context, tables)
    if out is not None:
        make_folder(out)
    if trace_filter and stop is None:
        stop, stop_value = "posterior_threshold", stop_value or 0.99
    if not tables:
        methods = {
            "smoother": smoother,
            "feature": feature,
            "filter": filter,
            "likelihood": likelihood or "normal",
            "stop": stop or "paper_guarded",
            "stop_value": stop_value,
            "max_probes": max_probes,
            "depth_count": depths,
            "trace_filter": trace_filter,
        }
        _analyse_sessions(outs, methods, noise=noise, scene=scene, out=out, as_json=as_json)
        return
    if len(outs) > 1:
        raise PalpError(f"{tables[0]}: a table is analysed by itself; name one, and no sessions beside it")
    from palp_core.methods import names
    from palp_core.palpation.readings.analysis import Plan
    from palp_core.palpation.readings.judgement import POLICIES

    columns = {"class": class_column, "reading": reading, "setting": setting, "trial": trial}
    plan = Plan(
        policies=_chosen(policy, POLICIES),
        likelihoods=_chosen(likelihood or "auto", names("likelihood")),
        stops=_chosen(stop or "posterior_threshold", names("stop")),
        stop_value=stop_value,
        most=max_probes,
        covariance=covariance,
        fold_count=folds,
        seed=seed,
    )
    _analyse_table(tables[0], columns, plan, deal=deal, out=out, as_json=as_json)


def _refuse_foreign(context: typer.Context, tables: Sequence[Path]) -> None:
    """Refuse options that have no meaning for what is given, rather than ignore them."""
    names = {"class_column": "class"}
    said = [
        names.get(name, name)
        for name in context.params
        if (source := context.get_parameter_source(name)) is not None and source.name == "COMMANDLINE"
    ]
    foreign = [f"--{name}" for name in said if name in (_OF_SESSIONS if tables else _OF_TABLES)]
    if foreign and tables:
        raise PalpError(f"{', '.join(foreign)}: of sessions, and {tables[0]} is a table; leave it out")
    if foreign:
        raise PalpError(
            f"{', '.join(foreign)}: of a table (a file .csv, .tsv or .txt), and none is named; leave it out"
        )


def _analyse_sessions(
    outs: Sequence[Path],
    methods: dict[str, Any],
    *,
    noise: Path | None,
    scene: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.perception.belief.rig_noise import read_noise
    from palp_core.palpation.session import analysis
    from palp_core.palpation.session.many.pooled import sessions_below
    from palp_core.palpation.session.recorded_sweeps import read_sessions

    paths: list[Path] = []
    for one in outs:
        below, left_out = sessions_below(one)
        paths += below
        for said in left_out:
            note(f"left out: {said['path']}: {said['why']}")
    combos = analysis.combinations(**methods)
    record = analysis.analyse(
        read_sessions(paths),
        combos,
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


def _analyse_table(
    path: Path, columns: dict[str, str], plan: Plan, *, deal: int, out: Path | None, as_json: bool
) -> None:
    from palp_core.palpation.readings import page
    from palp_core.palpation.readings.analysis import analyse
    from palp_core.palpation.readings.table_file import columns_of, listed, read_table, unlisted

    if not columns["class"] or not columns["reading"]:
        raise PalpError(
            f"{path} is a table: say with --class what was felt and with --reading what was read; "
            f"its columns are: {listed(columns_of(path))}"
        )
    readings = read_table(
        path,
        class_column=columns["class"],
        readings=unlisted(columns["reading"]),
        settings=unlisted(columns["setting"]),
        trials=unlisted(columns["trial"]),
    )
    if deal:
        if columns["trial"]:
            raise PalpError("--deal: makes trials where there are none; leave it out, or --trial")
        readings = readings.dealt(deal, seed=plan.seed)
    found = analyse(readings, plan)
    if as_json:
        print_json({"source": str(path)} | found.record)
    else:
        print_table(page.rows_of(found.record))
        print_text("")
        for line in page.remarks(found.record):
            print_text(line)
    if out is not None:
        note(f"written: {page.write_analysis(found, str(path), out)}")


def _chosen(said: str, every: Sequence[str]) -> Sequence[str]:
    """Return the names that a word stands for: ``all``, or names with commas."""
    return every if said == "all" else [word.strip() for word in said.split(",") if word.strip()]
