"""Learn the strategy from recordings of EMG: peaks to levels, levels to a chain per depth and one of all."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.batch import run_folder
from palp_core.palpation.identification.emg.files import is_recording
from palp_core.palpation.identification.emg.muscles import ImportOptions
from palp_core.palpation.identification.emg.trial import run_trial, settings_record, trial_record
from palp_core.palpation.perception.emg.analysis import EmgSettings
from palp_core.palpation.perception.strategy.chain_file import Chain, ChainFile, write_chains
from palp_core.palpation.perception.strategy.figure5 import LEVELS
from palp_core.palpation.perception.strategy.markov_posterior import (
    ChainSummary,
    fit_chain,
    summarise,
)
from palp_core.palpation.reporting.charts import Chart, number
from palp_core.palpation.reporting.html_page import picture, write_page
from palp_core.palpation.session.human.record import (
    EMG,
    emg_depths,
    emg_that_does_not_count,
    is_human_session,
)
from palp_core.whole_file import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST_SD = 0.01


@dataclass(frozen=True)
class EmgRecordingPath:
    """A recording, or a folder of them (subject/phase/trial, or a session's), and its depth if known."""

    path: Path  # The file or folder
    # As stated; None: as the table of a session with a person has it; else as the file's name says
    # (`trial3_2mm.csv`); else not known
    depth_m: float | None = None


@dataclass(frozen=True, eq=False)
class FittedChain:
    """A chain with what it was learnt from."""

    depth_m: float | None  # Depth of its trials; None: all trials
    trial_count: int  # Trials behind it
    peaks: tuple[float, ...]  # Strength of the peaks of co-contraction, dimensionless
    clamped_count: int  # Peaks outside the scale of levels
    summary: ChainSummary  # What the chain's posterior says

    @property
    def mean_level(self) -> float:
        """Mean of the peaks: of P_{S,1}."""
        return float(np.mean(self.peaks))

    @property
    def sd_level(self) -> float:
        """Standard deviation of the peaks: sigma_S; at least 0.01, so that it stays a density."""
        return max(float(np.std(self.peaks)), _LEAST_SD)


@dataclass(frozen=True, eq=False)
class StrategyFit:
    """Every chain of a fit, the pooled one first, and the records of the trials that failed or did not."""

    chains: tuple[FittedChain, ...]
    records: tuple[dict[str, Any], ...]
    settings: EmgSettings
    prior_count: float


def source_of(word: str) -> EmgRecordingPath:
    """Return what a word of the command line names: ``FILE`` or ``MM=FILE``.

    >>> source_of("2=trial.csv")
    EmgRecordingPath(path=PosixPath('trial.csv'), depth_m=0.002)
    """
    stated = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:mm)?=(.+)", word)
    return (
        EmgRecordingPath(Path(stated[2]), float(stated[1]) / 1e3) if stated else EmgRecordingPath(Path(word))
    )


def fit(
    sources: Sequence[EmgRecordingPath],
    mvc: Path | None,
    options: ImportOptions,
    settings: EmgSettings,
    rng: np.random.Generator,
    *,
    prior_count: float = 0.5,
    mass: float = 0.95,
    report: Callable[[str], None],
) -> StrategyFit:
    """Analyse recordings and learn the chains; no transition spans two trials or a gap."""
    records: list[dict[str, Any]] = []
    places = [source.path.resolve() for source in sources]
    for source in sources:
        if places.count(source.path.resolve()) > 1:
            raise PalpError(f"{source.path}: named twice; a trial counts once")
        if is_human_session(source.path):
            found = _of_session(source.path, mvc, options, settings, report)
        elif source.path.is_dir() and not is_recording(source.path):
            found = run_folder(source.path, mvc, options, settings, report)
        else:
            found = [{"error": None, **trial_record(run_trial(source.path, mvc, options, settings))}]
        for one in found:
            for line in one.get("notes", ()):
                report(f"{one['file']}: {line}")
        stated = {} if source.depth_m is None else {"depth_m": source.depth_m}
        records += [{"depth_m": _named_depth_m(one), **one, **stated} for one in found]
    good = [one for one in records if not one["error"]]
    if not good:
        raise PalpError("every trial failed; see the messages above")
    depths = sorted({one["depth_m"] for one in good if one["depth_m"] is not None})
    chains = [_chain(None, good, rng, prior_count, mass)]
    for depth_m in depths:
        try:
            chains.append(
                _chain(depth_m, [one for one in good if one["depth_m"] == depth_m], rng, prior_count, mass)
            )
        except PalpError as error:
            report(f"{depth_m * 1e3:g} mm: {error}")
    return StrategyFit(tuple(chains), tuple(records), settings, prior_count)


def _of_session(
    folder: Path,
    mvc: Path | None,
    options: ImportOptions,
    settings: EmgSettings,
    report: Callable[[str], None],
) -> list[dict[str, Any]]:
    """Return the trials of a session with a person, each with the depth that its table has."""
    skip, depths_m = emg_that_does_not_count(folder), emg_depths(folder)
    found = run_folder(folder / EMG, mvc, options, settings, report, skip=skip)
    trials = [{**one, "depth_m": depths_m.get(Path(one["file"]))} for one in found]
    if sealed := sum(one["depth_m"] is None for one in trials):
        report(
            f"{folder}: the depth of {sealed} trials is sealed: of these the chain of all depths alone learns"
        )
    return trials


def _named_depth_m(record: dict[str, Any]) -> float | None:
    """Return the depth that a trial's name or its phase's folder names, as ``2mm``."""
    for name in (Path(record["file"]).stem, str(record.get("phase", ""))):
        stated = re.findall(r"(?<![\d.])(\d+(?:\.\d+)?)\s*mm(?![a-z])", name.lower())
        if len(stated) == 1:
            return float(stated[0]) / 1e3
    return None


