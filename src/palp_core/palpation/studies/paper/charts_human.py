"""The paper's figures of the human: 3 (EMG, simulated here), 4 (published numbers), 5 (reconstructed)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.palpation.perception.emg.analysis import EmgAnalysis, EmgSettings, analyse
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.paper.numbers import HUMAN_OF, HUMAN_OVER_TRIALS, HUMAN_RIGHT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NS = 1e9
_SHOWN_S = 12.0


def simulated_trial(seed: int, palpation_s: float = _SHOWN_S) -> EmgAnalysis:
    """Return a simulated trial at 4 mm, MVC included, through the whole chain."""
    source = SimEmg(figure5.matrices()[1])
    state, rng = SimEmgState(), np.random.default_rng(seed)
    source.open(0, state, rng)
    end_ns = source.palpation_ns(state) + round(palpation_s * _NS)
    block = source.drain(end_ns, state, rng)
    both = np.stack([block.fds_v, block.edc_v])
    low, high = (round(t * source.rate_hz / _NS) for t in source.mvc_ns(state))
    start = round(source.palpation_ns(state) * source.rate_hz / _NS)
    settings = EmgSettings(mvc_rule="sum_of_maxima", level_rule="peak")  # as eqs. (1) to (3) are printed
    return analyse(both[:, start:], both[:, low:high], settings, rest=both[:, :low])


def figure_3(seed: int) -> charts.Chart:
    """Normalised EMG of both muscles and their co-contraction with its peaks."""
    found = simulated_trial(seed)
    step = 15
    time_s = np.arange(found.cocontraction.size)[::step] / 1500.0
    rows = [
        [
            round(float(t), 3),
            *(float(e[i * step]) for e in found.normalised),
            float(found.cocontraction[i * step]),
        ]
        for i, t in enumerate(time_s)
    ]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(3, 1, sharex=True)
        names = ("FDS", "EDC")
        for axes, values, name in zip(panels, found.normalised, names, strict=False):
            axes.plot(time_s, values[::step], color=charts.INK, linewidth=0.8)
            charts.in_percent(axes.yaxis)
            charts.tidy(axes, f"{name}, eq. (1)", "", "of MVC, %")
        panels[2].plot(time_s, found.cocontraction[::step], color=charts.INK, linewidth=0.8)
        at = [peak.index for peak in found.peaks]
        panels[2].plot(
            [i / 1500.0 for i in at], found.cocontraction[at], "o", color=charts.VERMILION, markersize=4
        )
        charts.in_percent(panels[2].yaxis)
        charts.tidy(panels[2], "co-contraction, eq. (3), and its peaks", "time, s", "of MVC, %")

    return charts.Chart(
        "figure_03_emg",
        "Figure 3: muscle activity of a trial",
        "The paper shows a recorded trial; ours is simulated: two muscles whose envelope follows the chain "
        "of Figure 5 at 4 mm, through rectification, RMS (150 ms), MVC normalisation and the rule for peaks. "
        "The pipeline can be compared with the paper's, the signal cannot.",
        5.0,
        ["time_s", "fds_share", "edc_share", "cocontraction"],
        rows,
        draw,
    )


def figure_4() -> charts.Chart:
    """The human's accuracy as published: over trials what the text gives, and over all of them."""
    depths = list(HUMAN_RIGHT)
    shares = [HUMAN_RIGHT[d] / HUMAN_OF for d in depths]
    overall = sum(HUMAN_RIGHT.values()) / (HUMAN_OF * len(depths))

    def draw(figure: Figure) -> None:
        over, axes = figure.subplots(1, 2, sharey=True)
        for i, depth in enumerate(depths):
            said = [(trial, share) for d, trial, share in HUMAN_OVER_TRIALS if str(d) == depth]
            shift = 0.06 * (i - 1)  # 4 and 8 mm have the same number
            at = [trial + shift for trial, _ in said]
            over.plot(at, [share for _, share in said], **charts.depth_style(i), label=f"{depth} mm")
        over.annotate('"above 80 %"', (2.0, 0.80), xytext=(2.1, 0.84), fontsize=8)
        over.set_xlim(0.5, 5.5)
        charts.tidy(over, "(a) what the text gives", "trial", "right, %")
        colours = [charts.depth_style(i)["color"] for i in range(len(depths))]
        axes.bar(
            [f"{d} mm" for d in depths] + ["all"],
            [*shares, overall],
            color=[*colours, charts.GREY],
            width=0.6,
        )
        for panel in (over, axes):
            panel.axhline(1 / 3, color=charts.INK, linestyle=":", linewidth=1.0)
            panel.set_ylim(0, 1)
            charts.in_percent(panel.yaxis)
        charts.legend(figure, handles=over.get_lines()[: len(depths)], ncols=len(depths))
        charts.tidy(axes, "(b) all trials", "", "")

    return charts.Chart(
        "figure_04_human_accuracy",
        "Figure 4: the human's accuracy (published numbers)",
        "Six subjects, five trials a depth. Published: 80, 56.7 and 56.7 %, about 65 % in all; nothing here "
        "is ours. Dotted: chance. Over trials the text gives three numbers: at 2 mm 65 % in the first trial "
        "and above 80 % after it, at 4 and 8 mm 65 % in the third. Of six subjects only sixths are possible, "
        "so 65 % must be 4 of 6; at 2 mm only 4, 5, 5, 5, 5 of 6 stay above 80 % and make 80 % in all.",
        3.2,
        ["depth_mm", "trial", "share"],
        [*HUMAN_OVER_TRIALS, *((d, "all", HUMAN_RIGHT[d] / HUMAN_OF) for d in depths)],
        draw,
    )


