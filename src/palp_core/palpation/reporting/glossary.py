"""The words of the pages that a reader cannot guess; a page explains those that it uses."""

from __future__ import annotations

import re
from html import unescape

WORDS = {
    r"r_a|ring positions?": (
        "r_a, ring position",
        "Position of the anchor ring in mm; it sets the stiffness of the joint: 0 is limp, 16 the stiffest.",
    ),
    r"probes?|palpations?|sweeps?": (
        "sweep, palpation, probe",
        "The probe is dragged once over the phantom. Counted in a trial, a probe is one such palpation.",
    ),
    r"phantoms?|nodules?|beads?": (
        "phantom, nodule",
        "A slab of silicone, and the hard bead in it at the depth d that is to be found.",
    ),
    r"trials?": ("trial", "Palpations of one nodule until the verdict: decided or undecided."),
    r"sessions?": (
        "session",
        "One training with the estimation after it. Its trials share training and mountings, so intervals "
        "over independent sessions are the ones that compare policies.",
    ),
    r"primitives?": (
        "memory primitives",
        "What training taught: the spread of readings at each depth and ring position.",
    ),
    r"posterior|beliefs?": (
        "posterior, belief",
        "The probability of each depth, given what was felt so far.",
    ),
    r"likelihoods?": (
        "likelihood",
        "How probable a reading would be at each depth, by what training taught.",
    ),
    r"calibration error": (
        "calibration error",
        "How far the stated probability of estimates is from the share that is right; 0 %: 90 % sure is "
        "right in 90 % of trials.",
    ),
    r"peak": ("peak", "The largest de-noised torque of a sweep, the feature that the paper reads."),
    r"contrast": (
        "contrast",
        "Peak less the torque beside the nodule; an error of height that shifts both cancels.",
    ),
    r"trace": ("trace", "The whole torque of a sweep, weighed sample by sample instead of by one feature."),
    r"naive": ("naive filter", "The paper's filter: every reading is taken for independent of the others."),
    r"latent\w*": (
        "latent filter",
        "Knows that some errors stay between readings (the ring's landing, the height, those of "
        "training), and weighs repeated readings accordingly. Latent ring, latent trial: only the landing, "
        "only what a trial shares.",
    ),
    r"fixed average": (
        "fixed average",
        "The mean over the five fixed ring positions, as the paper compares.",
    ),
    r"fixed best|best fixed": (
        "best fixed",
        "One ring position for all trials: the one that training's own palpations are best told apart at.",
    ),
    r"markov(?! \w)|human strategy": (
        "markov, human strategy",
        "The ring follows a chain of levels with the spectrum that was published of people's co-contraction.",
    ),
    r"markov permuted": (
        "markov permuted",
        "The average human chain with its levels assigned to other ring positions at random: same "
        "dynamics, other places.",
    ),
    r"markov reversed": ("markov reversed", "The average human chain run backwards in time."),
    r"markov stationary": (
        "markov stationary",
        "Independent draws with the average human chain's long-run shares: same places, no memory.",
    ),
    r"uniform": (
        "uniform",
        "Every ring position with equal probability; uniform stiff: of 8, 12 and 16 mm only.",
    ),
    r"information gain": (
        "information gain",
        "Chooses the ring position whose next reading is expected to tell most.",
    ),
    r"reposition best|re-?homed": (
        "reposition, re-homed",
        "The ring is driven away and back between palpations, so that its error is drawn anew.",
    ),
    r"front": ("front", "What nothing else beats in both: less error and less cost."),
    r"[Rr]ungs?|[Ll][0-5]": (
        "L0 to L5, rungs",
        "The ladder of contact models: L0 a replayed bump; L2 Hertz on a layer; L4 finite elements at small "
        "strain; L5 at finite strain.",
    ),
    r"co-contraction|MVC|EMG": (
        "co-contraction, MVC",
        "Both muscles of the forearm at once, from surface EMG, as a share of the maximal voluntary "
        "contraction (MVC).",
    ),
    r"lambda_2|λ₂": (
        "λ₂, lambda_2",
        "Second largest eigenvalue of a chain: how slowly it forgets where it began; 0 is at once.",
    ),
    r"Holm": (
        "Holm",
        "Correction of p for the number of comparisons, so that chance alone seldom finds one.",
    ),
    r"Wilson": ("Wilson's interval", "95 % interval of a share that is kept also near 0 and 100 %."),
    r"Wald|Fano|Chernoff": (
        "Wald, Fano, Chernoff",
        "Limits that no rule can pass with independent readings: of tests that stop, of information, of "
        "long runs.",
    ),
}
"""Word as a pattern, as the page writes it: its name, and what it means."""

_TAG = re.compile(r"<[^>]*>")


def words_of(body: str) -> list[tuple[str, str]]:
    """Return name and meaning of the words that a page uses, in the order of the alphabet."""
    text = unescape(_TAG.sub(" ", body))
    used = [entry for word, entry in WORDS.items() if _pattern(word).search(text)]
    return sorted(used, key=lambda entry: entry[0].lower())


def _pattern(word: str) -> re.Pattern[str]:
    """Return a word's pattern; one with capitals is meant as it stands: EMG is no node called emg."""
    return re.compile(rf"(?<!\w)(?:{word})(?!\w)", 0 if re.search("[A-Z]", word) else re.IGNORECASE)
