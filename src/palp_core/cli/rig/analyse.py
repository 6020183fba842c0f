"""``palp analyse``: stored sessions pooled and decided again, without the rig."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text


def analyse(
    outs: Annotated[
        list[Path],
        typer.Argument(metavar="OUT...", help="Sessions' folders, or bags of runs.", show_default=False),
    ],
    *,
    smoother: Annotated[
        str, typer.Option(help="How noise is taken off; names with commas, or all.")
    ] = "db10_soft",
    feature: Annotated[str, typer.Option(help="What is read off a sweep; as above.")] = "peak",
    filter: Annotated[str, typer.Option(help="What is known to stay; as above.")] = "naive",
    likelihood: Annotated[str, typer.Option(help="Of the naive filter; as above.")] = "normal",
    stop: Annotated[str, typer.Option(help="Stop rule; as above.")] = "paper_guarded",
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
    """Pool sessions and decide their stored sweeps again with other methods; a row per combination."""
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.perception.belief.rig_noise import read_noise
    from palp_core.palpation.session import analysis
    from palp_core.palpation.session.recorded_sweeps import read_sessions

    combos = analysis.combinations(
        smoother=smoother,
        feature=feature,
        filter=filter,
        likelihood=likelihood,
        stop=stop,
        stop_value=stop_value,
        max_probes=max_probes,
        depth_count=depths,
    )
    if out is not None:
        make_folder(out)
    record = analysis.analyse(
        read_sessions(outs),
        combos,
        noise=read_noise(noise) if noise else None,
        scene=read_scene(scene) if scene else None,
    )
    if as_json:
        print_json(record)
    else:
        print_table(analysis.rows_of(record))
        print_text("")
        print_text(f"{len(outs)} sessions; intervals: {record['interval']}")
    if out is not None:
        note(f"written: {analysis.write_analysis(record, out)}")
