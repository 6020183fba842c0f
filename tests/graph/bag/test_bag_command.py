import json
import math
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from typer.testing import CliRunner

from palp_core.cli.bag.bag import app
from palp_core.errors import BagError
from palp_core.graph.bag.reader import Bag
from tests.support.bags import foreign_bag


def palp_bag(*arguments: str | Path, status: int = 0) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if isinstance(result.exception, BagError):
        raise result.exception
    assert result.exit_code == status, result.output
    return result.output


def test_info_says_what_is_in_a_bag(bag: Path) -> None:
    text = palp_bag("info", bag)
    assert "202 messages, 0.199 s" in text
    assert "1000.00 Hz  Block" in text
    assert text.endswith("complete\n")
    found = json.loads(palp_bag("info", bag, "--json"))
    assert found["topics"]["/torque/block"]["count"] == 200
    assert found["healthy"]
    assert found["attachments"] == ["launch.yaml", "palp/recording.json"]


def test_info_of_a_lossy_bag_ends_non_zero_and_names_the_gap(tmp_path: Path, kit: Any) -> None:
    frames = kit.run_frames(20)
    del frames[5:8]
    text = palp_bag("info", kit.record(tmp_path / "run", frames)[0], status=1)
    for words in ("3 MISSING", "missing 5..7 of epoch 0", "NOT complete"):
        assert words in text


def test_every_verb_takes_a_folder_or_a_file(bag: Path, tmp_path: Path) -> None:
    for name, path in (("a", bag), ("b", bag / "run_0.mcap")):
        out = tmp_path / name
        assert "202 messages saved" in palp_bag("recover", path, "-o", out / "recovered")
        assert palp_bag("filter", path, "-o", out / "filtered", "-e", "block", "--end", "0.1") == (
            "100 messages\n"
        )
        assert "4 files" in palp_bag("split", path, "-o", out / "split", "-d", "0.05")
        assert palp_bag("merge", path, path, "-o", out / "merged") == "404 messages\n"
        for form in ("json", "csv", "ros2"):
            assert palp_bag("convert", path, "-o", out / form, "--to", form) == "202 messages\n"
        assert "/torque/block: 200 equal" in palp_bag("diff", path, out / "split")
        assert json.loads(palp_bag("diff", path, path, "--json"))["/torque/block"]["equal_count"] == 200
        assert "sequence" in palp_bag("diff", path, out / "merged", status=1)


def test_echo_prints_messages_and_null_for_what_json_has_no_number_for(
    bag: Path, tmp_path: Path, kit: Any
) -> None:
    assert "level: 0.5" in palp_bag("echo", bag, "/policy/mode")
    lines = palp_bag("echo", bag, "--json", "-n", "3", "--start", "0.01").splitlines()
    assert [json.loads(line)["sequence"] for line in lines] == [11, 12, 13]
    odd = kit.frame("/policy/mode", kit.Mode(stamp_ns=0, level=math.nan), 1, 0)
    assert '"level":null' in palp_bag("echo", kit.record(tmp_path / "odd", [(0, odd)])[0], "--json")


def test_info_shows_what_another_programs_bag_lacks(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "libmcap")
        channel = writer.register_channel("/imu", "cdr", 0)
        for log_ns in (0, 10**9, 5 * 10**8):
            writer.add_message(channel, log_ns, b"", log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    text = palp_bag("info", path)
    for words in (
        " 1 file, ",
        " 3 messages, 1.000 s",
        "its clock goes back 1 time, by 0.5 s at most",
        "no sequence numbers, so lost messages do not show: /imu",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("info {out}", "no such bag"),
        ("recover {bag} -o {bag}", "exists already"),
        ("recover {noise} -o {out}", "no message could be saved: .*260 damaged bytes; .*not an MCAP file"),
        ("filter {bag} -o {out} -e (", "not a regular expression"),
        ("split {bag} -o {out}", "a split needs a largest size"),
        *(
            (f"{words}", "/a: palp does not decode 'cdr', only msgpack and JSON; leave the topic out")
            for words in ("echo {cdr}", *(f"convert {{cdr}} -o {{out}} --to {f}" for f in ("json", "csv")))
        ),
        ("convert {cdr} -o {out} --to ros2", "/a: without a schema it cannot become a ROS message"),
        ("play {cdr}", "no topic /node/port in it that could be played"),
        ("recover {begun} -o {out}", "no message could be saved: .*begun.mcap: it was not closed"),
        ("recover {magic} -o {out}", "no message could be saved: .*magic.mcap: it was not closed"),
        *(
            (f"{words} -o {{out}}", "it was not closed: its writer .*; save what is intact: palp bag recover")
            for words in (
                "filter {open}",
                "split {open} -d 1",
                "merge {bag} {open}",
                "convert {open} --to csv",
                "convert {open} --to json",
                "convert {open} --to ros2",
            )
        ),
        *(
            (f"{words} -o {{out}}", "a chunk is damaged")
            for words in (
                "filter {harmed}",
                "merge {bag} {harmed}",
                "convert {harmed} --to csv",
                "convert {harmed} --to json",
                "convert {harmed} --to ros2",
            )
        ),
        *(
            (f"{words} /torque/blok", "no topic '/torque/blok'; did you mean '/torque/block'")
            for words in ("echo {bag}", "filter {bag} -o {out} -t", "diff {bag} {bag} -t", "play {bag} -t")
        ),
    ],
)
def test_mistakes_are_palps_own_errors_and_leave_nothing(
    bag: Path, tmp_path: Path, words: str, expected: str
) -> None:
    files = {name: tmp_path / f"{name}.mcap" for name in ("noise", "cdr", "begun", "magic", "open", "harmed")}
    data = (bag / "run_0.mcap").read_bytes()
    with Bag(bag) as opened:
        _, second, *_, last = opened.files[0].chunks
    files["noise"].write_bytes(b"no bag at all" * 20)
    foreign_bag(files["cdr"], [("/a", 1, 1, 0)], encoding="cdr")
    files["begun"].write_bytes(data[: data.index(b"\x09", 8 + 9 + 8)])  # before the attachment
    files["magic"].write_bytes(data[:8])
    files["open"].write_bytes(data[: last.offset])
    files["harmed"].write_bytes(data[: second.offset + 60] + b"harm" + data[second.offset + 64 :])
    with pytest.raises(BagError, match=expected):
        palp_bag(*(word.format(bag=bag, out=tmp_path / "out", **files) for word in words.split()))
    assert {path.name for path in tmp_path.iterdir()} == {"run", *(path.name for path in files.values())}


def test_what_is_recovered_of_a_bag_that_lacks_something_lacks_it_still(bag: Path, tmp_path: Path) -> None:
    path, data = tmp_path / "open.mcap", (bag / "run_0.mcap").read_bytes()
    with Bag(bag) as opened:
        path.write_bytes(data[: opened.files[0].chunks[-1].offset])
    assert "0 damaged bytes\nopen.mcap: it was not closed" in palp_bag(
        "recover", path, "-o", tmp_path / "once", status=1
    )
    assert "open.mcap" not in palp_bag("recover", tmp_path / "once", "-o", tmp_path / "twice", status=1)
    for name in ("once", "twice"):
        assert palp_bag("info", tmp_path / name, status=1).endswith("NOT complete\n")
