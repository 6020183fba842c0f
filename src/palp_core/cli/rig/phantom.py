"""``palp phantom``: what a real phantom is, from sweeps over it."""

from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.options import JsonOption
from palp_core.cli.output import note, print_json, print_table, print_text
from palp_core.whole_file import write_whole

app = typer.Typer(help="Phantoms: their gel, from sweeps over it.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Phantoms: their gel, from sweeps over it."""


@app.command("fit")
def fit(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="BAG...|OUT...",
            help="Bags of runs, or sessions' folders; bare gel where the phantom has no bead.",
            show_default=False,
        ),
    ],
    *,
    scene: Annotated[
        Path | None, typer.Option(help="Scene file: where the search starts, and what is not fitted.")
    ] = None,
    noise: Annotated[
        Path | None, typer.Option(help="Noise file: how far ring and height may be off.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the fitted scene to this file.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate modulus, friction, indentation and noise with 95 % intervals; warn of what cannot be told."""
    from palp_core.errors import PalpError
    from palp_core.palpation.identification.phantom.scene import fit_sources, record_of, scene_text
    from palp_core.palpation.mechanics.scene.file import read_scene
    from palp_core.palpation.perception.belief.rig_noise import read_noise
    from palp_core.palpation.session.recorded_sweeps import read_sessions

    sessions = read_sessions(sources)
    found = fit_sources(
        sessions,
        start=read_scene(scene) if scene else None,
        noise=read_noise(noise) if noise else None,
    )
    record = record_of(found)
    if out is not None:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            write_whole(out, scene_text(found))
        except OSError as error:
            raise PalpError(f"--out {out}: cannot be written: {error.strerror}") from error
    if as_json:
        print_json(record)
    else:
        rows = [["what", "value", "95 %"]]
        for name, one in record["parameters"].items():
            rows.append([name, f"{one['value']:.5g}", f"{one['low']:.5g} to {one['high']:.5g}"])
        print_table(rows)
        print_text(
            f"{record['cells']} cells, rung {record['rung']}, chi^2 / dof {record['misfit']:.2f}; intervals "
            "include how far ring, height and contact model may be off"
        )
    for words in record["warnings"]:
        note(f"warning: {words}")
    if out is not None:
        note(f"written: {out}; palp scene explain {out}, palp launch launch/sim.yaml scene:={out}")
