"""``session.yaml`` read and written: every mistake is told with its line, and all of them at once."""

from __future__ import annotations

import datetime
import math
from collections.abc import Collection, Mapping
from pathlib import Path

import msgspec
import yaml

from palp_core.errors import PalpError
from palp_core.graph.description import yaml_tree
from palp_core.graph.description.yaml_tree import Entry, Scalar, Tree, parse_tree
from palp_core.graph.problems import GraphProblems, Mark, Problem, Problems, hint
from palp_core.palpation.session.sheet.identity import subject_code
from palp_core.palpation.session.sheet.sheet import (
    BY_PALP,
    NONE,
    PhantomEntry,
    SensorEntry,
    SessionSheet,
)
from palp_core.whole_file import read_whole

MEANING = {
    "lab": "where the session is run",
    "operator": "who runs it: initials or a code",
    "subject": "code of who is measured, as S01; none where nobody is",
    "ethics": "id of the approval; none where nobody is measured",
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

_MAY_BE_EMPTY = ("note",)
_HOTTEST_C, _LARGEST_N_M = 200.0, 10.0


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
    found = _Reader(Mark(file, 1, 1), problems).sheet(tree, codes, by_hand=by_hand)
    problems.raise_any()
    return found


def sheet_text(sheet: SessionSheet) -> str:
    """Return a sheet as YAML that :func:`read_sheet` reads."""
    plain = msgspec.to_builtins(sheet)
    if sheet.sensor is None:
        del plain["sensor"]
    text: str = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=2**31)
    return text


def parse_copy(text: str, where: str) -> SessionSheet:
    """Return the sheet that palp wrote beside a session."""
    try:
        return msgspec.convert(yaml.safe_load(text), SessionSheet)
    except (yaml.YAMLError, msgspec.ValidationError) as error:
        raise PalpError(f"{where}: the session's sheet is damaged: {' '.join(str(error).split())}") from error


