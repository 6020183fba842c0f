"""``palp emg fit-policy``: the strategy of stiffness levels, learnt from recordings."""

from pathlib import Path
from typing import Annotated, Any

import typer

from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text
from palp_core.cli.rig.emg import EdcOption, FdsOption, FsOption, SettingsOption, UnitOption, emg_settings
from palp_core.counted import counted


def fit_policy(
    files: Annotated[
        list[str], argument("Recordings, bags or session folders; MM=FILE states a depth.", "FILE...")
    ],
    *,
    mvc: Annotated[Path | None, option("Recording of the MVC; default: each file's own.")] = None,
    fs: FsOption = None,
    fds: FdsOption = None,
    edc: EdcOption = None,
    unit: UnitOption = None,
    settings: SettingsOption = None,
    prior: Annotated[float, option("Dirichlet pseudo-count of each transition.")] = 0.5,
    mass: Annotated[float, option("Probability inside the intervals.")] = 0.95,
    seed: Annotated[int, option("Of the draws behind the intervals.")] = 1,
    out: Annotated[Path | None, option("Folder for chain.json, chart, tables and page.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Status 1: a trial failed."""
    import numpy as np

    from palp_core.palpation.identification.emg import markov_fit
    from palp_core.palpation.identification.emg.muscles import ImportOptions

    chosen = emg_settings(settings)
    if out is not None:
        make_folder(out)
    found = markov_fit.fit(
        [markov_fit.source_of(word) for word in files],
        mvc,
        ImportOptions(fs, fds, edc, unit),
        chosen,
        np.random.default_rng(seed),
        prior_count=prior,
        mass=mass,
        tell=note,
    )
    if out is not None:
        from palp_core.palpation.identification.emg.markov_page import write_fit

        record = write_fit(found, out)
    else:
        record = markov_fit.fit_record(found)
    if as_json:
        print_json(record)
    else:
        for chain in record["chains"]:
            _print_chain(record["levels"], chain)
    if out is not None:
        note(f"written: {out / 'index.html'}; the Markov policy loads {out / 'chain.json'}")
    if any(one["error"] for one in record["trials"]):
        raise typer.Exit(1)


def _print_chain(levels: list[float], chain: dict[str, Any]) -> None:
    of = "all depths" if chain["depth_mm"] is None else f"{chain['depth_mm']:g} mm"
    print_text(f"{of}: {counted(chain['transitions'], 'transition')} in {counted(chain['trials'], 'trial')}")
    heads = [f"{level:g}" for level in levels]
    rows = [
        [f"{level:g}", *(f"{m:.2f} ({a:.2f} to {b:.2f})" for m, a, b in zip(*line, strict=True))]
        for level, line in reversed(
            list(zip(levels, zip(chain["matrix"], chain["low"], chain["high"], strict=True), strict=True))
        )
    ]
    print_table([["next \\ present", *heads], *rows])
    values = "  ".join(_eigenvalue(one) for one in chain["eigenvalues"])
    seen = chain["observed"]
    print_table(
        [
            ["eigenvalues", values],
            ["relaxation time, steps", _interval(chain["relaxation_time_steps"])],
            ["Kemeny's constant, steps", _interval(chain["kemeny_steps"])],
            ["stationary law", "  ".join(_interval(share) for share in chain["stationary"])],
            [
                "as observed",
                f"{'irreducible' if seen['irreducible'] else 'reducible'}, "
                f"{seen['closed_classes']} closed classes, period {seen['period']}",
            ],
            ["never visited, never left", f"{seen['levels_never_visited']}, {seen['levels_never_left']}"],
        ]
    )
    print_text("")


def _interval(value: dict[str, float]) -> str:
    return f"{value['value']:.3f} ({value['low']:.3f} to {value['high']:.3f})"


def _eigenvalue(one: dict[str, Any]) -> str:
    turn = f"{one['imaginary']:+.4f}i" if abs(one["imaginary"]) > 1e-9 else ""
    return f"{one['real']:.4f}{turn}"
