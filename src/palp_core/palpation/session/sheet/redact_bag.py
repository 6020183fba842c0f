"""A bag of a session without what tells who it was: every text of it, in attachments and in messages."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from palp_core.errors import PalpError
from palp_core.graph.bag.edit import copy_messages
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.launch.summary import RunSummary
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.palpation.session.bag_record import launch_of
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.redact import FIELDS, REDACTED, redacted_sheet
from palp_core.palpation.session.sheet.sheet import NONE, SessionSheet
from palp_core.palpation.session.sheet.sheet_file import sheet_text

_LEAST_LETTERS = 3  # a shorter word is found by chance
_OF_PEOPLE = ("subject", "consent")
_PLACES = ("out", "session", "recording", "phantoms", "scene", "noise")
"""Parameters that name somebody, and those whose files may lie in somebody's folders."""


def redact_bag(path: Path, out: Path, fields: Sequence[str] = FIELDS) -> list[str]:
    """Copy a bag; no text of the copy has what its sheet says of people, nor where its files lay.

    Args:
        path: The bag, which stays as it is.
        out: The copy, which must not exist.
        fields: Of the sheet: each becomes ``redacted``.

    Returns:
        What is still told, in words; short words are taken out of the sheet alone.
    """
    if out.exists():
        raise PalpError(f"{out} is there already, and nothing is overwritten: name another, --out NAME")
    with Bag(path) as bag:
        launch = launch_of(bag)
        sheet = sheet_of(launch)
        if sheet is None:
            raise PalpError(f"{path}: has no sheet: nothing tells who it was")
        told = redacted_sheet(sheet, fields)
        words = _Words(launch, sheet, fields)
        try:
            _copy(bag, out, words, told)
        except BaseException:
            shutil.rmtree(out, ignore_errors=True)
            raise
    return list(words.still_in(out))


def _copy(bag: Bag, out: Path, words: _Words, sheet: SessionSheet) -> None:
    with BagWriter(out) as writer:
        for name, data in bag.attachments().items():
            plain = _with_sheet(data, sheet) if name == LAUNCH_ATTACHMENT else data
            writer.attach(name, words.out_of_bytes(plain))
        for name, values in bag.metadata().items():
            writer.add_metadata(name, {key: words.out_of(value) for key, value in values.items()})
        copy_messages((words.out_of_message(one) for one in bag.recorded()), writer)


def _with_sheet(data: bytes, sheet: SessionSheet) -> bytes:
    """Return the attachment about the launch with another sheet."""
    launch = json.loads(data)
    launch["attached"] = {**launch.get("attached", {}), SHEET: sheet_text(sheet)}
    return json.dumps(launch, indent=1).encode()


class _Words:
    """The words that a copy is not to have.

    Args:
        launch: What ran.
        sheet: As it was.
        fields: What is taken out of it.
    """

    def __init__(self, launch: RunSummary, sheet: SessionSheet, fields: Sequence[str]) -> None:
        given: list[Mapping[str, Any]] = [launch.args, *launch.params.values()]
        words = {str(getattr(sheet, name)) for name in fields}
        words |= {str(one[name]) for one in given for name in _OF_PEOPLE if one.get(name)}
        places = {str(one[name]) for one in given for name in _PLACES if one.get(name)}
        folders = {str(Path(place).parent) for place in (*places, launch.file)}
        self.words = sorted(one for one in words if one != NONE and len(one) >= _LEAST_LETTERS)
        found = {one for one in places | folders if "/" in one and len(one) > _LEAST_LETTERS}
        forms = sorted({form for one in found for form in _forms(one)}, key=len, reverse=True)
        named = sorted({form for one in self.words for form in _forms(one)}, key=len, reverse=True)
        parts = [*map(re.escape, forms), *(rf"(?<!\w){re.escape(one)}(?!\w)" for one in named)]
        self._sought = re.compile("|".join(parts)) if parts else None
        self._bytes = [one.encode() for one in (*forms, *named)]

    def out_of(self, text: str) -> str:
        """Return a text without them."""
        return text if self._sought is None else self._sought.sub(REDACTED, text)

    def out_of_bytes(self, data: bytes) -> bytes:
        """Return what may be a text without them."""
        return self.out_of(data.decode(errors="surrogateescape")).encode(errors="surrogateescape")

    def out_of_message(self, message: RecordedMessage) -> RecordedMessage:
        """Return a message none of whose texts has them."""
        if not any(one in message.payload for one in self._bytes):
            return message
        try:
            plain = self._out_of_value(msgspec.msgpack.decode(message.payload))
        except msgspec.MsgspecError as error:
            where = f"{message.stream.topic.name} {message.sequence}"
            raise PalpError(
                f"{where} has a word that the copy is not to have, and cannot be read: {error}"
            ) from error
        return message._replace(payload=msgspec.msgpack.encode(plain))

    def _out_of_value(self, value: Any) -> Any:
        if isinstance(value, str):
            return self.out_of(value)
        if isinstance(value, dict):
            return {self._out_of_value(key): self._out_of_value(one) for key, one in value.items()}
        if isinstance(value, bytes):
            return self._out_of_packed(value)
        return [self._out_of_value(one) for one in value] if isinstance(value, list) else value

    def _out_of_packed(self, data: bytes) -> bytes:
        """Return bytes that are themselves packed values, as a node's hand-over is, without them."""
        if not any(one in data for one in self._bytes):
            return data
        try:
            return msgspec.msgpack.encode(self._out_of_value(msgspec.msgpack.decode(data)))
        except msgspec.MsgspecError:  # something else: whether it has a word is looked at in the end
            return data

    def still_in(self, path: Path) -> Iterator[str]:
        """Yield where a bag still has one of the words."""
        sought = {
            word: re.compile(rb"(?<!\w)" + re.escape(word.encode()) + rb"(?!\w)") for word in self.words
        }
        with Bag(path) as bag:
            held = [(f"attachment {name}", data) for name, data in bag.attachments().items()]
            held += [(f"metadata {name}", repr(values).encode()) for name, values in bag.metadata().items()]
            seen = {(at, word) for at, data in held for word, one in sought.items() if one.search(data)}
            for said in bag.recorded():
                at = said.stream.topic.name
                seen |= {(at, word) for word, one in sought.items() if one.search(said.payload)}
        for at, word in sorted(seen):
            yield f"{at} still has '{word}'"


def _forms(text: str) -> tuple[str, str]:
    """Return a text as it stands, and as JSON has it in ASCII."""
    return text, json.dumps(text)[1:-1]
