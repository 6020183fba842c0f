"""Reliable edges between real processes under kill and theft: nothing is lost that is kept."""

from pathlib import Path

import pytest

from tests.support.palp import Palp
from tests.support.post import Post

ALL = list(range(1, 501))


@pytest.fixture
def post(palp: Palp, tmp_path: Path) -> Post:
    return Post(palp, tmp_path)


def test_a_killed_reader_goes_on_where_it_was_and_misses_nothing(post: Post) -> None:
    done = post.deliver("many", "kill")
    assert done.returncode == 0, done.stderr
    letters = post.letters()
    assert letters[:100] == ALL[:100]
    assert letters[100:] in (ALL[100:], [100, *ALL[100:]])  # the letter at which it died may come again
    assert post.account()["lost"] == 0


def test_a_killed_reader_knows_exactly_how_much_it_missed_beyond_the_depth(post: Post) -> None:
    done = post.deliver("few", "kill", f"until:={post.out}.back")
    assert done.returncode == 0, done.stderr
    letters = post.letters()
    assert letters == sorted(set(letters))
    missed = set(range(1, letters[-1] + 1)) - set(letters)
    assert missed == set(range(101, 101 + len(missed)))
    interrupted = 1  # letter 100 was not done with when the reader died, and is no longer kept
    assert post.account()["lost"] == len(missed) + interrupted == post.lost_by_event()


def test_a_robbed_reader_has_all_of_it_in_order(post: Post) -> None:
    done = post.deliver("many", "rob")
    assert done.returncode == 0, done.stderr
    assert post.letters() == ALL
    assert post.account()["lost"] == 0
