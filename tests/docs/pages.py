"""The blocks of a page of documentation, and how they are run as a reader would: in order, in one folder.

A block of ``sh``, ``python`` or ``yaml`` is run unless a comment directly before it says why not::

    <!-- not run: needs a rig -->

``sh`` is typed into bash, ``python`` given to the interpreter. A block of any language whose first line is
``# name.ext`` is a file: it is written, and other blocks use it. ``<!-- beside -->`` before a block of ``sh``
has it go on while the next ones run, as in a second terminal. A block of ``output`` is what its reader sees
of the block before: each of its lines stands in the output, in this order; ``...`` is for what differs.
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
_COMMENT = re.compile(r"<!-- (?P<word>not run|beside)(?:: (?P<why>[^\n]+?))? -->\n *\Z")
_FILE = re.compile(r"\A# ([\w./-]+\.\w+)\n")
ALONE = ("docs/tutorial/", "docs/how_to/", "reference/")
"""Pages whose reader has an installed palp and no checkout."""
_WORKSPACE = ("launch", "nodes", "msgs", "examples")


@dataclass(frozen=True)
class Block:
    """One block.

    Attributes:
        line: Where it begins in its page.
        language: As the page says.
        text: What stands in it.
        why_not: Why it is not run; "": it is.
        beside: It goes on while the next ones run.
    """

    line: int
    language: str
    text: str
    why_not: str = ""
    beside: bool = False

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
        why_not = comment["why"] or "" if comment and comment["word"] == "not run" else ""
        beside = comment is not None and comment["word"] == "beside"
        yield Block(before.count("\n") + 1, found["language"], inner, why_not, beside)


class Reader:
    """Somebody who does what a page says.

    Args:
        text: The page.
        name: What it is called; who reads one of :data:`ALONE` has an empty folder, others a checkout's.
        folder: Where he is.
        palp: Whose environment he has.
    """

    def __init__(self, text: str, name: str, folder: Path, palp: Palp) -> None:
        self._text, self._name, self._folder, self._palp = text, name, folder, palp
        self._at = folder
        self._beside: list[subprocess.Popen[str]] = []
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
        """Do all that the page says; return by line what each block printed."""
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
        typed = block.text if block.beside else f"{block.text}\npwd > {place}"
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
        if block.beside:
            self._beside.append(process)
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
            form = re.compile(".*?".join(map(re.escape, wanted.split("..."))))
            found = any(form.fullmatch(line.strip()) for line in rest)
            assert found, f"{self._name}:{block.line}: nobody sees '{wanted}' of\n{printed}"

    def _end(self) -> None:
        """End what still runs beside."""
        for process in self._beside:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)
