"""What the documentation promises to machines is what they get."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.support.talkative import Talk, talk

__all__ = ["talk"]

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "exit_codes.md"
ROW = re.compile(r"^\| (`[^|]+`) \| (.+) \|$", re.MULTILINE)
WORDS = {
    "topic info": ("/source/sample",),
    "topic type": ("/source/sample",),
    "topic hz": ("/source/sample", "-w", "5"),
    "topic bw": ("/source/sample", "-w", "5"),
    "topic delay": ("/source/sample",),
    "topic pub": ("-1", "/scale/load", "{load_n: 1, samples: []}"),
    "node info": ("/scale",),
    "service type": ("/scale/weigh",),
    "param get": ("/source", "name"),
    "param set": ("/source", "name", "block"),
    "interface show": ("Sample",),
    "bag play": (str(PAGE.parents[2] / "tests/golden/emg.mcap"), "--playback-duration", "0.2"),
}


def promises() -> dict[str, tuple[bool, list[str]]]:
    """Per verb whether a list comes, and the keys of what it holds."""
    found = {}
    table = PAGE.read_text(encoding="utf-8").partition("## Output for programs")[2]
    for verbs, keys in ROW.findall(table):
        for verb in re.findall("`([^`]+)`", verbs):
            found[verb] = (keys.startswith("a list of"), re.findall("`([^`]+)`", keys)[0].split())
    return found


def test_the_page_has_its_promises() -> None:
    assert set(WORDS) <= set(promises())


ASKED_ELSEWHERE = (
    "param load",
    "lifecycle set",
    *(f"action {verb}" for verb in ("info", "type", "send_goal", "cancel")),
)
"""The actions' in ``tests/graph/node/test_running_actions.py``, where there is one."""


@pytest.mark.parametrize("verb", [verb for verb in promises() if verb not in ASKED_ELSEWHERE])
def test_a_promised_key_is_there(talk: Talk, verb: str) -> None:
    is_list, keys = promises()[verb]
    done = talk.run(*verb.split(), *WORDS.get(verb, ()), "--json")
    assert done.returncode == 0, done.stderr
    found: Any = json.loads(done.stdout)
    assert isinstance(found, list) == is_list
    for entry in found if is_list else [found]:
        assert set(keys) <= set(entry)