def _chain(
    depth_m: float | None,
    records: Sequence[dict[str, Any]],
    rng: np.random.Generator,
    prior_count: float,
    mass: float,
) -> FittedChain:
    runs = [run for one in records for run in one["runs"]]
    posterior = fit_chain(runs, len(LEVELS), prior_count=prior_count)
    return FittedChain(
        depth_m,
        len(records),
        tuple(peak["strength"] for one in records for peak in one["peaks"]),
        sum(one["clamped"] for one in records),
        summarise(posterior, rng, mass=mass),
    )


def chain_file(found: StrategyFit) -> ChainFile:
    """Return what the Markov policy loads."""
    return ChainFile(
        levels=list(LEVELS),
        prior_count=found.prior_count,
        chains=[
            Chain(
                depth_m=one.depth_m,
                matrix=one.summary.matrix.tolist(),
                counts=one.summary.posterior.counts.tolist(),
                mean_level=one.mean_level,
                sd_level=one.sd_level,
            )
            for one in found.chains
        ],
    )


def fit_record(found: StrategyFit) -> dict[str, Any]:
    """Return a fit's numbers, ready for JSON."""
    settings = found.settings
    return {
        "levels": list(LEVELS),
        "settings": {
            **settings_record(settings),
            "prior_count": found.prior_count,
            "interval_mass": found.chains[0].summary.mass,
        },
        "trials": [
            {key: one.get(key) for key in ("file", "depth_m", "burst_count", "peak_count", "flags", "error")}
            for one in found.records
        ],
        "chains": [_chain_record(one) for one in found.chains],
    }


def _chain_record(one: FittedChain) -> dict[str, Any]:
    summary = one.summary
    seen = summary.observed
    return {
        "depth_mm": None if one.depth_m is None else round(one.depth_m * 1e3, 6),
        "trials": one.trial_count,
        "peaks": len(one.peaks),
        "clamped": one.clamped_count,
        "mean_level": one.mean_level,
        "sd_level": one.sd_level,
        "transitions": int(summary.posterior.counts.sum()),
        "counts": summary.posterior.counts.tolist(),
        "matrix": summary.matrix.tolist(),
        "low": summary.low.tolist(),
        "high": summary.high.tolist(),
        "eigenvalues": [
            {"real": value.real, "imaginary": value.imag, "modulus": asdict(modulus)}
            for value, modulus in zip(summary.eigenvalues, summary.moduli, strict=True)
        ],
        "relaxation_time_steps": asdict(summary.relaxation_time),
        "kemeny_steps": asdict(summary.kemeny),
        "stationary": [asdict(share) for share in summary.stationary],
        "observed": {
            "levels_never_visited": [level + 1 for level in seen.never_visited],
            "levels_never_left": [level + 1 for level in seen.never_left],
            "closed_classes": seen.structure.closed_class_count if seen.structure else 0,
            "irreducible": bool(seen.structure and seen.structure.irreducible),
            "period": seen.structure.period if seen.structure else 0,
        },
    }


_SCALE_END = 0.6  # of the published Figure 5; a chain with a larger entry gets its own


def write_fit(found: StrategyFit, out: Path) -> dict[str, Any]:
    """Write chain.json (which the Markov policy loads), markov.json, the chart, its table and the page."""
    record = fit_record(found)
    out.mkdir(parents=True, exist_ok=True)
    write_chains(chain_file(found), out / "chain.json")
    write_json(out / "markov.json", record)
    write_page(
        out / "index.html",
        "markov_fit.html",
        fit=record,
        levels=[f"level {level:g}" for level in LEVELS],
        matrices=picture(_matrices_chart(found), out),
    )
    return record


def _matrices_chart(found: StrategyFit) -> Chart:
    top = max(_SCALE_END, *(float(one.summary.matrix.max()) for one in found.chains))

    def draw(to: Figure) -> None:
        panels = to.subplots(1, len(found.chains), squeeze=False)[0]
        for axes, one in zip(panels, found.chains, strict=True):
            image = axes.imshow(one.summary.matrix, vmin=0.0, vmax=top, cmap="cividis", origin="lower")
            for row in range(len(LEVELS)):
                for column in range(len(LEVELS)):
                    value = one.summary.matrix[row, column]
                    number(axes, column, row, f"{value:.2f}")
            axes.set_xticks(range(len(LEVELS)), [f"{level:g}" for level in LEVELS])
            axes.set_yticks(range(len(LEVELS)), [f"{level:g}" for level in LEVELS])
            axes.grid(visible=False)
            axes.set_title(f"{_name(one)}, {int(one.summary.posterior.counts.sum())} transitions", loc="left")
            axes.set_xlabel("present level")
            axes.set_ylabel("next level")
        to.colorbar(image, ax=list(panels), shrink=0.7)

    return Chart(
        "matrices",
        "Transition matrices",
        "Posterior mean of M[next, present]; the table has every entry's interval.",
        3.2,
        ("depth_mm", "next", "present", "count", "mean", "low", "high"),
        [row for one in found.chains for row in _entries(one)],
        draw,
    )


def _name(one: FittedChain) -> str:
    return "all depths" if one.depth_m is None else f"d = {one.depth_m * 1e3:g} mm"


def _entries(one: FittedChain) -> list[tuple[object, ...]]:
    summary = one.summary
    depth_mm = "" if one.depth_m is None else one.depth_m * 1e3
    return [
        (
            depth_mm,
            LEVELS[i],
            LEVELS[j],
            int(summary.posterior.counts[i, j]),
            float(summary.matrix[i, j]),
            float(summary.low[i, j]),
            float(summary.high[i, j]),
        )
        for j in range(len(LEVELS))
        for i in range(len(LEVELS))
    ]
