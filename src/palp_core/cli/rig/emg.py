"""``palp emg``: recorded EMG to co-contraction, bursts and levels, with what is wrong with it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import JsonOption, argument, option
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text

if TYPE_CHECKING:
    from palp_core.palpation.perception.emg.analysis import EmgSettings

_HERE = "palp_core.cli.rig"

app = lazy_app(
    {
        "analyse": Verb(f"{_HERE}.emg:analyse", "Analyse a recording, or a folder of them."),
        "import": Verb(f"{_HERE}.emg:import_file", "Show a recording's columns, rate and unit."),
        "fit-policy": Verb(f"{_HERE}.fit_policy:fit_policy", "Fit the human policy to recorded EMG."),
    }
)

FsOption = Annotated[
    float | None,
    option("Sampling rate; default: by the time column or the format.", "--fs", metavar="HZ", min=1.0),
]
FdsOption = Annotated[str | None, option("Flexor's column: index from 0, or name.", "--fds", metavar="COL")]
EdcOption = Annotated[
    str | None, option("Extensor's column: index or name; none: one muscle only.", "--edc", metavar="COL")
]
UnitOption = Annotated[
    str | None, option("V, mV, uV, nV or counts; default: each file's own.", metavar="UNIT")
]
SettingsOption = Annotated[
    list[str] | None,
    option("Setting of the analysis: docs/perception.md; repeatable.", "--set", metavar="NAME:=VALUE"),
]


def emg_settings(words: list[str] | None) -> EmgSettings:
    """Return the settings of the analysis, of its burst rule too, given as ``name:=value``."""
    import msgspec

    from palp_core.cli.values import assignments
    from palp_core.errors import PalpError
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
        raise PalpError(f"--set: {error}") from error


_SHOWN_APART = ("file", "format", "columns", "notes", "problem")


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
    if file.is_dir() and not is_recording(file):
        folder = file / EMG if is_human_session(file) else file
        records = emg_batch.run_folder(folder, mvc, options, chosen, note)
        result = emg_batch.write_batch(records, out) if out else {"trials": records}
        if as_json:
            print_json(result)
        else:
            names = ("subject", "phase", "trial", "burst_count", "peak_count", "flags")
            print_table([names, *([_text(one.get(name)) for name in names] for one in records)])
        _note_written(out)
        if any(one["error"] for one in records):
            raise typer.Exit(1)
        return
    trial = run_trial(file, mvc, options, chosen, rest)
    record = emg_batch.write_trial(trial, out) if out else trial_record(trial)
    if as_json:
        print_json(record)
    else:
        shown = (
            "file",
            "mvc",
            "fds",
            "edc",
            "rate_hz",
            "unit",
            "duration_s",
            "cocontraction_mean",
            "burst_count",
            "peak_count",
            "lambda_2",
            "mvc_ratio",
            "clipped",
            "lost",
            "above_mvc",
            "clamped",
            "flags",
            "notes",
        )
        print_table([[name, _text(record[name])] for name in shown])
    _note_written(out)


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
    from palp_core.errors import PalpError
    from palp_core.palpation.identification.emg.muscles import ImportOptions, read_muscles
    from palp_core.palpation.identification.emg.trial import import_report, write_plain

    options = ImportOptions(fs, fds, edc, unit)
    report = import_report(file, options)
    if as_json:
        print_json(report)
    else:
        print_text(f"{report['file']}: {report['format']}")
        heads = list(report["columns"][0])
        print_table([heads, *([_text(one[head]) for head in heads] for one in report["columns"])])
        chosen = {name: report[name] for name in report if name not in _SHOWN_APART}
        print_table([[name, _text(value)] for name, value in chosen.items()])
        for line in report["notes"]:
            print_text(f"note: {line}")
    if report["problem"]:
        raise PalpError(str(report["problem"]))
    if not dry_run:
        if out is None:
            raise PalpError("nothing to do: give --dry-run to look, or --out FILE.csv to write")
        write_plain(read_muscles(file, options), out)
        note(f"written: {out}")


def _note_written(out: Path | None) -> None:
    if out is not None:
        note(f"written: {out / 'quality.html'}")


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "-"
    if value is None or value == "":
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
