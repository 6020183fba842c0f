"""The blocks of a page of documentation, and how they are run as a reader would: in order, in one folder.

A block of ``sh``, ``python`` or ``yaml`` is run unless a comment directly before it gives a reason::

    <!-- not run: needs a rig -->

``sh`` is typed into bash, ``python`` given to the interpreter. A block of any language whose first line is
``# name.ext`` is a file: it is written, and other blocks use it. ``<!-- background -->`` before a block of
``sh`` keeps it running while the next ones run, as in a second terminal. A block of ``output`` is the output
of the block before: each of its lines must be in it, in this order; ``...`` is for what differs. After
``<!-- numbers differ -->`` a number of the page is any number, and a run of blanks any other.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.palp import PATIENCE_S, ROOT, Palp

RUN = ("sh", "python", "yaml")
_BLOCK = re.compile(r"^(?P<indent> *)```(?P<language>\w*)[^\n]*\n(?P<text>.*?)^(?P=indent)```$", re.M | re.S)
_COMMENT = re.compile(r"<!-- (?P<word>not run|background|numbers differ)(?:: (?P<why>[^\n]+?))? -->\n *\Z")
_NUMBER, _BLANKS = re.compile(r"\d+(?:\\\.\d+)?(?:e(?:\\-)?\d+)?"), re.compile(r"(?:\\ )+")
"""In a text that is escaped for a regular expression."""
_FILE = re.compile(r"\A# ([\w./-]+\.\w+)\n")
ALONE = ("docs/tutorial/", "docs/how_to/", "reference/")
"""Pages whose reader has an installed palp and no checkout."""
_WORKSPACE = ("launch", "nodes", "msgs", "examples")


@dataclass(frozen=True)
class Block:
    """One block.

    Attributes:
        line: Where it begins in its page.
        language: Of the page.
        text: Its content.
        why_not: Why it is not run; "": it is.
        background: It keeps running while the next ones run.
        numbers_differ: Each of its numbers stands for any other.
    """

    line: int
    language: str
    text: str
    why_not: str = ""
    background: bool = False
    numbers_differ: bool = False

    @property
    def file(self) -> str:
        """Name of the file that it is; "" if it is none."""
        named = _FILE.match(self.text)
        return named.group(1) if named else ""


def blocks(text: str) -> Iterator[Block]:
    """Yield the blocks of a page."""
    for found in _BLOCK.finditer(text):
        before, indent = text[: found.start()], found["indent"]
        comment = _COMMENT.search(before)
        inner = "".join(line.removeprefix(indent) for line in found["text"].splitlines(keepends=True))
        word = comment["word"] if comment else ""
        why_not = comment["why"] or "" if comment and word == "not run" else ""
        line = before.count("\n") + 1
        yield Block(line, found["language"], inner, why_not, word == "background", word == "numbers differ")


class Reader:
    """A reader who follows a page.

    Args:
        text: The page.
        name: Its path; a reader of :data:`ALONE` has an empty folder, others a checkout's.
        folder: The present folder.
        palp: Gives the environment.
    """

    def __init__(self, text: str, name: str, folder: Path, palp: Palp) -> None:
        self._text, self._name, self._folder, self._palp = text, name, folder, palp
        self._at = folder
        self._background: list[subprocess.Popen[str]] = []
        self._commands = folder.parent / f"{folder.name}_bin"
        self._commands.mkdir()
        folder.mkdir(exist_ok=True)
        for name_, words in (
            ("python", ""),
            ("palp", "-m palp_core"),
            ("pytest", "-m pytest -p no:cacheprovider"),
        ):
            command = self._commands / name_
            command.write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n', encoding="utf-8")
            command.chmod(0o755)
        for one in () if name.startswith(ALONE) else _WORKSPACE:
            shutil.copytree(
                ROOT / one, folder / one, ignore=shutil.ignore_patterns("__pycache__", "node_modules")
            )

    def read(self) -> dict[int, str]:
        """Run the whole page; return the output of each block by its line."""
        printed: dict[int, str] = {}
        last = ""
        try:
            for block in blocks(self._text):
                if block.why_not:
                    last = ""
                elif block.language == "output":
                    self._compare(block, last)
                elif block.file:
                    file = (self._at / block.file).resolve()
                    assert file.is_relative_to(self._folder.resolve()), f"{file} is not the reader's"
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_text(block.text, encoding="utf-8")
                elif block.language in RUN:
                    last = printed[block.line] = self._run(block)
        finally:
            self._end()
        return printed

    def _run(self, block: Block) -> str:
        where = f"{self._name}:{block.line}"
        assert block.language != "yaml", f"{where}: what file is it? begin it with '# name.yaml'"
        shell = block.language == "sh"
        place = self._commands / "place"  # a shell that changes its folder has done so for what follows
        typed = block.text if block.background else f"{block.text}\npwd > {place}"
        command = ["bash", "-eo", "pipefail", "-c", typed] if shell else [sys.executable, "-c", block.text]
        environment = {**self._palp.environment, "PATH": f"{self._commands}:{os.environ['PATH']}"}
        process = subprocess.Popen(
            command,
            cwd=self._at,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        if block.background:
            self._background.append(process)
            self._wait_for_graph(process)
            return ""
        printed, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, f"{where}: status {process.returncode}\n{block.text}\n{printed}"
        if shell:
            self._at = Path(place.read_text(encoding="utf-8").strip())
        return printed

    def _wait_for_graph(self, process: subprocess.Popen[str]) -> None:
        """Return once a graph runs."""
        while process.poll() is None:
            listed = self._palp.run("graph", "list", "--json")
            if listed.returncode == 0 and json.loads(listed.stdout or "[]"):
                return
        raise AssertionError(process.communicate()[0])

    def _compare(self, block: Block, printed: str) -> None:
        rest = iter(printed.splitlines())
        for wanted in filter(None, map(str.strip, block.text.splitlines())):
            form = ".*?".join(map(re.escape, wanted.split("...")))
            if block.numbers_differ:
                form = _BLANKS.sub(r"\\s+", _NUMBER.sub(r"\\d+(?:\\.\\d+)?(?:e-?\\d+)?", form))
            found = any(re.fullmatch(form, line.strip()) for line in rest)
            assert found, f"{self._name}:{block.line}: not printed: '{wanted}' in\n{printed}"

    def _end(self) -> None:
        """End what still runs in the background."""
        for process in self._background:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)