def figure_5() -> charts.Chart:
    """The transition matrices, reconstructed to the published eigenvalues, and the control."""
    kinds: tuple[figure5.Reconstruction, ...] = ("ar1", "tridiagonal")
    rows = [
        [kind, f"{d * 1e3:g}", i, j, float(matrix[i, j])]
        for kind in kinds
        for d, matrix in zip(figure5.DEPTHS_M, figure5.matrices(kind), strict=True)
        for i in range(5)
        for j in range(5)
    ]

    most = max(matrix.max() for kind in kinds for matrix in figure5.matrices(kind))

    def draw(figure: Figure) -> None:
        panels = figure.subplots(2, 3)
        for line, kind in zip(panels, kinds, strict=True):
            for axes, depth_m, matrix in zip(line, figure5.DEPTHS_M, figure5.matrices(kind), strict=True):
                shown = axes.imshow(matrix, vmin=0.0, vmax=0.6, origin="lower", cmap="viridis")
                axes.grid(visible=False)
                axes.set_xticks(range(5), [f"{x:g}" for x in figure5.LEVELS])
                axes.set_yticks(range(5), [f"{x:g}" for x in figure5.LEVELS])
                second = markov.eigenvalues(matrix)[-2].real
                axes.set_title(f"{kind}, {depth_m * 1e3:g} mm, λ₂ {second:.4f}", fontsize=8.5)
        bar = figure.colorbar(shown, ax=panels, extend="max" if most > 0.6 else "neither", shrink=0.8)
        bar.set_label("probability", fontsize=8.5)
        bar.ax.tick_params(labelsize=8)

    return charts.Chart(
        "figure_05_matrices",
        "Figure 5: the human's transition matrices (reconstructions)",
        "Column: present level; row: next. Published as pictures without legible entries; both rows have "
        "Table 5's eigenvalues, which leave 16 dimensions of a matrix free. Above: nearest to a Gaussian "
        "AR(1) in relative entropy per step (by another measure another chain is), used in all "
        "results here; below: the nearest-neighbour control. The colour scale is the paper's, 0 to 0.6.",
        5.0,
        ["reconstruction", "depth_mm", "next", "current", "probability"],
        rows,
        draw,
    )
