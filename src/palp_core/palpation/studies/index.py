"""The index of studies in folders beside each other: picture, question, answer, date, command."""

from __future__ import annotations

from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

import msgspec

from palp_core.errors import PalpError
from palp_core.palpation.reporting.html_page import write_page
from palp_core.palpation.studies.catalogue import STUDIES, Study, studies
from palp_core.whole_file import read_whole, write_json

NOTE = "study.json"
_MARK = 'name="generator" content="palp study index"'


class StudyNote(msgspec.Struct, frozen=True, kw_only=True):
    """What a study's folder says of its run.

    Attributes:
        name: Of the study.
        date: When it ended, local time.
        command: That runs it again.
        version: Of palp.
        quick: Whether it was a try, which is no result.
    """

    name: str
    date: str
    command: str
    version: str
    quick: bool = False


@dataclass(frozen=True)
class IndexCard:
    """A study on the index.

    Attributes:
        note: Of its run.
        folder: Its folder's name.
        question: What it asks.
        answer: The first sentences of its page.
        picture: File of the chart that stands for it; empty: it has none.
        alt: What that shows.
    """

    note: StudyNote
    folder: str
    question: str
    answer: str
    picture: str
    alt: str


def write_note(out: Path, note: StudyNote) -> None:
    """Write a study's note into its folder.

    Raises:
        OSError: It cannot be written.
    """
    write_json(out / NOTE, msgspec.to_builtins(note))


def write_index(folder: Path) -> Path:
    """Write ``index.html`` of the studies in a folder's folders, in the order of the catalogue.

    Returns:
        The page.

    Raises:
        PalpError: There is none, a note of one is damaged, or the folder has another page of that name.
    """
    notes = {path.parent.name: _read_note(path) for path in sorted(folder.glob(f"*/{NOTE}"))}
    if not notes:
        raise PalpError(
            f"'{folder}' has no folder with a study; `palp study run NAME --out {folder}/NAME` makes one"
        )
    page = folder / "index.html"
    if page.exists() and _MARK not in page.read_text(encoding="utf-8"):
        raise PalpError(
            f"{page} is the page of something else; name the folder that holds the studies' folders"
        )
    order = list(_known())
    entries = [
        _entry(folder, name, note)
        for name, note in sorted(notes.items(), key=lambda one: order.index(one[1].name))
    ]
    missing = [one for one in STUDIES.values() if one.name not in {entry.note.name for entry in entries}]
    return write_page(page, "index.html", entries=entries, missing=missing, folder=folder, mark=_MARK)


def _known() -> dict[str, Study]:
    return {**studies(), **STUDIES}


def _read_note(path: Path) -> StudyNote:
    try:
        note = msgspec.json.decode(read_whole(path), type=StudyNote)
    except (OSError, msgspec.DecodeError) as error:
        raise PalpError(f"{path} is no note of a study: {error}; run the study again") from error
    if note.name not in (known := _known()):
        raise PalpError(f"{path} names the study '{note.name}'; there are {', '.join(known)}")
    return note


def _entry(folder: Path, name: str, note: StudyNote) -> IndexCard:
    page = folder / name / "index.html"
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise PalpError(f"{page} is missing beside {NOTE}; run the study again: {note.command}") from error
    reader = _Page()
    reader.feed(text)
    study = _known()[note.name]
    picture = f"{study.picture}.png" if study.picture else ""
    shown = picture if picture and (folder / name / picture).exists() else ""
    return IndexCard(
        note,
        name,
        study.question,
        " ".join("".join(reader.lead).split()),
        shown,
        reader.alt.get(study.picture, ""),
    )


class _Page(HTMLParser):
    """Reads the answer off a page, its first lead, and the words for each of its pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.lead: list[str] = []
        self.alt: dict[str, str] = {}
        self._in_lead = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag == "p" and found.get("class") == "lead" and not self.lead:
            self._in_lead = True
        elif tag == "img":
            self.alt[str(found.get("data-name"))] = found.get("alt") or ""

    def handle_endtag(self, tag: str) -> None:
        self._in_lead = self._in_lead and tag != "p"

    def handle_data(self, data: str) -> None:
        if self._in_lead:
            self.lead.append(data)
