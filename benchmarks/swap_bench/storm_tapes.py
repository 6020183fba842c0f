"""What the processes of a storm have written down, and what of it is a fault of palp's.

A number that never came, came twice or out of order counts against palp, unless the fault itself destroyed
what only the killed process held: then it is ``explained``. That is so of

- the last numbers of a source that was killed, which no relay has had,
- the last numbers that a killed relay passed on, if it had handed over nothing to another,
- what came for a best-effort reader from its death (or from when it was stopped, so long that palp has
  given it up) until its next process was there,
- the one number that a kill interrupted, which is taken up again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

LIFE, INDEX, BY, READER, AT_NS = range(5)
"""Columns: life of the source, number in it, process that sent or passed it on; of readers their own process
and when they had it."""

COLUMNS = {"sent": 3, "passed": 3, "born": 1}
BITS = 40  # of a key, for the index; the rest says which life

Rows = np.ndarray[Any, np.dtype[np.int64]]


def read_tape(folder: Path, name: str) -> Rows:
    """Return a tape's rows, shape (count, columns); a row that is being written is not there yet."""
    columns = COLUMNS.get(name, 5)
    try:
        raw = np.fromfile(folder / name, dtype=np.int64)
    except FileNotFoundError:
        raw = np.empty(0, dtype=np.int64)
    return raw[: len(raw) // columns * columns].reshape(-1, columns)


@dataclass(frozen=True)
class Deaths:
    """Who was killed in the turn that is judged.

    Attributes:
        pids: Processes that were killed.
        handed_over: Processes whose work another goes on with, killed or not.
        all_ended: The launcher was killed, and everything with it.
    """

    pids: frozenset[int] = frozenset()
    handed_over: frozenset[int] = frozenset()
    all_ended: bool = False

    def __or__(self, other: Deaths) -> Deaths:
        return Deaths(self.pids | other.pids, self.handed_over | other.handed_over, other.all_ended)


@dataclass
class Verdict:
    """What one reader got of the numbers of a turn.

    Attributes:
        lost, repeated, reordered: How many without an excuse.
        explained: How many were lost or came twice because the fault destroyed what only one process held.
        silence_ms: The longest time without a number.
        examples: Life, index and process of the first few that count against palp, by what is wrong.
    """

    lost: int = 0
    repeated: int = 0
    reordered: int = 0
    explained: int = 0
    silence_ms: float = 0.0
    examples: dict[str, list[list[int]]] = field(default_factory=dict)

    @property
    def faults(self) -> int:
        """How much counts against palp."""
        return self.lost + self.repeated + self.reordered


class Judge:
    """Judges one reader turn by turn.

    Args:
        best_effort: It asks for nothing that it has missed.
    """

    def __init__(self, *, best_effort: bool = False) -> None:
        self._best_effort = best_effort
        self._sent_count = self._got_count = 0
        self._deaths = Deaths()  # of earlier turns too: what was sent before a reader is back is of the next

    def judge(self, sent: Rows, passed: Rows, got: Rows, deaths: Deaths) -> Verdict:
        """Judge what was sent and what came since the last turn; the rows are those since the launch."""
        deaths = self._deaths = self._deaths | deaths
        lives = np.unique(sent[:, LIFE])
        sent_keys, passed_keys, keys = (_keys(rows, lives) for rows in (sent, passed, got))
        new_sent, new_got = sent[self._sent_count :], self._got_count
        missing = ~np.isin(sent_keys[self._sent_count :], keys)
        verdict = Verdict(silence_ms=_silence_ms(got[max(new_got - 1, 0) :]))
        last = keys.max(initial=-1)
        for row in new_sent[missing]:
            key = int(_keys(row[None, :], lives)[0])
            if (deaths.all_ended and key > last) or self._is_destroyed(
                row, key, sent_keys, passed, passed_keys, got, keys, deaths
            ):
                verdict.explained += 1
            else:
                verdict.lost += 1
                _note(verdict, "lost", row)
        self._judge_order(verdict, got, keys, deaths)
        self._sent_count, self._got_count = len(sent), len(got)
        return verdict

    def _is_destroyed(
        self, row: Rows, key: int, sent_keys: Rows, passed: Rows, passed_keys: Rows, got: Rows, keys: Rows,
        deaths: Deaths,
    ) -> bool:  # fmt: skip
        makers = passed[passed_keys == key, BY]
        if not len(makers):
            of_life = passed_keys[passed_keys >> BITS == key >> BITS]
            return int(row[BY]) in deaths.pids and key > of_life.max(initial=-1)
        if self._best_effort and self._was_away(key, got, keys, deaths):
            return True
        maker = int(makers[-1])
        had_of_maker = keys[got[:, BY] == maker]
        dead = maker in deaths.pids and maker not in deaths.handed_over
        return dead and key > had_of_maker.max(initial=-1)

    @staticmethod
    def _was_away(key: int, got: Rows, keys: Rows, deaths: Deaths) -> bool:
        """Return whether a number came after the last of a killed reader and before its next one's first."""
        for pid in deaths.pids.intersection(got[:, READER].tolist()):
            end = int(np.flatnonzero(got[:, READER] == pid)[-1])
            if keys[end] < key and (end + 1 == len(keys) or key < keys[end + 1]):
                return True
        return False

    def _judge_order(self, verdict: Verdict, got: Rows, keys: Rows, deaths: Deaths) -> None:
        """Count what came again and what came after a later one."""
        highest = np.maximum.accumulate(keys) if len(keys) else keys
        for i in range(max(self._got_count, 1), len(keys)):
            if keys[i] > highest[i - 1]:
                continue
            before = np.flatnonzero(keys[:i] == keys[i])
            if not len(before):
                verdict.reordered += 1
                _note(verdict, "reordered", got[i])
            elif self._was_interrupted(got[before[-1]], got[i], keys[i] == highest[i - 1], deaths):
                verdict.explained += 1
            else:
                verdict.repeated += 1
                _note(verdict, "repeated", got[i])

    @staticmethod
    def _was_interrupted(first: Rows, again: Rows, is_last: bool, deaths: Deaths) -> bool:
        """Return whether a kill fell between a handler's deed and the note that it was done."""
        return is_last and any(
            first[who] != again[who] and int(first[who]) in deaths.pids for who in (BY, READER)
        )


def _keys(rows: Rows, lives: Rows) -> Rows:
    """Return one number per row that grows as lives and indices do."""
    return (np.searchsorted(lives, rows[:, LIFE]) << BITS) + rows[:, INDEX]


def _silence_ms(got: Rows) -> float:
    return float(np.diff(got[:, AT_NS]).max(initial=0)) / 1e6


def _note(verdict: Verdict, what: str, row: Rows) -> None:
    examples = verdict.examples.setdefault(what, [])
    if len(examples) < 10:
        examples.append(row.tolist())


def reached(got: Rows, life: int, index: int) -> bool:
    """Return whether a reader has come as far as a number."""
    return bool(len(got)) and tuple(got[-1, [LIFE, INDEX]].tolist()) >= (life, index)
