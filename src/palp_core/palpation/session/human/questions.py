"""What a person or the operator is asked, and what an answer means."""

import re
from collections.abc import Sequence
from typing import Literal

from palp_core.errors import PalpError
from palp_core.palpation.session.human.plan import HoldMvc, HumanTrial
from palp_core.palpation.session.plan import PlannedPhantom
from palp_core.palpation.session.sheet.identity import consent_id, subject_code

AnswerForm = Literal["choice", "mm"]

QUESTION = "Please estimate the depth of a hard nodule based on your haptic perception"
"""As the paper puts it."""

LARGEST_MM = 30.0
"""The phantom's height: nothing in it lies deeper."""

AGAIN = "again"
"""What the operator says of a trial that was spoilt."""


IDENTITY = {
    "consent": "Id of the signed consent form:",
    "subject": "Subject code (S01), never a name:",
}
QUIET = "The subject sits relaxed, forearm at rest, hand still. Enter records the muscles at rest."
PALPATING = f"Palpating. Enter when the subject is done; '{AGAIN}' if the trial was spoilt."


def refuse_names(question: str, answer: str) -> None:
    """Refuse an answer that may be a name before it is sent: what is sent is recorded."""
    if question == IDENTITY["subject"]:
        subject_code(answer)
    elif question == IDENTITY["consent"]:
        consent_id(answer)


def mvc_words(step: HoldMvc) -> str:
    again = "" if step.attempt == 1 else f" (attempt {step.attempt})"
    return (
        f"Hold and move {step.mass_kg:g} kg, as hard as you can, for {step.duration_s:g} s{again}. "
        "Enter begins it."
    )


def begin_words(trial: HumanTrial, of: int, *, same: bool) -> str:
    give = f"{'Leave' if same else 'Give'} phantom {trial.phantom}"
    depth_m = trial.depth_m if trial.told else None
    depth = "; subject blindfolded" if depth_m is None else f"; tell the subject: {depth_m * 1e3:g} mm"
    attempt = "" if trial.attempt == 1 else f", attempt {trial.attempt}"
    return (
        f"{trial.phase.capitalize()} trial {trial.number} of {of}{attempt}. {give}{depth}. Enter begins it."
    )


def ending(text: str) -> str:
    """Return how a trial was ended by what the operator typed."""
    if text not in ("", AGAIN):
        raise PalpError(f"press Enter to end the trial, or type '{AGAIN}' to mark it spoilt")
    return "repeat" if text else "subject"


def depth_question(phantoms: Sequence[PlannedPhantom], form: AnswerForm) -> str:
    if form == "mm":
        return f"{QUESTION}. (mm)"
    return f"{QUESTION}: {_listed(phantoms)}."


def depth_answer(text: str, phantoms: Sequence[PlannedPhantom], form: AnswerForm) -> float:
    """Return the depth that an answer names, mm.

    >>> from palp_core.palpation.session.human.plan import HumanDesign
    >>> depth_answer(" 4 mm", HumanDesign().phantoms, "choice")
    4.0
    """
    found = re.fullmatch(r"\s*(\d{1,3}(?:[.,]\d{1,6})?)\s*(?:mm)?\s*", text)
    if found is None:
        raise PalpError("the answer is not a depth in mm: type a number, as 4")
    depth_mm = float(found[1].replace(",", "."))
    if form == "choice" and all(abs(p.depth_m * 1e3 - depth_mm) > 1e-9 for p in phantoms):
        raise PalpError(f"the subject chooses one of {_listed(phantoms)}")
    if not 0.0 <= depth_mm <= LARGEST_MM:
        raise PalpError(f"a depth lies between 0 and {LARGEST_MM:g} mm, the phantom's height")
    return depth_mm


def nearest_depth(depth_mm: float, phantoms: Sequence[PlannedPhantom]) -> float:
    """Return the nearest of the phantoms' depths, m; of two as near the shallower."""
    return min(sorted(p.depth_m for p in phantoms), key=lambda d: abs(d * 1e3 - depth_mm))


def _listed(phantoms: Sequence[PlannedPhantom]) -> str:
    *most, last = (f"{depth_m * 1e3:g}" for depth_m in sorted(p.depth_m for p in phantoms))
    return f"{', '.join(most)} or {last} mm"
