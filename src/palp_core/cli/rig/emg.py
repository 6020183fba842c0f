"""``palp emg``: recorded EMG to co-contraction, bursts, levels and a policy, with what is wrong with it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text
from palp_core.counted import counted
from palp_core.errors import PalpError, in_words

if TYPE_CHECKING:
    from palp_core.palpation.perception.emg.analysis import EmgSettings

_HERE = "palp_core.cli.rig.emg"

app = lazy_app(
    {
        "analyse": Verb(f"{_HERE}:analyse", "Analyse a recording, or a folder of them."),
        "import": Verb(f"{_HERE}:import_file", "Show a recording's columns, rate and unit."),
        "fit-policy": Verb(f"{_HERE}:fit_policy", "Fit the human policy to recorded EMG."),
    }
)

FsOption = Annotated[
    float | None,
    option("Sampling rate; default: by the time column or the format.", metavar="HZ", min=1.0),
]
FdsOption = Annotated[str | None, option("Flexor's column: index from 0, or name.", metavar="COL")]
EdcOption = Annotated[
    str | None, option("Extensor's column: index or name; none: one muscle only.", metavar="COL")
]
UnitOption = Annotated[
    str | None, option("V, mV, uV, nV or counts; default: each file's own.", metavar="UNIT")
]
SettingsOption = Annotated[
    list[str] | None,
    option("Analysis setting; see docs/explanation/emg.md; repeatable.", "--set", metavar="NAME:=VALUE"),
]
SHOWN = (
    *("file", "mvc", "fds", "edc", "rate_hz", "unit", "duration_s", "cocontraction_mean", "burst_count"),
    *("peak_count", "lambda_2", "mvc_ratio", "clipped", "lost", "above_mvc", "clamped", "flags", "notes"),
)
_SHOWN_APART = ("file", "format", "columns", "notes", "problem")


def emg_settings(words: list[str] | None) -> EmgSettings:
    """Return the settings of the analysis, of its burst rule too, given as ``name:=value``."""
    import msgspec

    from palp_core.cli.values import assignments
    from palp_core.graph.discovery.message_yaml import parse_yaml
    from palp_core.graph.problems import hint
    from palp_core.palpation.perception.emg.analysis import EmgSettings
    from palp_core.palpation.perception.emg.settings import BurstSettings

    given = {name: parse_yaml(text, name) for name, text in assignments("--set", words).items()}
    bursts = [field.name for field in fields(BurstSettings)]
    known = [f.name for f in fields(EmgSettings) if f.name not in ("rate_hz", "bursts")] + bursts
    for name in given:
        if name not in known:
            names = ", ".join(known)
            raise PalpError(f"--set {name}: no such setting{hint(name, known)}; there are {names}")
    own = {name: value for name, value in given.items() if name not in bursts}
    own["bursts"] = {name: value for name, value in given.items() if name in bursts}
    try:
        return msgspec.convert(own, EmgSettings)
    except msgspec.ValidationError as error:
        raise PalpError(f"--set: {in_words(error)}") from error


def analyse(
    file: Annotated[Path, argument("A recording, or a folder subject/phase/trial.", "FILE")],
    *,
    fs: FsOption = None,
    fds: FdsOption = None,
    edc: EdcOption = None,
    unit: UnitOption = None,
    mvc: Annotated[Path | None, option("Recording of the MVC; a bag or a folder may hold its own.")] = None,
    rest: Annotated[Path | None, option("Recording at rest; default: the quietest twentieth.")] = None,
    settings: SettingsOption = None,
    out: Annotated[Path | None, option("Folder for page (HTML), tables (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Status 1: a trial of the folder failed."""
    from palp_core.palpation.identification.emg import batch as emg_batch
    from palp_core.palpation.identification.emg.files import is_recording
    from palp_core.palpation.identification.emg.muscles import ImportOptions
    from palp_core.palpation.identification.emg.trial import run_trial, trial_record
    from palp_core.palpation.session.human.record import EMG, is_human_session

    chosen = emg_settings(settings)
    options = ImportOptions(fs, fds, edc, unit)
    if out is not None:
        make_folder(out)
    failed = False
    if file.is_dir() and not is_recording(file):
        folder = file / EMG if is_human_session(file) else file
        records = emg_batch.run_folder(folder, mvc, options, chosen, note)
        record: Any = emg_batch.write_batch(records, out) if out else {"trials": records}
        names = ("subject", "phase", "trial", "burst_count", "peak_count", "flags")
        table: Any = [names, *([_text(one.get(name)) for name in names] for one in records)]
        failed = any(one["error"] for one in records)
    else:
        trial = run_trial(file, mvc, options, chosen, rest)
        record = emg_batch.write_trial(trial, out) if out else trial_record(trial)
        table = [(name, _text(record[name])) for name in SHOWN]
    if as_json:
        print_json(record)
    else:
        print_table(table)
    if out is not None:
        note(f"written: {out / 'quality.html'}")
    if failed:
        raise typer.Exit(1)


