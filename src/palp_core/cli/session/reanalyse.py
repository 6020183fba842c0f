"""``palp session reanalyse``: stored sweeps decided again with other methods."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text
from palp_core.counted import counted


def reanalyse(
    outs: Annotated[
        list[Path],
        typer.Argument(
            metavar="OUT...",
            help="Sessions' folders, folders of sessions, or bags.",
            show_default=False,
        ),
    ],
    *,
    denoise: Annotated[
        str, typer.Option(help="How noise is taken off; names with commas, or all.")
    ] = "soft_universal",
    feature: Annotated[str, typer.Option(help="What is read off a sweep; as above.")] = "peak",
    filter: Annotated[str, typer.Option(help="What is known to stay; as above.")] = "naive",
    likelihood: Annotated[str, typer.Option(help="Of the naive filter; as above.")] = "normal",
    trace_filter: Annotated[
        str,
        typer.Option(help="Read whole traces by this filter (second_order), in place of the four above."),
    ] = "",
    stop: Annotated[
        str | None,
        typer.Option(
            help="Stop rule; as above. Default: paper_guarded; of traces posterior_threshold with 0.99."
        ),
    ] = None,
    stop_value: Annotated[
        float, typer.Option(help="The stop rule's own number: T, probability or count; 0: its default.")
    ] = 0.0,
    depths: Annotated[
        int, typer.Option(min=0, help="Decide on a grid of so many depths; 0: among the trained ones.")
    ] = 0,
    max_probes: Annotated[int, typer.Option(min=1, help="Probes after which a trial is undecided.")] = 15,
    noise: Annotated[Path | None, typer.Option(help="Noise file: what stays; for latent filters.")] = None,
    scene: Annotated[
        Path | None, typer.Option(help="Scene file; for the latent filter. Default: the assumed scene.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for page (HTML), table (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """A row per combination of methods."""
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.perception.belief.rig_noise import read_noise
    from palp_core.palpation.session import analysis
    from palp_core.palpation.session.many.pooled import sessions_below
    from palp_core.palpation.session.recorded_sweeps import read_sessions

    if out is not None:
        make_folder(out)
    if trace_filter and stop is None:
        stop, stop_value = "posterior_threshold", stop_value or 0.99
    paths: list[Path] = []
    for one in outs:
        below, left_out = sessions_below(one)
        paths += below
        for said in left_out:
            note(f"left out: {said['path']}: {said['why']}")
    combinations = analysis.combinations(
        denoise=denoise,
        feature=feature,
        filter=filter,
        likelihood=likelihood,
        stop=stop or "paper_guarded",
        stop_value=stop_value,
        max_probes=max_probes,
        depth_count=depths,
        trace_filter=trace_filter,
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
