"""What is sealed says only what it is, and comes back as it was."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palp_core.sealing import opened, sealed

LINE = b"sealed by palp: not to be read\n"


@given(st.binary(max_size=2000))
def test_what_is_sealed_comes_back_as_it_was(body: bytes) -> None:
    assert opened(LINE, sealed(LINE, body)) == body


def test_it_shows_what_it_is_and_nothing_of_what_is_in_it() -> None:
    data = sealed(LINE, b"phantom A is 4 mm deep")
    assert data.startswith(LINE)
    assert b"phantom" not in data
    assert b"4 mm" not in data


@pytest.mark.parametrize("data", [b"", b"AAAA\n", b"\xff\xff", sealed(b"", b"depth")[:-6]])
def test_what_is_damaged_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        opened(LINE, LINE + data)
