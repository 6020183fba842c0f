"""What a viewer prints is bounded, and never waits for a reader."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator

import pytest

from palp_core.view.server.stderr import MOST_CHARACTERS, NonBlockingStderr, nonblocking_stderr

LINE = "x" * 99 + "\n"
MANY = 20_000
"""Lines: 2 MB, far more than a pipe takes."""


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


@pytest.mark.parametrize("length", [len(LINE), 2**17])
def test_a_writer_does_not_wait_for_a_pipe_that_is_not_read(length: int, pipe: tuple[int, int]) -> None:
    stream = NonBlockingStderr(pipe[1])
    for _ in range(10):  # of one that was full for a while
        stream._taken_count = 0
        for _ in range(MANY // 10):
            stream.write("x" * length)
    assert stream._left_out > 0


def test_what_is_too_much_is_left_out_and_counted(pipe: tuple[int, int]) -> None:
    stream = NonBlockingStderr(pipe[1])
    printed = b""
    for _ in range(MANY):
        stream.write(LINE)
        if len(printed) < MOST_CHARACTERS // len(LINE) * len(LINE):
            printed += os.read(pipe[0], 1 << 16)
    assert printed == LINE.encode() * (MOST_CHARACTERS // len(LINE))
    stream._begun_ns -= round(3600e9)  # an hour later
    stream.write("the last\n")
    assert os.read(pipe[0], 1 << 16).decode().splitlines() == [
        f"palp view: {MANY - MOST_CHARACTERS // len(LINE)} more texts were not printed",
        "the last",
    ]


def test_what_libraries_log_goes_the_same_way(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    with os.fdopen(os.dup(pipe[1]), "w") as before, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", before)
        with nonblocking_stderr():
            log = logging.Logger("a library")
            log.addHandler(logging.StreamHandler())
            log.warning("a word")
        assert sys.stderr is before
        assert os.read(pipe[0], 100) == b"a word\n"
