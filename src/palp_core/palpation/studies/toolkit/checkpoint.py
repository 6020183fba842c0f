"""Results as lines of a file, each written when it is there: a run that was stopped goes on where it was."""

import hashlib
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from palp_core import palpation
from palp_core.whole_file import append_whole

_SOURCES = ("mechanics/**/*.py", "nano17.py", "perception/**/*.py", "studies/**/*.py")


def read_lines(file: Path) -> list[str]:
    """Return the lines of a file, none if there is no such file."""
    return file.read_text(encoding="utf-8", errors="replace").splitlines() if file.exists() else []


@cache
def source_digest() -> str:
    """Return a digest of the source that results come from: changed code never reads an old result."""
    total = hashlib.sha256()
    root = Path(palpation.__file__).parent
    for path in sorted(one for pattern in _SOURCES for one in root.glob(pattern)):
        total.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


class Checkpoint:
    """Results of jobs in a file of JSON lines, by what the job is and by the source it was run with.

    Attributes:
        file: The file; made with its folder when the first result comes.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._found = dict(_known(read_lines(file)))

    def __contains__(self, job: object) -> bool:
        return _key(job) in self._found

    def __len__(self) -> int:
        return len(self._found)

    def __getitem__(self, job: object) -> Any:
        """Return a job's result, as JSON gives it back."""
        return self._found[_key(job)]

    def add(self, job: object, result: Any) -> Any:
        """Keep a result, and return it as it will be read: plain dicts, lists and numbers.

        Args:
            job: Its ``repr`` says all that the result depends on, and the same in every process.
            result: What JSON can hold; NaN too.
        """
        line = json.dumps({"code": source_digest(), "job": _key(job), "result": result})
        self.file.parent.mkdir(parents=True, exist_ok=True)
        append_whole(self.file, f"{line}\n")
        self._found[_key(job)] = json.loads(line)["result"]
        return self[job]


def _key(job: object) -> str:
    return hashlib.sha256(repr(job).encode()).hexdigest()


def _known(lines: Iterable[str]) -> Iterable[tuple[str, Any]]:
    """Give job and result of every line that is whole and of this source."""
    for line in lines:
        try:
            one = json.loads(line)
            if one["code"] == source_digest():
                yield one["job"], one["result"]
        except (ValueError, KeyError, TypeError):
            continue
