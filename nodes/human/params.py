"""What a session with a person is set to do, what its node remembers, and its design."""

from typing import Literal

import msgspec

from msgs.emg import EmgBlock
from palp_core import Params, ReadOnly, State
from palp_core.errors import PerceptionError
from palp_core.graph.node.node import Mistakes
from palp_core.palpation.mechanics.scene.phantom_file import load_phantoms
from palp_core.palpation.mechanics.scene.sealed import is_sealed, own_codes, require_sealable, sealed_phantoms
from palp_core.palpation.session.human.blinding import key_of
from palp_core.palpation.session.human.plan import HumanDesign
from palp_core.palpation.session.human.questions import AnswerForm
from palp_core.palpation.session.plan import PlannedPhantom
from palp_core.palpation.session.sheet.identity import Source, consent_id, source_of, subject_code
from palp_core.units import Count, CountPositive, HertzPositive, Kilograms, Seconds, SecondsPositive

DESIGN = (
    "order", "subject_number", "seed", "repeats", "limit_s", "rest_s", "quiet_s", "mvc_s", "mvc_tries",
)  # fmt: skip
"""Parameters that are the design's numbers of that name."""


class HumanParams(Params):
    """Set in the launch file; see :class:`.HumanDesign` for the numbers.

    ``session`` names the session's sheet, which the report checks and copies. ``subject`` and ``consent`` are
    codes, asked of the operator where empty, but for a subject that the sheet names. ``amplifier``,
    ``host``: where the EMG comes from, by which it is known whether it is a person's. ``answer``: one of
    the phantoms' depths, or any depth in mm. ``blind``: in estimation phantoms have codes of unknown meaning,
    which is in ``key``.
    """

    out: ReadOnly[str] = "results"
    session: ReadOnly[str] = ""
    subject: ReadOnly[str] = ""
    consent: ReadOnly[str] = ""
    phantoms: ReadOnly[str] = ""
    blind: ReadOnly[bool] = False
    key: ReadOnly[str] = ""
    order: ReadOnly[Literal["paper", "counterbalanced"]] = "paper"
    subject_number: ReadOnly[CountPositive] = 1
    seed: ReadOnly[Count] = 1
    repeats: ReadOnly[CountPositive] = 5
    limit_s: ReadOnly[SecondsPositive] = 60.0
    rest_s: ReadOnly[Seconds] = 20.0
    quiet_s: ReadOnly[SecondsPositive] = 2.0
    mvc_s: ReadOnly[SecondsPositive] = 5.0
    mvc_kg: ReadOnly[Kilograms] = 5.0
    mvc_tries: ReadOnly[CountPositive] = 4
    answer: ReadOnly[AnswerForm] = "choice"
    amplifier: ReadOnly[str] = ""
    host: ReadOnly[str] = ""
    settle_s: SecondsPositive = 2.0
    countdown_hz: HertzPositive = 1.0

    @property
    def source(self) -> Source:
        """Whose muscles these are; what is not named is not taken for a person's."""
        return source_of(self.amplifier, self.host)


class HumanState(State):
    """What a replacement inherits: the plan's replies, what is asked, and the step under way.

    ``stage`` of a step: "" before it, ``ready`` until the operator begins it, ``begin``, ``running``,
    ``over``, ``settling`` until the last samples are there, ``settled``; or ``asked`` and ``answered``.
    ``doing``: the phase of the muscles, or what is asked for.
    """

    words: list[str] = []
    subject: str = ""
    consent: str = ""
    asked: Count = 0
    kind: str = "none"
    choices: list[str] = []
    stage: str = ""
    doing: str = ""
    begin_ns: int = 0
    end_ns: int = 0
    limit_ns: int = 0
    ended_by: str = ""
    palpated_ns: int = 0
    answer_mm: float = 0.0
    answered_by: str = ""
    blocks: list[EmgBlock] = []
    rest: list[EmgBlock] = []
    rest_ns: list[int] = []
    largest_v: tuple[float, float] = (0.0, 0.0)
    emg: str = ""
    lost_count: int = 0
    clipped_count: int = 0
    phantom: str = ""
    again: list[tuple[str, int]] = []
    row: int = 0
    finished: bool = False


def begin_step_again(state: HumanState) -> None:
    """Let the step under way begin again, as operator and devices do: nothing of it has been done."""
    state.stage = state.doing = state.phantom = ""
    state.kind, state.blocks = "none", []


def phantoms_of(params: HumanParams) -> tuple[tuple[PlannedPhantom, ...], tuple[str, ...]]:
    """Return own code and depth of each phantom with a bead; and the codes of a blinded estimation."""
    if not params.blind:
        found = load_phantoms(params.phantoms)
        return tuple(PlannedPhantom(code, one.bead.depth_m) for code, one in found.items() if one.bead), ()
    key = key_of(params.phantoms, params.key)
    own, sealed = own_codes(key), sealed_phantoms(key)
    known = {own[code]: one.bead.depth_m for code, one in sealed.items() if one.bead}
    return tuple(PlannedPhantom(code, known[code]) for code in sorted(known)), tuple(sorted(sealed))


def design_of(params: HumanParams) -> HumanDesign:
    """Return the numbers of the session.

    Raises:
        MechanicsError: The phantoms' file cannot be used.
        PerceptionError: The numbers do not fit together.
    """
    phantoms, sealed = phantoms_of(params)
    given = {name: getattr(params, name) for name in DESIGN}
    return HumanDesign(phantoms=phantoms, sealed=sealed, mass_kg=params.mvc_kg, **given)


def find_mistakes(params: HumanParams, mistakes: Mistakes) -> None:
    """Add what is wrong with the session asked for, by parameter; no message repeats a code."""
    for name, check in (("subject", subject_code), ("consent", consent_id)):
        with mistakes.of(name):
            if text := getattr(params, name):
                check(text)
    if params.blind:
        _find_blind_mistakes(params, mistakes)
    if mistakes:
        return
    has_key = params.blind and is_sealed(params.phantoms)  # or it is still to be drawn, of the same numbers
    shown = msgspec.structs.replace(params, blind=has_key)
    with mistakes.of("phantoms"):
        phantoms_of(shown)
    with mistakes.of(""):
        design_of(shown)


def _find_blind_mistakes(params: HumanParams, mistakes: Mistakes) -> None:
    """Add why a session cannot be blinded; nothing is drawn."""
    if params.order == "paper":
        mistakes["order"] = "order:=paper is published, so it cannot be blind; use counterbalanced"
    if is_sealed(params.phantoms):
        return
    with mistakes.of("phantoms"):
        if params.source != "simulated":
            raise PerceptionError(
                "codes of real phantoms are given by a person who takes no part: "
                "palp session seal KEY, phantoms:=KEY"
            )
        require_sealable(load_phantoms(params.phantoms))
