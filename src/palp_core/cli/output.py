"""How verbs speak: lines on standard output, notes on standard error, JSON for machines."""

import codecs
import io
import json
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from palp_core.errors import PalpError

LONGEST_LINE = 100
_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}


def escape_foreign_characters() -> None:
    """Let standard output and error write a character that their encoding lacks with the escape of JSON."""

    def escape(error: UnicodeError) -> tuple[str, int]:
        if not isinstance(error, UnicodeEncodeError):
            raise error
        return json.dumps(error.object[error.start : error.end])[1:-1], error.end

    codecs.register_error("json", escape)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="json")


def escape_controls(text: str) -> str:
    r"""Return text with its control characters, which a terminal obeys, written out.

    >>> escape_controls("cleared: \x1b[2J")
    'cleared: \\x1b[2J'
    """
    return text.translate(_ESCAPES)


def own_stream(stream: Any) -> Any:
    """Return where palp itself writes while a standard stream is that of composed nodes."""
    return getattr(stream, "launcher_stream", stream)


def print_text(text: str) -> None:
    """Write a line to standard output, unwrapped."""
    own_stream(sys.stdout).write(escape_controls(text) + "\n")


def print_json(value: Any) -> None:
    """Write a value as one line of JSON; NaN and infinity, which JSON lacks, become null."""
    from palp_core.whole_file import encode_json

    print_text(encode_json(value).decode())


def show(value: Any, lines: Iterable[str], *, as_json: bool) -> None:
    """Print a value as JSON, or else lines of text."""
    if as_json:
        print_json(value)
        return
    for line in lines:
        print_text(line)


def print_wrapped(text: str, indent: int = 0) -> None:
    """Write a paragraph in lines as wide as the terminal, 100 characters at most; all but the first hang."""
    width = min(shutil.get_terminal_size().columns, LONGEST_LINE)
    wrap = textwrap.TextWrapper(
        width,
        initial_indent=" " * indent,
        subsequent_indent=" " * (indent + 2),
        break_long_words=False,
        break_on_hyphens=False,
    )
    print_text(wrap.fill(text))


def note(text: str, colour: str = "") -> None:
    """Write a line to standard error: what a reader of the output itself is not to see."""
    line = escape_controls(text)
    error = own_stream(sys.stderr)
    if colour and error.isatty():
        import typer

        line = typer.style(line, fg=colour)
    error.write(line + "\n")
    error.flush()


def make_folder(out: Path) -> None:
    """Make the folder that ``--out`` names, and those above it, before hours of work rather than after."""
    import tempfile

    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except FileExistsError as error:
        raise PalpError(f"--out {out}: is a file, not a folder") from error
    except OSError as error:
        raise PalpError(f"--out {out}: cannot be written: {error.strerror}") from error


def table_lines(rows: Iterable[Sequence[str]]) -> list[str]:
    cells = [list(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)] if cells else []
    return ["  ".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]


def print_table(rows: Iterable[Sequence[str]]) -> None:
    for line in table_lines(rows):
        print_text(line)


def yaml_text(value: Any, *, flow: bool = False) -> str:
    """Return a value as YAML: mappings as blocks and lists of plain values inline, or all of it inline."""
    import yaml

    class Dumper(yaml.SafeDumper):
        def represent_sequence(
            self, tag: str, sequence: Iterable[Any], flow_style: bool | None = None
        ) -> yaml.SequenceNode:
            items = list(sequence)
            inline = flow or not any(isinstance(item, list | dict) for item in items)
            return super().represent_sequence(tag, items, flow_style=inline)

    text: str = yaml.dump(
        value, Dumper=Dumper, sort_keys=False, default_flow_style=flow, width=2**31, allow_unicode=True
    )
    return text.removesuffix("...\n")
