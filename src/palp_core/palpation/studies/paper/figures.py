"""The paper's figures, 3 to 12, each with ours, and what it did not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.perception.belief.primitives import Primitives
from palp_core.palpation.perception.emg.analysis import EmgAnalysis, EmgSettings, analyse
from palp_core.palpation.perception.signal.wavelet import denoise, edge_cone
from palp_core.palpation.perception.strategy import figure5, markov
from palp_core.palpation.reporting import charts
from palp_core.palpation.studies.charts import Curve, Panel, curves_chart, draw_bars, finish_bars
from palp_core.palpation.studies.paper.numbers import (
    HUMAN_OF,
    HUMAN_OVER_TRIALS,
    HUMAN_RIGHT,
    PUBLISHED,
)
from palp_core.palpation.studies.plan import (
    FROM_M,
    RATE_HZ,
    SPEED_M_PER_S,
    TO_M,
    Conditions,
    Gel,
    add_noise,
    sweep_torque,
)
from palp_core.palpation.studies.trials import Outcomes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 8  # iterations
_SHOWN_S = 12.0  # of a trial of EMG
_STEP = 15  # samples of EMG, of which one is drawn
_CHANCE = {"chance": (1 / 3, ":")}
_NS = 1e9


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
    found, shown = simulated_trial(seed), slice(None, None, _STEP)
    time_s = np.arange(found.cocontraction.size) / 1500.0
    look = {"color": charts.INK, "linewidth": 0.8}
    dots = {"color": charts.VERMILION, "marker": "o", "linestyle": "", "markersize": 4}
    at = np.array([peak.index for peak in found.peaks], dtype=np.int64)
    peaks = Curve("", time_s[at], 100.0 * found.cocontraction[at], dots)
    signals = {
        "FDS, eq. (1)": found.normalised[0],
        "EDC, eq. (1)": found.normalised[1],
        "co-contraction, eq. (3), and its peaks": found.cocontraction,
    }
    lines = [Curve("", time_s[shown], 100.0 * signal[shown], look) for signal in signals.values()]
    panels = [
        Panel(title, "time, s" if last else "", "of MVC, %", [line, peaks] if last else [line])
        for title, line, last in zip(signals, lines, (False, False, True), strict=True)
    ]
    return curves_chart(
        "figure_03_emg",
        "Figure 3: muscle activity of a trial",
        "The paper shows a recorded trial; ours is simulated: two muscles whose envelope follows the chain "
        "of Figure 5 at 4 mm, through rectification, RMS (150 ms), MVC normalisation and the rule for peaks. "
        "The pipeline can be compared with the paper's, the signal cannot.",
        5.0,
        panels,
    )


def figure_4() -> charts.Chart:
    """The human's accuracy as published."""
    depths = list(HUMAN_RIGHT)
    shares = [HUMAN_RIGHT[d] / HUMAN_OF for d in depths]
    overall = sum(HUMAN_RIGHT.values()) / (HUMAN_OF * len(depths))

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        draw_bars(axes, range(len(depths) + 1), [*shares, overall], color=charts.GREY)
        axes.set_xticks(range(len(depths) + 1), [*(f"{d} mm" for d in depths), "all"])
        finish_bars(axes, _CHANCE)

    return charts.Chart(
        "figure_04_human_accuracy",
        "Figure 4: the human's accuracy (published numbers)",
        "Six subjects, five trials a depth. Published: 80, 56.7 and 56.7 %, about 65 % in all; nothing here "
        "is ours. Over trials the text gives three numbers: at 2 mm 65 % in the first trial "
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
    found = {
        (kind, f"{d * 1e3:g}"): matrix
        for kind in kinds
        for d, matrix in zip(figure5.DEPTHS_M, figure5.matrices(kind), strict=True)
    }
    rows = [[*key, i, j, float(of[i, j])] for key, of in found.items() for i in range(5) for j in range(5)]
    most = max(matrix.max() for matrix in found.values())

    def draw(figure: Figure) -> None:
        panels = figure.subplots(2, 3)
        for axes, ((kind, depth), matrix) in zip(panels.flat, found.items(), strict=True):
            shown = axes.imshow(matrix, vmin=0.0, vmax=0.6, origin="lower", cmap="viridis")
            axes.grid(visible=False)
            axes.set_xticks(range(5), [f"{x:g}" for x in figure5.LEVELS])
            axes.set_yticks(range(5), [f"{x:g}" for x in figure5.LEVELS])
            second = markov.eigenvalues(matrix)[-2].real
            axes.set_title(f"{kind}, {depth} mm, λ₂ {second:.4f}", fontsize=8.5)
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


def figure_7b(gel: Gel) -> charts.Chart:
    """Joint stiffness over the joint's angle, eq. (6)."""
    angle, probe = np.linspace(-np.pi / 2, np.pi / 2, 91), Probe()
    lines = [
        Curve(f"r_a = {r * 1e3:g} mm", np.degrees(angle), 1e3 * probe.joint_stiffness(r, angle), {"color": c})
        for r, c in zip(gel.rings_m, charts.ring_colours(len(gel.rings_m)), strict=True)
    ]
    title = "K_s = 2 r_a R k_s cos q"
    return curves_chart(
        "figure_07b_stiffness",
        "Figure 7(b): joint stiffness",
        "Eq. (6) with the published R = 6.8 mm and k_s = 0.24 N/mm: the same curves as the paper's.",
        3.4,
        [Panel(title, "joint angle q, degrees", "stiffness, N mm/rad", lines)],
    )


def figure_8(gel: Gel, conditions: Conditions, seed: int, count: int = 25) -> charts.Chart:
    """Mean and spread of de-noised sweeps at 8 mm, per ring position."""
    rng = np.random.default_rng(seed)
    stage_mm = 1e3 * np.arange(FROM_M, TO_M, SPEED_M_PER_S / RATE_HZ)
    shown = slice(edge_cone(), len(stage_mm) - edge_cone(), 20)
    lines = []
    for ring_m, colour in zip(gel.rings_m, charts.ring_colours(len(gel.rings_m)), strict=True):
        landed_m = ring_m + conditions.landings_m(rng, (count,))
        true = [sweep_torque(gel, gel.depths_m[-1], at_m) for at_m in landed_m.tolist()]
        found = 1e3 * np.array([denoise(add_noise(one, gel, rng)) for one in true])[:, shown]
        mean = found.mean(axis=0)
        top = [int(np.argmax(mean))]
        dot = {"color": colour, "marker": "o", "linestyle": "", "markersize": 4}
        label = f"{ring_m * 1e3:g} mm"
        lines += [
            Curve(label, stage_mm[shown], mean, {"color": colour}, found.std(axis=0, ddof=1), band=True),
            Curve("", stage_mm[shown][top], mean[top], dot),
        ]
    panel = Panel(f"d = 8 mm, {count} palpations each", "stage, mm", "torque, N mm", lines)
    return curves_chart(
        "figure_08_sweeps",
        "Figure 8: de-noised torque at 8 mm",
        "Mean and standard deviation of the de-noised sweeps (db10, 5 levels), peaks marked. The spread is "
        "that of the ring's landing and of the sensor; the paper's gel and tip are not known, so its "
        "torques are not expected to be ours, their order over r_a is.",
        3.8,
        [panel],
        legend="r_a",
    )


def figure_9(primitives: Primitives) -> charts.Chart:
    """Memory primitives: a normal per depth and ring position."""
    panels = []
    for k, ring_m in enumerate(primitives.rings_m):
        mean, sd = 1e3 * primitives.mean[:, k], 1e3 * primitives.sd[:, k]
        torque = np.linspace((mean - 4 * sd).min(), (mean + 4 * sd).max(), 300)
        lines = []
        for i, depth_m in enumerate(primitives.depths_m):
            density = np.exp(-0.5 * ((torque - mean[i]) / sd[i]) ** 2) / (sd[i] * np.sqrt(2 * np.pi))
            lines.append(
                Curve(f"{depth_m * 1e3:g} mm", torque, density, charts.depth_style(i) | {"marker": ""})
            )
        panels.append(Panel(f"r_a {ring_m * 1e3:g} mm", "N mm", "" if k else "density", lines))
    return curves_chart(
        "figure_09_primitives",
        "Figure 9: memory primitives",
        "Normals fitted to 25 training peaks a cell in one session. At r_a = 0 the depths are one; the "
        "stiffer the joint, the further apart they are, as in the paper.",
        3.0,
        panels,
        legend="depth",
    )


def figures_10_and_11(
    sessions: Mapping[str, Sequence[Outcomes]], depths_m: Sequence[float], took: Mapping[str, Any]
) -> list[charts.Chart]:
    """Belief over iterations of two fixed positions and of the human strategy."""
    ours = ", ".join(f"{one['value']:.2f} at {depth} mm" for depth, one in took["by_depth"].items())
    captions = {
        "fixed_16": "The paper reports no progress over iterations and shows an example. Ours: mean over "
        "sessions with its standard error. A trial that has stopped keeps its last belief.",
        "fixed_8": "As before at the middle position: the readings of a trial share one landing of the ring, "
        "so further probes hardly move the mean.",
        "markov": "The paper: most trials end within 5 iterations, more the deeper the nodule. Ours took "
        f"{ours} on average, with the reconstructed average matrix, read as draws from its columns.",
    }
    titles = {
        "fixed_16": "Figure 10: belief over iterations, fixed r_a = 16 mm",
        "fixed_8": "Figure 10: belief over iterations, fixed r_a = 8 mm",
        "markov": "Figure 11: belief over iterations, human strategy",
    }
    return [
        curves_chart(
            f"figure_{title[7:9]}_{name}",
            title,
            captions[name],
            3.4,
            [Panel("", "iteration", "expected depth, mm", _beliefs(sessions[name], depths_m))],
            legend="true depth",
        )
        for name, title in titles.items()
    ]


def _beliefs(sessions: Sequence[Outcomes], depths_m: Sequence[float]) -> list[Curve]:
    """Return the posterior mean depth over iterations, with its standard error over sessions."""
    at, lines = np.arange(1.0, SHOWN + 1), []
    for c, depth_m in enumerate(depths_m):
        means = np.array([1e3 * one.expected_m[one.depth == c, :SHOWN].mean(axis=0) for one in sessions])
        error = means.std(axis=0, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0 * means[0]
        look = charts.depth_style(c)
        true = {"color": look["color"], "linewidth": 0.6, "linestyle": ":"}
        lines += [
            Curve(f"{depth_m * 1e3:g} mm", at, means.mean(axis=0), look | {"markersize": 3.5}, error),
            Curve("", at, np.full(SHOWN, 1e3 * depth_m), true),
        ]
    return lines


def figure_12(table: Mapping[str, dict[str, Any]]) -> charts.Chart:
    """Human, fixed and human strategy: the paper's three bars, ours, and the fixed position that is best."""
    ours = ("fixed_average", "fixed_best", "markov")
    paper = [PUBLISHED[key]["overall"] for key in ("human", "fixed", "human_strategy")]
    rows: list[list[Any]] = [
        ["human", paper[0], None, None, None],
        *(
            [name, published, table[name]["accuracy"], *table[name]["ci"]]
            for name, published in zip(ours, (paper[1], None, paper[2]), strict=True)
        ),
    ]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        shares, intervals = ([table[name][key] for name in ours] for key in ("accuracy", "ci"))
        draw_bars(axes, [-0.19, 0.81, 2.81], paper, width=0.35, color=charts.GREY, label="paper")
        draw_bars(axes, [1.19, 2.19, 3.19], shares, intervals, width=0.35, label="ours")
        axes.set_xticks(
            range(len(rows)), ["human", "fixed,\naverage", "fixed,\nbest position", "human\nstrategy"]
        )
        finish_bars(axes, _CHANCE)

    return charts.Chart(
        "figure_12_comparison",
        "Figure 12: human, fixed stiffness, human strategy",
        "Grey: as published. Blue: this study, with 95 % intervals over sessions. The paper compares with "
        "the average of the five fixed positions alone. The best of them, which it leaves out, is the one "
        "whose training is decided best in each session.",
        3.4,
        ["experiment", "paper", "ours", "low", "high"],
        rows,
        draw,
    )


def policies_chart(table: Mapping[str, dict[str, Any]]) -> charts.Chart:
    """Accuracy of every policy, and what it cost."""
    names, places = list(table), range(len(table))
    accuracy, intervals, seconds = (
        [one[key] for one in table.values()] for key in ("accuracy", "ci", "seconds")
    )
    levels = {"paper, human strategy": (0.9, "-."), "paper, fixed": (0.667, "--")} | _CHANCE

    def draw(figure: Figure) -> None:
        above, below = figure.subplots(2, 1, sharex=True)
        above.set_title("accuracy, 95 % intervals over sessions")
        draw_bars(above, places, accuracy, intervals)
        finish_bars(above, levels)
        drawn = below.bar(places, seconds, color=charts.GREEN, width=0.7)
        below.bar_label(drawn, [f"{one['probes']:.1f}" for one in table.values()], fontsize=7)
        below.set_xticks(places, [n.replace("_", " ") for n in names], rotation=45, ha="right")
        charts.tidy(below, "seconds a trial on the rig; above: probes", "", "s")

    return charts.Chart(
        "policies",
        "Every policy on the same trials",
        "The paper's filter, feature and stop rule verbatim for all. Differences between policies are "
        "within sessions and sharper than the intervals suggest; the table of comparisons tests them.",
        6.0,
        ["policy", "accuracy", "low", "high", "probes", "seconds", "ece"],
        [[n, t["accuracy"], *t["ci"], t["probes"], t["seconds"], t["ece"]] for n, t in table.items()],
        draw,
    )
