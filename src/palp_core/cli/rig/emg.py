"""``palp emg``: recorded EMG to co-contraction, bursts and levels, with what is wrong with it."""

from dataclasses import fields
from pathlib import Path
from typing import Annotated

import typer

from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import JsonOption
from palp_core.cli.output import make_folder, note, print_json, print_table, print_text
from palp_core.palpation.perception.emg.settings import WINDOW_S, BurstSettings, Crosstalk, LevelRule, MvcRule

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
    typer.Option(
        "--fs", metavar="HZ", min=1.0, help="Sampling rate; default: by the time column or the format."
    ),
]
FdsOption = Annotated[
    str | None, typer.Option("--fds", metavar="COL", help="Flexor's column: index from 0, or name.")
]
EdcOption = Annotated[
    str | None,
    typer.Option("--edc", metavar="COL", help="Extensor's column: index or name; none: one muscle only."),
]
UnitOption = Annotated[
    str | None,
    typer.Option(
        metavar="UNIT",
        help="V, mV, uV, nV or counts, of every file; default: each file's.",
    ),
]
WindowOption = Annotated[float, typer.Option("--window-ms", help="RMS window, 20 to 200 ms.")]
MvcRuleOption = Annotated[
    MvcRule,
    typer.Option(
        help="What levels are held against: of each muscle the median of its best half second, less what "
        "choosing it gains; the largest sum; the sum of each muscle's largest, as eq. (3) is printed.",
    ),
]
LevelRuleOption = Annotated[
    LevelRule,
    typer.Option(help="Level of a peak: its top as a whole without the power of rest, or its largest."),
]
CrosstalkOption = Annotated[
    Crosstalk,
    typer.Option(help="Take off two muscles what their recordings have in common: a third muscle's."),
]
BurstOption = Annotated[
    list[str] | None,
    typer.Option(
        "--burst",
        metavar="NAME:=VALUE",
        help="A setting of the burst rule, as in gap_s:=0.1; repeatable.",
        show_default=False,
    ),
]


def burst_settings(words: list[str] | None) -> BurstSettings:
    """Return the burst rule with the settings given as ``name:=value``.

    Raises:
        PalpError: There is no such setting, its value is not a number, or out of range.
    """
    from palp_core.cli.text.words import assignments
    from palp_core.errors import PalpError
    from palp_core.graph.problems import hint

    known = [field.name for field in fields(BurstSettings)]
    numbers: dict[str, float] = {}
    for name, text in assignments("--burst", words).items():
        if name not in known:
            names = ", ".join(known)
            raise PalpError(f"--burst {name}: no such setting{hint(name, known)}; there are {names}")
        try:
            numbers[name] = float(text)
        except ValueError:
            raise PalpError(f"--burst {name}:={text}: write a number") from None
    return BurstSettings(**numbers)


_SHOWN_APART = ("file", "format", "columns", "notes", "problem")


def analyse(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording, or a folder subject/phase/trial.")
    ],
    *,
    fs: FsOption = None,
    fds: FdsOption = None,
    edc: EdcOption = None,
    unit: UnitOption = None,
    mvc: Annotated[
        Path | None, typer.Option(help="Recording of the MVC; a bag or a folder may hold its own.")
    ] = None,
    rest: Annotated[
        Path | None, typer.Option(help="Recording at rest; default: the quietest twentieth.")
    ] = None,
    window_ms: WindowOption = 1e3 * WINDOW_S,
    mvc_rule: MvcRuleOption = "plateau",
    level_rule: LevelRuleOption = "plateau",
    crosstalk: CrosstalkOption = "keep",
    burst: BurstOption = None,
    band_hz: Annotated[tuple[float, float], typer.Option(help="Band-pass.")] = (20.0, 450.0),
    rails: Annotated[
        tuple[float, float] | None, typer.Option(help="The converter's ends, in volts or the file's counts.")
    ] = None,
    swept: Annotated[
        bool, typer.Option("--sweep", help="Bursts, peaks and lambda_2 over windows, thresholds and valleys.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for page (HTML), tables (CSV) and JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Status 1: a trial of the folder failed."""
    from palp_core.errors import PalpError
    from palp_core.palpation.identification.emg import batch as emg_batch
    from palp_core.palpation.identification.emg.files import is_recording
    from palp_core.palpation.identification.emg.muscles import ImportOptions
    from palp_core.palpation.identification.emg.trial import run_trial, trial_record
    from palp_core.palpation.perception.emg.analysis import EmgSettings
    from palp_core.palpation.session.human.record import EMG, is_human_session

    settings = EmgSettings(
        low_hz=band_hz[0],
        high_hz=band_hz[1],
        window_s=window_ms / 1e3,
        bursts=burst_settings(burst),
        mvc_rule=mvc_rule,
        level_rule=level_rule,
        crosstalk=crosstalk,
        rails=rails,
    )
    options = ImportOptions(fs, fds, edc, unit)
    if out is not None:
        make_folder(out)
    if file.is_dir() and not is_recording(file):
        if swept:
            raise PalpError("--sweep is for one recording; name a trial of the folder")
        records = emg_batch.run_folder(
            file / EMG if is_human_session(file) else file, mvc, options, settings, note
        )
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
    trial = run_trial(file, mvc, options, settings, rest)
    record = emg_batch.write_trial(trial, out) if out else trial_record(trial)
    if swept:
        record["sweep"] = emg_batch.sweep_trial(trial, out)
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
        if swept:
            heads = list(record["sweep"][0])
            print_table([heads, *([_text(row[head]) for head in heads] for row in record["sweep"])])
    _note_written(out)


def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")],
    *,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only show what would be used.")] = False,
    out: Annotated[Path | None, typer.Option(help="Write time_s, fds, edc there as CSV.")] = None,
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
