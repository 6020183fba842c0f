"""The belief of the trial under way: posterior as bars, gain and entropy over its palpations."""

from __future__ import annotations

from typing import Any

from nicegui import ui
from nicegui.element import Element

from palp_core.counted import counted
from palp_core.palpation.live_page.monitor import RigMonitor
from palp_core.palpation.live_page.roles import policy_at_work
from palp_core.palpation.live_page.trials import JudgedProbe, TrialBelief
from palp_core.view.pages.parts import table, text_element
from palp_core.view.source.protocol import ViewSource


class ShareBars(Element, component="bars.js"):  # type: ignore[misc, call-arg]
    def __init__(self, label: str) -> None:
        super().__init__()
        self._props.update(rows=[], words=label)

    def show(self, rows: list[dict[str, Any]]) -> None:
        if rows != self._props["rows"]:
            self._props["rows"] = rows
            self.update()


class BeliefPanel:
    """The belief of the present trial, and how its palpations changed it."""

    def __init__(self, source: ViewSource, monitor: RigMonitor) -> None:
        self._source, self._monitor = source, monitor
        self._shown = [JudgedProbe(-1, 0.0, 0.0)]
        text_element("h2", "The present trial")
        self._text = text_element("div", "").props('data-what="trial" role="status"')
        self._policy = text_element("div", "", "quiet").props('data-what="policy"')
        self._bars = ShareBars("how probable each depth is")
        text_element("h2", "Gain and entropy over its palpations")
        self._box = ui.element("div").props('data-what="probes"')

    def show(self) -> None:
        belief = self._monitor.belief
        self._text.text = trial_text(belief, self._monitor.latest("Progress"))
        policy = policy_at_work(self._source, self._monitor.topics)
        self._policy.text = f"policy: {policy}" if policy else ""
        self._bars.show(bars(belief))
        if belief.probes == self._shown:
            return
        self._shown = list(belief.probes)
        self._box.clear()
        with self._box:
            if not belief.probes:
                text_element("div", "no palpation of it is judged yet", "quiet")
                return
            most = max(1.0, *(probe.gain_bits for probe in belief.probes), belief.probes[0].entropy_bits)
            rows = (
                (str(probe.iteration), _part(probe.gain_bits, most), _part(probe.entropy_bits, most))
                for probe in belief.probes
            )
            table(("Palpation", "Gain, bits", "Entropy, bits"), rows)


def _part(bits: float, most: float) -> Any:
    def put() -> None:
        with ui.element("span").classes("rig-part"):
            text_element("span", f"{bits:.2f}")
            ui.element("span").classes("rig-bar").style(
                f"width: {80 * bits / most:.1f}%; background: var(--accent)"
            )

    return put


def bars(belief: TrialBelief) -> list[dict[str, Any]]:
    most = max(belief.posterior, default=0.0)
    return [
        {
            "label": f"{depth_mm:g} mm",
            "share": round(p, 4),
            "text": f"{p:.1%}".replace("%", " %"),
            "most": p == most,
        }
        for depth_mm, p in zip(belief.depths_mm, belief.posterior, strict=False)
    ]


def trial_text(belief: TrialBelief, progress: dict[str, Any] | None) -> str:
    parts = []
    if progress is not None:
        what = "palpation" if progress["phase"] == "training" else "trial"
        phase = "the session is over" if progress["phase"] == "done" else progress["phase"]
        parts.append(f"{phase}: {progress['done_count']} of {progress['total_count']} {what}s done")
    if belief.estimating and belief.probes:
        count = len(belief.probes)
        count_text = f"{counted(count, 'palpation')} of this trial"
        parts.append(f"{count_text}, {belief.verdict}" if belief.verdict != "continue" else count_text)
    if belief.within_sweep:
        parts.append("believed within the sweep")
    return "; ".join(parts) or "nothing heard yet"
