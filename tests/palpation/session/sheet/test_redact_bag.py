"""A bag without what tells who it was: every text is looked at, every number is as it was, the bag stays."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

from palp_core.cli.session import app
from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.graph.bag.stream import Stream
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.topic import Topic
from palp_core.graph.recording.provenance import LAUNCH_ATTACHMENT
from palp_core.palpation.session.bag_record import launch_of
from palp_core.palpation.session.session_folder import SHEET
from palp_core.palpation.session.sheet.of_run import sheet_of
from palp_core.palpation.session.sheet.redact_bag import redact_bag
from palp_core.palpation.session.sheet.sheet_file import read_sheet, sheet_text
from tests.palpation.session.sheet.filled import FILLED
from tests.support.sessions import describe

HOME = "/home/anna smith/study"
WORDS = ("Jürgen", "S01", "17-204", "mounted twice", "CONSENT-77", "anna smith")
TORQUE = np.linspace(0.0, 1.0, 99).tobytes()
SAID = [
    {"text": "Jürgen says: S01 is here", "count": 3, "share": 0.1, "torque_n_m": TORQUE},
    {"text": "S012 and Jürgens are others", "count": -1, "share": 1e-300, "torque_n_m": b""},
    {"text": f"cannot write {HOME}/S7/out/x", "count": 0, "share": 2.5, "torque_n_m": b""},
]


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return written(tmp_path, SAID)


def written(tmp_path: Path, said: list[dict[str, Any]]) -> Path:
    """Write a bag whose attachments, metadata and messages tell of people."""
    (tmp_path / "sheet.yaml").write_text(FILLED.replace("ÅB", "Jürgen"), encoding="utf-8")
    launch = describe(tmp_path / "out")
    launch = msgspec.structs.replace(
        launch,
        file=f"{HOME}/rig.yaml",
        args={**launch.args, "session": f"{HOME}/Smith.yaml", "out": f"{HOME}/S7/out"},
        params={**launch.params, "leader": {"consent": "CONSENT-77", "subject": "S01"}},
        attached={SHEET: sheet_text(read_sheet(tmp_path / "sheet.yaml"))},
    )
    with BagWriter(tmp_path / "bag") as writer:
        writer.attach(LAUNCH_ATTACHMENT, msgspec.json.encode(launch))
        writer.attach("palp/parameters.json", json.dumps({"who": "Jürgen", "in": f"{HOME}/S7/out"}).encode())
        writer.attach("palp/versions.json", b'{"palp": "0.1.0"}')
        writer.add_metadata("run", {"by": "Jürgen"})
        number = writer.stream(Stream(topic=Topic(name="/node/said", type="Said")))
        for place, one in enumerate(said, start=1):
            writer.write(number, place, place * 10, place * 10, msgspec.msgpack.encode(one))
    return tmp_path / "bag"


def test_nor_does_a_nodes_hand_over_within_a_message(tmp_path: Path) -> None:
    """A node's order has, as bytes, what the node was: packed values, and within them its state."""
    state = msgspec.msgpack.encode({"subject": "S01", "consent": "CONSENT-77", "blocks": TORQUE})
    order = {"count": 1, "hand_over": msgspec.msgpack.encode({"state": state, "rng": "PCG64"})}
    bag = written(tmp_path, [*SAID, order])
    assert redact_bag(bag, tmp_path / "copy") == []
    with Bag(tmp_path / "copy") as copy:
        *_, said = (msgspec.msgpack.decode(one.payload) for one in copy.recorded())
    kept = msgspec.msgpack.decode(said["hand_over"])
    plain = {"subject": "redacted", "consent": "redacted", "blocks": TORQUE}
    assert (msgspec.msgpack.decode(kept["state"]), kept["rng"]) == (plain, "PCG64")


def test_no_text_of_the_copy_tells_who_it_was_and_no_number_is_another(bag: Path, tmp_path: Path) -> None:
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    done = CliRunner().invoke(app, ["redact", str(bag), "--out", str(tmp_path / "copy")])
    assert done.exit_code == 0, done.output
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    with Bag(tmp_path / "copy") as copy:
        texts = [data.decode() for data in copy.attachments().values()] + [repr(copy.metadata())]
        found = [msgspec.msgpack.decode(one.payload) for one in copy.recorded()]
        sheet, launch = sheet_of(launch_of(copy)), launch_of(copy)
    texts += [one["text"] for one in found]
    for word in WORDS:
        assert not [text for text in texts if re.search(rf"(?<!\w){re.escape(word)}(?!\w)", text)], word
    assert sheet is not None
    assert (sheet.operator, sheet.subject, sheet.lab) == ("redacted", "redacted", "Motor Lab, 2nd floor")
    assert launch.file.endswith("rig.yaml")
    assert found[0]["text"] == "redacted says: redacted is here"
    assert found[1] == SAID[1]
    numbers = [{name: value for name, value in one.items() if name != "text"} for one in found]
    assert numbers == [{name: value for name, value in one.items() if name != "text"} for one in SAID]


def test_what_still_has_a_word_is_told(tmp_path: Path) -> None:
    """As an array of bytes, which is no text."""
    told = redact_bag(written(tmp_path, [{"samples": b"\x00S01\x00"}]), tmp_path / "copy")
    assert told == ["/node/said still has 'S01'"]


def test_nothing_is_overwritten_and_a_bag_without_a_sheet_is_refused(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(PalpError, match="is there already, and nothing is overwritten"):
        redact_bag(bag, bag)
    with BagWriter(tmp_path / "plain") as writer:
        launch = msgspec.structs.replace(describe(tmp_path / "out"), attached={})
        writer.attach(LAUNCH_ATTACHMENT, msgspec.json.encode(launch))
    with pytest.raises(PalpError, match="has no sheet"):
        redact_bag(tmp_path / "plain", tmp_path / "other")
    assert not (tmp_path / "other").exists()
