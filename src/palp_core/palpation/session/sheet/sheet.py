"""``session.yaml``: what a session's sheet says, the template to fill in, and every mistake with its line."""

from __future__ import annotations

import datetime
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import msgspec
import yaml

from palp_core.errors import PalpError, in_words
from palp_core.graph.description import yaml_tree
from palp_core.graph.description.yaml_tree import Entry, Scalar, Tree, parse_tree
from palp_core.graph.problems import GraphProblems, Mark, Problem, Problems, hint
from palp_core.palpation.session.sheet.identity import subject_code
from palp_core.whole_file import read_whole

NONE = "none"
"""In place of a subject or an approval that there is none of."""


class PhantomEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A phantom as it was made."""

    id: str
    batch: str
    cured: str
    cure_temperature_c: float


class SensorEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The torque sensor, and what it reads with nothing on it."""

    serial: str
    bias_n_m: float


class SessionSheet(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Who, on whom, on what, by which approval; see :data:`MEANING`.

    ``software``, ``simulated`` (whether the touch was computed) and ``began`` (local time of the launch) are
    what palp finds at launch, whatever the file says.
    """

    lab: str
    operator: str
    subject: str = NONE
    ethics: str = NONE
    phantoms: dict[str, PhantomEntry] = {}
    sensor: SensorEntry | None = None
    note: str = ""
    software: dict[str, str] = {}
    simulated: bool = False
    began: str = ""


SIMULATED = SessionSheet(lab="simulation", operator=NONE, simulated=True)
"""The sheet of a simulated session that was given none."""

MEANING = {
    "lab": "where the session is run",
    "operator": "who runs it: initials or a code",
    "subject": "code of who is measured, as S01, never a name; none if no one is",
    "ethics": "id of the approval; none if no one is measured",
    "phantoms": "the phantoms by code",
    "sensor": "the torque sensor",
    "note": "anything else",
    "phantoms.id": "what is written on the phantom",
    "phantoms.batch": "batch of its silicone",
    "phantoms.cured": "day on which it was cured, as 2026-03-01",
    "phantoms.cure_temperature_c": "at which it was cured, degrees Celsius",
    "sensor.serial": "its serial number",
    "sensor.bias_n_m": "what it reads with nothing on it, N m",
}
"""Meaning of each key that a person fills in."""

_BY_PALP = ("software", "simulated", "began")
_MAY_BE_EMPTY = ("note",)
_NUMBERS = {"cure_temperature_c": (-50.0, 200.0), "bias_n_m": (-10.0, 10.0)}
"""The least and the largest value of each number."""


def template(codes: Sequence[str], *, by_hand: bool = False) -> str:
    """Return the sheet to fill in, for phantoms of these codes; where a person palpates, without a sensor."""
    lines = [
        "# The sheet of a session: fill in every line, then name it: palp launch "
        f"launch/{'human' if by_hand else 'rig'}.yaml session:=FILE",
        "# palp checks it before anything moves, and copies it to the record, the report, bags and exports.",
        *(_blank(name) for name in ("lab", "operator", "subject", "ethics")),
        "phantoms:",
    ]
    for code in codes:
        lines += [f"  {code}:", *(_blank(f"phantoms.{one}") for one in PhantomEntry.__struct_fields__)]
    if not by_hand:
        lines += ["sensor:", *(_blank(f"sensor.{one}") for one in SensorEntry.__struct_fields__)]
    return "\n".join([*lines, f'note: ""      # {MEANING["note"]}', ""])


def _blank(key: str) -> str:
    room, _, name = key.rpartition(".")
    indent = {"": "", "phantoms": "    ", "sensor": "  "}[room]
    return f"{indent + name + ':':<12}  # {MEANING[key]}"


def sheet_text(sheet: SessionSheet) -> str:
    """Return a sheet as YAML that :func:`read_sheet` reads."""
    plain = msgspec.to_builtins(sheet)
    if sheet.sensor is None:
        del plain["sensor"]
    text: str = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=2**31)
    return text


def parse_copy(text: str, where: str) -> SessionSheet:
    """Return the sheet that palp wrote next to a session."""
    try:
        return msgspec.convert(yaml.safe_load(text), SessionSheet)
    except (yaml.YAMLError, msgspec.ValidationError) as error:
        raise PalpError(
            f"{where}: the session's sheet is damaged: {' '.join(in_words(error).split())}"
        ) from error


def read_sheet(path: str | Path, codes: Collection[str] = (), *, by_hand: bool = False) -> SessionSheet:
    """Read a sheet that a person filled in.

    ``codes`` are those of the phantoms that the session will use: each must be there, and no other.
    ``by_hand``: a person palpates, so somebody is measured, and there is no torque sensor.
    """
    file = str(path)
    try:
        text = read_whole(path, yaml_tree.LARGEST_BYTES).decode()
    except OSError as error:
        raise PalpError(
            f"{file}: the session's sheet cannot be read: {error.strerror}; palp session new writes one"
        ) from error
    except UnicodeDecodeError as error:
        raise GraphProblems([Problem(file, 1, 1, "is not UTF-8 text; save it as UTF-8")]) from error
    problems = Problems()
    tree = parse_tree(text, file, problems)
    found = _Reader(problems).sheet(tree, Mark(file, 1, 1), codes, by_hand=by_hand)
    problems.raise_any()
    return msgspec.convert(found, SessionSheet)


class _Reader:
    """Reads values and collects what is wrong with them."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems

    def sheet(self, tree: Tree | None, top: Mark, codes: Collection[str], *, by_hand: bool) -> dict[str, Any]:
        unread = (*_BY_PALP, "sensor") if by_hand else _BY_PALP
        known = [name for name in SessionSheet.__struct_fields__ if name not in unread]
        items = self._mapping(tree, top, "", known, unread)
        rooms = {name: items.pop(name, None) for name in ("phantoms", "sensor")}
        found: dict[str, Any] = {name: self._cell(entry, "", name) for name, entry in items.items()}
        subject = found.get("subject", "")
        if by_hand and subject == NONE:
            self._problems.add(items["subject"].value.mark, "a person is measured: give the subject's code")
        if found.get("ethics") == NONE and subject not in (NONE, ""):
            self._problems.add(
                items["ethics"].mark,
                f"a subject ({subject}) is measured under an approval: give its id, or subject: none",
            )
        if (phantoms := rooms["phantoms"]) is not None:
            found["phantoms"] = self._phantoms(phantoms, codes)
        if (sensor := rooms["sensor"]) is not None:
            found["sensor"] = self._cells(sensor, "sensor", SensorEntry.__struct_fields__)
        return found

    def _phantoms(self, entry: Entry, codes: Collection[str]) -> dict[str, Any]:
        if not isinstance(entry.value, yaml_tree.Mapping):
            self._problems.add(
                entry.value.mark, "'phantoms' has an entry per phantom, by its code, as A: {...}"
            )
            return {}
        entries = entry.value.items
        for code in entries if codes else ():
            if code not in codes:
                self._problems.add(entries[code].mark, f"the run has no phantom '{code}'{hint(code, codes)}")
        for code in codes:
            if code not in entries:
                self._problems.add(entry.mark, f"'phantoms' lacks '{code}', which the run uses")
        fields = PhantomEntry.__struct_fields__
        return {code: self._cells(one, "phantoms", fields) for code, one in entries.items()}

    def _cells(self, entry: Entry, room: str, known: Collection[str]) -> dict[str, Any]:
        items = self._mapping(entry.value, entry.mark, room, known)
        return {name: self._cell(one, room, name) for name, one in items.items()}

    def _mapping(
        self, tree: Tree | None, mark: Mark, room: str, known: Collection[str], unread: Collection[str] = ()
    ) -> dict[str, Entry]:
        """Return the entries of a mapping by name; what is unknown or missing is noted."""
        what = room or "the sheet"
        if not isinstance(tree, yaml_tree.Mapping):
            keys = ", ".join(known)
            self._problems.add(tree.mark if tree is not None else mark, f"{what} needs the keys {keys}")
            return {}
        for name, entry in tree.items.items():
            if name not in (*known, *unread):
                self._problems.add(entry.mark, f"{what} has no key '{name}'{hint(name, known)}")
        for name in known:
            if name not in tree.items and name not in _MAY_BE_EMPTY:
                self._problems.add(tree.mark, f"{what} lacks '{name}': {_meaning(room, name)}")
        return {name: entry for name, entry in tree.items.items() if name in known}

    def _cell(self, entry: Entry, room: str, name: str) -> Any:
        """Return a text or a number, after noting what is wrong with it."""
        value, why = entry.value, ""
        text = ("" if value.value is None else value.text.strip()) if isinstance(value, Scalar) else ""
        if name in _NUMBERS and text:
            (low, high), number = _NUMBERS[name], value.value  # type: ignore[union-attr]
            if not isinstance(number, bool) and isinstance(number, int | float) and low <= number <= high:
                return float(number)
            why = f"'{name}' is a number from {low:g} to {high:g}: {_meaning(room, name)}"
        elif not isinstance(value, Scalar):
            why = f"'{name}' is one text: {_meaning(room, name)}"
        elif not text and name not in _MAY_BE_EMPTY:
            why = f"'{name}' is still to be filled in: {_meaning(room, name)}"
        elif name == "cured":
            try:
                return datetime.date.fromisoformat(text).isoformat()
            except ValueError:
                why = f"'{name}: {text}' is no day; write it as 2026-03-01"
        elif name == "subject" and text != NONE:
            try:
                return subject_code(text)
            except PalpError as error:
                why = f"{error}; none if no one is measured"
        if why:
            self._problems.add(value.mark, why)
        return text


def _meaning(room: str, name: str) -> str:
    return MEANING[f"{room}.{name}" if room else name]
