"""The words of the paper's page: what came out, the tables, and why it differs. Every number is computed."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from palp_core.palpation.reporting.html_page import paragraph, table


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f} %"


def _span(ci: list[float]) -> str:
    return f"{100.0 * ci[0]:.1f} to {100.0 * ci[1]:.1f} %"


def opening(report: Mapping[str, Any]) -> list[str]:
    """Return the answer, the table of policies, and the paired comparisons."""
    lines = report["policies"]
    fixed, human, best = lines["fixed_average"], lines["markov"], lines["fixed_best"]
    head = ["policy", "accuracy", "95 %", "2 mm", "4 mm", "8 mm", "probes", "seconds", "calibration error"]
    rows = [
        [
            name.replace("_", " "),
            _percent(line["accuracy"]),
            _span(line["ci"]),
            *(_percent(line["per_depth"][d]) for d in ("2", "4", "8")),
            f"{line['probes']:.2f}",
            f"{line['seconds']:.1f}",
            f"{line['ece']:.3f}",
        ]
        for name, line in lines.items()
    ]
    return [
        paragraph(
            f"Simulated with the paper's filter and stop rule: fixed stiffness, averaged over the five ring "
            f"positions, {_percent(fixed['accuracy'])} (paper 66.7 %); the human strategy "
            f"{_percent(human['accuracy'])} (paper slightly above 90 %); the best fixed position "
            f"{_percent(best['accuracy'])}. Chance is 33.3 %. {fixed['sessions']} independent sessions, "
            f"intervals over sessions. Nothing was tuned to the paper's figures.",
            "lead",
        ),
        "<h2>Every policy</h2>",
        table(head, rows),
        "<h2>Differences on the same trials</h2>",
        table(
            ["first", "second", "difference", "95 %", "p (Holm)"],
            [
                [
                    one["first"].replace("_", " "),
                    one["second"].replace("_", " "),
                    f"{100 * one['difference']:+.1f}",
                    f"{100 * one['ci'][0]:+.1f} to {100 * one['ci'][1]:+.1f}",
                    f"{one['p_holm']:.2g}",
                ]
                for one in report["comparisons"]
            ],
        ),
        *_too_few(int(fixed["sessions"]), len(report["comparisons"])),
    ]


def _too_few(sessions: int, pairs: int) -> list[str]:
    """Return a caution where no difference could be significant, whatever was found."""
    least = 2.0 ** (1 - sessions) * pairs
    if least < 0.05:
        return []
    return [
        paragraph(
            f"With {sessions} sessions no p among {pairs} comparisons can be below {min(least, 1.0):.2g}: "
            "that none is significant says nothing here. Run without --quick."
        )
    ]


def closing(report: Mapping[str, Any]) -> list[str]:
    """Return tables 3 to 6, the tests, the scenes and the reasons for differences."""
    tables = report["tables"]
    parts = [
        "<h2>Tables 3 and 4: order of the human's trials, mm</h2>",
        table(
            ["phase", "order"],
            [
                ["training", " ".join(map(str, tables["3_training_order_mm"]))],
                ["estimation", " ".join(map(str, tables["4_estimation_order_mm"]))],
            ],
        ),
        "<h2>Table 5: eigenvalues</h2>",
        table(
            ["depth, mm", "published", "reconstruction"],
            [
                [d, *(" ".join(f"{x:.4f}" for x in row[k]) for k in ("published", "reconstruction"))]
                for d, row in tables["5_eigenvalues"].items()
            ],
        ),
        "<h2>Table 6: level to ring position</h2>",
        table(["level", "r_a, mm"], [[f"{a:g}", f"{b:g}"] for a, b in tables["6_level_to_ring_mm"]]),
        "<h2>The three readings of eqs. (4) and (5)</h2>",
        table(
            ["reading", "accuracy", "95 %", "probes"],
            [
                [name, _percent(line["accuracy"]), _span(line["ci"]), f"{line['probes']:.2f}"]
                for name, line in report["readings_of_4_and_5"].items()
            ],
        ),
        "<h2>The paper's statements from its own counts</h2>",
        table(
            ["statement", "assumed counts", "test", "p", "carried"],
            [
                [
                    one["text"],
                    one["assumption"],
                    one["test"],
                    f"{one['p']:.2g}",
                    "yes" if one["holds"] else "no",
                ]
                for one in report["statements_from_published_counts"]
            ],
        ),
        "<h2>Analyses of variance on our trials</h2>",
        *(_analysis(name, one) for name, one in report["analyses_of_variance"].items()),
    ]
    if report["scenes"]:
        parts += ["<h2>Three scenes fixed in advance, and a control</h2>", _scenes(report["scenes"])]
    return [*parts, "<h2>Why ours differ</h2>", *map(paragraph, _reasons(report))]


def _analysis(name: str, one: Mapping[str, Any]) -> str:
    found = one["as_in_the_paper"]
    if "reason" in found:
        body = paragraph(f"Not testable as in the paper: {found['reason']}.")
    else:
        body = table(
            ["effect", "df", "F", "p"],
            [[e["name"], f"{e['df']:g}", f"{e['statistic']:.2f}", f"{e['p']:.2g}"] for e in found["effects"]],
        ) + paragraph(f"One session. Caution: {found['caution']}.")
        for group, pairs in one["bonferroni"].items():
            apart = [
                f"{t['first']} and {t['second']} ({100 * t['difference']:+.0f})" for t in pairs if _apart(t)
            ]
            body += paragraph(
                f"Bonferroni over {group.replace('_', ' ') if group != 'r_a' else group}, apart at 5 % "
                f"(points): {'; '.join(apart).replace('_', ' ') or 'none'}."
            )
    logit = one["mixed_logit"]
    if isinstance(logit, list):
        words = ", ".join(f"{e['name']} p = {e['p']:.2g}" for e in logit)
        body += paragraph(f"Mixed logit over all sessions of ours, the session as random effect: {words}.")
    said = paragraph(f"The paper: {one['paper']}.")
    return f"<h3>{escape(name)}</h3>{said}{body}"


def _apart(pair: Mapping[str, Any]) -> bool:
    return pair["p_bonferroni"] is not None and pair["p_bonferroni"] < 0.05


def _scenes(scenes: Mapping[str, Any]) -> str:
    return table(
        [
            "scene",
            "information gain, latent",
            "probes",
            "seconds",
            "calibration error",
            "best fixed",
            "difference",
        ],
        [
            [
                name.replace("_", " "),
                _percent(s["information_gain_latent"]["accuracy"]),
                f"{s['information_gain_latent']['probes']:.2f}",
                f"{s['information_gain_latent']['seconds']:.1f}",
                f"{s['information_gain_latent']['ece']:.3f}",
                f"{s['best_fixed']['name']}: {_percent(s['best_fixed']['accuracy'])}",
                _points(s),
            ]
            for name, s in scenes.items()
        ],
    )


def _reasons(report: Mapping[str, Any]) -> list[str]:
    lines = report["policies"]
    best, uniform, human = (lines[k]["accuracy"] for k in ("fixed_best", "uniform", "markov"))
    said = "above" if human > best else "not above"
    return [
        f"The paper compares the human strategy with the average over five fixed positions, one of which "
        f"(r_a = 0) is at chance and cannot be otherwise. Against the best fixed position the human strategy "
        f"is {said}: {_percent(human)} against {_percent(best)}; drawing positions at random gives "
        f"{_percent(uniform)}.",
        "The gel's modulus, the friction, the tip, the indentation and the spread of the phantom's "
        "height were not published; those assumed here set how far apart the depths feel. The matrices are "
        "reconstructions, and their stationary law decides how often the stiff positions are visited.",
        "One mounting a depth in training and one in estimation, as a plain reading of the paper: the error "
        "of the height is then one number for a hundred trials, which is why whole sessions are right or "
        "wrong and intervals over trials would be far too narrow.",
        "The time-reversed chain is no test here of whether a human's order matters: the matrices are "
        "reconstructed as nearly reversible, so both are nearly one chain. The chain with its levels "
        "permuted, and its stationary law drawn independently, are other chains.",
        "In the analyses of variance the human's trials are the published counts, the others one session of "
        "ours; the paper's own robot counts were not published. With one mounting a depth, depth is "
        "confounded with that mounting.",
        *_scene_reasons(report["scenes"]),
    ]


def _scene_reasons(scenes: Mapping[str, Any]) -> list[str]:
    """Return why information gain was not better in a scene, where there is one to say it of."""
    if not scenes or scenes["noisy"]["better"]:
        return []
    noisy, control = (_points(scenes[name]) for name in ("noisy", "noisy_re_homed"))
    return [
        f"In the noisy scene information gain is {noisy} from the best fixed ring at equal seconds: not "
        "above it for certain. Training there landed once a cell, so every cell's mean is off by a "
        "landing of its own for the whole session. The filter takes means from curves over r_a and "
        "knows how far off those may be; what is left is an error that no choice of positions takes "
        "away. The control "
        f"is the same scene with a training that lands anew for every palpation: there it is {control}.",
    ]


def _points(scene: Mapping[str, Any]) -> str:
    low, high = scene["difference_ci"]
    return f"{100 * scene['difference']:+.1f} points ({100 * low:+.1f} to {100 * high:+.1f})"