class _Reader:
    """Reads values and collects what is wrong with them."""

    def __init__(self, top: Mark, problems: Problems) -> None:
        self._top, self._problems = top, problems

    def sheet(self, tree: Tree | None, codes: Collection[str], *, by_hand: bool) -> SessionSheet:
        sensor = [] if by_hand else ["sensor"]
        known = ["lab", "operator", "subject", "ethics", "phantoms", *sensor, "note"]
        ignored = (*BY_PALP, "sensor") if by_hand else BY_PALP
        items = self._mapping(tree, self._top, "the sheet", known, ignored=ignored)
        lab, operator = (self._text(items, name) for name in ("lab", "operator"))
        subject = self._subject(items)
        if by_hand and subject == NONE:
            self._problems.add(items["subject"].value.mark, "a person is measured: give the subject's code")
        ethics = self._text(items, "ethics")
        if ethics == NONE and subject not in (NONE, ""):
            self._problems.add(
                items["ethics"].mark,
                f"a subject ({subject}) is measured under an approval: give its id, or subject: none",
            )
        note = self._text(items, "note")
        phantoms = self._phantoms(items, codes)
        return SessionSheet(
            lab=lab, operator=operator, subject=subject, ethics=ethics, phantoms=phantoms,
            sensor=self._sensor(items), note=note,
        )  # fmt: skip

    def _mapping(
        self,
        tree: Tree | None,
        mark: Mark,
        what: str,
        known: Collection[str],
        *,
        ignored: Collection[str] = (),
    ) -> dict[str, Entry]:
        """Return the entries of a mapping by name; what is unknown or missing is noted."""
        if not isinstance(tree, yaml_tree.Mapping):
            keys = ", ".join(known)
            self._problems.add(tree.mark if tree is not None else mark, f"{what} needs the keys {keys}")
            return {}
        for name, entry in tree.items.items():
            if name not in (*known, *ignored):
                self._problems.add(entry.mark, f"{what} has no key '{name}'{hint(name, known)}")
        for name in known:
            if name not in tree.items and name not in _MAY_BE_EMPTY:
                self._problems.add(tree.mark, f"{what} lacks '{name}': {_meaning(what, name)}")
        return {name: entry for name, entry in tree.items.items() if name in known}

    def _text(self, items: Mapping[str, Entry], name: str, what: str = "the sheet") -> str:
        if name not in items:
            return ""
        value = items[name].value
        if not isinstance(value, Scalar):
            self._problems.add(value.mark, f"'{name}' is one text: {_meaning(what, name)}")
            return ""
        text = "" if value.value is None else value.text.strip()
        if not text and name not in _MAY_BE_EMPTY:
            self._problems.add(value.mark, f"'{name}' is still to be filled in: {_meaning(what, name)}")
        return text

    def _number(self, items: Mapping[str, Entry], name: str, what: str, low: float, high: float) -> float:
        if name not in items:
            return math.nan
        value = items[name].value
        if isinstance(value, Scalar) and value.value is None:
            self._problems.add(value.mark, f"'{name}' is still to be filled in: {_meaning(what, name)}")
            return math.nan
        number = value.value if isinstance(value, Scalar) else None
        if isinstance(number, bool) or not isinstance(number, int | float) or not low <= number <= high:
            self._problems.add(
                value.mark, f"'{name}' is a number from {low:g} to {high:g}: {_meaning(what, name)}"
            )
            return math.nan
        return float(number)

    def _subject(self, items: Mapping[str, Entry]) -> str:
        subject = self._text(items, "subject")
        if subject not in ("", NONE):
            try:
                return subject_code(subject)
            except PalpError as error:
                self._problems.add(items["subject"].value.mark, f"{error}; none where nobody is measured")
        return subject

    def _phantoms(self, items: Mapping[str, Entry], codes: Collection[str]) -> dict[str, PhantomEntry]:
        if "phantoms" not in items:
            return {}
        entry = items["phantoms"]
        if not isinstance(entry.value, yaml_tree.Mapping):
            self._problems.add(
                entry.value.mark, "'phantoms' has an entry per phantom, by its code, as A: {...}"
            )
            return {}
        found = {}
        for code, one in entry.value.items.items():
            if codes and code not in codes:
                self._problems.add(one.mark, f"the run has no phantom '{code}'{hint(code, codes)}")
            fields = self._mapping(one.value, one.mark, "phantoms", PhantomEntry.__struct_fields__)
            found[code] = PhantomEntry(
                id=self._text(fields, "id", "phantoms"),
                batch=self._text(fields, "batch", "phantoms"),
                cured=self._day(fields, "cured"),
                cure_temperature_c=self._number(fields, "cure_temperature_c", "phantoms", -50.0, _HOTTEST_C),
            )
        for code in codes:
            if code not in found:
                self._problems.add(entry.mark, f"'phantoms' lacks '{code}', which the run uses")
        return found

    def _day(self, fields: Mapping[str, Entry], name: str) -> str:
        text = self._text(fields, name, "phantoms")
        try:
            return text and datetime.date.fromisoformat(text).isoformat()
        except ValueError:
            self._problems.add(fields[name].value.mark, f"'{name}: {text}' is no day; write it as 2026-03-01")
            return ""

    def _sensor(self, items: Mapping[str, Entry]) -> SensorEntry | None:
        if "sensor" not in items:
            return None
        entry = items["sensor"]
        fields = self._mapping(entry.value, entry.mark, "sensor", SensorEntry.__struct_fields__)
        return SensorEntry(
            serial=self._text(fields, "serial", "sensor"),
            bias_n_m=self._number(fields, "bias_n_m", "sensor", -_LARGEST_N_M, _LARGEST_N_M),
        )


def _meaning(what: str, name: str) -> str:
    return MEANING[name if what == "the sheet" else f"{what}.{name}"]