def import_file(
    file: Annotated[Path, argument("A recording.", "FILE")],
    *,
    dry_run: Annotated[bool, option("Only show what would be used.", "--dry-run")] = False,
    out: Annotated[Path | None, option("Write time_s, fds, edc there as CSV.")] = None,
    fs: FsOption = None,
    fds: FdsOption = None,
    edc: EdcOption = None,
    unit: UnitOption = None,
    as_json: JsonOption = False,
) -> None:
    """With --out it is written as plain CSV."""
    from palp_core.palpation.identification.emg.muscles import ImportOptions, read_muscles
    from palp_core.palpation.identification.emg.trial import import_report, write_plain

    options = ImportOptions(fs, fds, edc, unit)
    report = import_report(file, options)
    if as_json:
        print_json(report)
    else:
        print_text(f"{report['file']}: {report['format']}")
        print_table(_rows(report["columns"]))
        print_table([(name, _text(report[name])) for name in report if name not in _SHOWN_APART])
        for line in report["notes"]:
            print_text(f"note: {line}")
    if report["problem"]:
        raise PalpError(str(report["problem"]))
    if not dry_run:
        if out is None:
            raise PalpError("nothing to do: give --dry-run to look, or --out FILE.csv to write")
        write_plain(read_muscles(file, options), out)
        note(f"written: {out}")


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
        report=note,
    )
    record = markov_fit.write_fit(found, out) if out is not None else markov_fit.fit_record(found)
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
    """Print transition probabilities, the stiffest level first, and what follows from them."""
    of = "all depths" if chain["depth_mm"] is None else f"{chain['depth_mm']:g} mm"
    print_text(f"{of}: {counted(chain['transitions'], 'transition')} in {counted(chain['trials'], 'trial')}")
    lines = zip(levels, chain["matrix"], chain["low"], chain["high"], strict=True)
    rows = [
        (f"{level:g}", *(f"{m:.2f} ({a:.2f} to {b:.2f})" for m, a, b in zip(*line, strict=True)))
        for level, *line in lines
    ]
    print_table([("next \\ present", *(f"{level:g}" for level in levels)), *reversed(rows)])
    seen = chain["observed"]
    reducible = "irreducible" if seen["irreducible"] else "reducible"
    print_table(
        [
            ("eigenvalues", "  ".join(map(_eigenvalue, chain["eigenvalues"]))),
            ("relaxation time, steps", _interval(chain["relaxation_time_steps"])),
            ("Kemeny's constant, steps", _interval(chain["kemeny_steps"])),
            ("stationary law", "  ".join(map(_interval, chain["stationary"]))),
            ("as observed", f"{reducible}, {seen['closed_classes']} closed classes, period {seen['period']}"),
            ("never visited, never left", f"{seen['levels_never_visited']}, {seen['levels_never_left']}"),
        ]
    )
    print_text("")


def _interval(value: dict[str, float]) -> str:
    return f"{value['value']:.3f} ({value['low']:.3f} to {value['high']:.3f})"


def _eigenvalue(one: dict[str, Any]) -> str:
    turn = f"{one['imaginary']:+.4f}i" if abs(one["imaginary"]) > 1e-9 else ""
    return f"{one['real']:.4f}{turn}"


def _rows(records: list[dict[str, Any]]) -> list[Any]:
    return [list(records[0]), *([_text(value) for value in one.values()] for one in records)]


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "-"
    if value is None or value == "":
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
