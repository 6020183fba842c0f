"""Who is measured: codes instead of names, and whose muscles an amplifier's are.

No rule separates every name from every code. What is refused is what a code never needs and a name nearly
always has: a run of letters that is no usual abbreviation, a blank, an address, a date of birth. No message
repeats what was typed: it may be a name, and messages are logged.
"""

import re
from typing import Literal

from palp_core.errors import PalpError

Source = Literal["person", "emulator", "file", "simulated"]
"""Whose muscles: a person's by an amplifier, an emulated amplifier's, a recording's, a simulation's."""

_FORM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._/-]{0,31}")
_LONGEST_LETTERS = 2
_USUAL = {
    *("sub", "subj", "subject", "part", "participant", "pilot", "test", "ctrl", "ref", "case", "proband"),
    *("consent", "ethics", "irb", "rec", "hrec", "lrs", "dorian", "study", "exp"),
}
"""Longer runs of letters that are no name."""

_DATE = re.compile(r"\d{6,}|\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
HOW = "use a code as S01 or P-07, and keep the list of names elsewhere"


def subject_code(text: str) -> str:
    """Return a subject's code without the blanks around it.

    >>> subject_code(" S01 ")
    'S01'
    """
    code = _checked(text, "the subject's code")
    if _DATE.search(code):
        raise PalpError(f"the subject's code looks like a date or a number that leads to a person; {HOW}")
    return code.replace("/", "-")


def consent_id(text: str) -> str:
    """Return the id of a consent form without the blanks around it; it may have a date.

    >>> consent_id("LRS-14/15-0703")
    'LRS-14/15-0703'
    """
    return _checked(text, "the consent's id")


def _checked(text: str, what: str) -> str:
    code = text.strip()
    if not code:
        raise PalpError(f"{what} is empty; {HOW}")
    if not _FORM.fullmatch(code):
        raise PalpError(
            f"{what} has blanks or signs that a code does not have, as names and addresses do: letters, "
            f"digits, '.', '_', '-' and '/' only, 32 at most; {HOW}"
        )
    words = re.findall(r"[A-Za-z]+", code)
    if any(len(word) > _LONGEST_LETTERS and word.lower() not in _USUAL for word in words):
        raise PalpError(f"{what} looks like a name: it has a word in it; {HOW}")
    if not re.search(r"\d", code):
        raise PalpError(f"{what} has no digit, so it may be initials; {HOW}")
    return code


_AMPLIFIERS = ("noraxon", "lsl")


def source_of(amplifier: str, host: str = "") -> Source:
    """Return whose muscles those of an amplifier are.

    >>> source_of("noraxon", "192.168.1.20"), source_of("noraxon", "127.0.0.1"), source_of("")
    ('person', 'emulator', 'simulated')

    ``amplifier`` is the argument ``emg`` of ``launch/human.yaml``; one on this ``host`` is an emulator.
    """
    if amplifier in ("emulator", "file"):
        return "emulator" if amplifier == "emulator" else "file"
    if amplifier not in _AMPLIFIERS:
        return "simulated"
    here = host == "localhost" or host.startswith("127.") or host == "::1"
    return "emulator" if amplifier == "noraxon" and here else "person"
