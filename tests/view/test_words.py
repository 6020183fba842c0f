"""What a viewer prints is bounded, and nobody who prints waits for whoever reads."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator

import pytest

from palp_core.view.server.words import MOST_CHARACTERS, Words, unhurried_words

LINE = "x" * 99 + "\n"
MANY = 20_000
"""Lines: 2 MB, far more than a pipe takes."""


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


def test_who_prints_does_not_wait_for_a_pipe_that_nobody_reads(pipe: tuple[int, int]) -> None:
    words = Words(pipe[1])
    for _ in range(MANY):
        words.write(LINE)
    assert words._waiting_count <= MOST_CHARACTERS
    words.finish()  # what fits into the pipe is there; the rest is nobody's


def test_what_is_too_much_is_left_out_and_told(pipe: tuple[int, int]) -> None:
    words = Words(pipe[1], period_s=3600.0)
    for _ in range(MANY):
        words.write(LINE)
    words._begun_ns -= round(3600e9)  # an hour later
    said = b""
    while said.count(b"\n") < MOST_CHARACTERS // len(LINE):
        said += os.read(pipe[0], 1 << 16)
    words.write("the last\n")
    while not said.endswith(b"the last\n"):
        said += os.read(pipe[0], 1 << 16)
    *_, told, last = said.decode().splitlines()
    assert (told, last) == (
        f"palp view: {MANY - MOST_CHARACTERS // len(LINE)} more texts were not printed",
        "the last",
    )
    words.finish()


def test_what_libraries_log_goes_the_same_way(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    with os.fdopen(os.dup(pipe[1]), "w") as before, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", before)
        with unhurried_words():
            log = logging.Logger("a library")
            log.addHandler(logging.StreamHandler())
            log.warning("a word")
        assert sys.stderr is before
        assert os.read(pipe[0], 100) == b"a word\n"
