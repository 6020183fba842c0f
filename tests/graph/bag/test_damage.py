"""Whatever happens to a bag's bytes: no crash, no silent wrong value, everything intact is saved."""

import os
import re
import signal
import subprocess
import sys
import zlib
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.records import McapRecord, Message

from palp_core.errors import BagDamaged, BagError
from palp_core.graph.bag.edit import rewrite
from palp_core.graph.bag.forms import convert
from palp_core.graph.bag.info import bag_info
from palp_core.graph.bag.mcap.records import MAGIC, Channel, DataEnd, Footer, Header, Op, pack
from palp_core.graph.bag.metadata import in_order
from palp_core.graph.bag.reader import Bag, read
from palp_core.graph.bag.recover import recover

Content = dict[tuple[str, int, int], tuple[int, int, bytes]]
CHUNK_MESSAGES = 80
"""More than a chunk of 4 KiB holds here."""


def content(bag: Path) -> Content:
    with Bag(bag) as opened:
        return {
            (m.stream.topic.name, m.stream.epoch, m.sequence): (m.log_ns, m.publish_ns, m.payload)
            for m in opened.recorded()
        }


def check(path: Path, original: Content, out: Path) -> tuple[int, bool]:
    """Return how many messages were recovered and whether reading reported the damage."""
    reported = False
    try:
        with Bag(path) as bag:
            reported = bool(bag.problems)
            count = 0
            for m in bag.recorded():
                key = (m.stream.topic.name, m.stream.epoch, m.sequence)
                assert original[key] == (m.log_ns, m.publish_ns, m.payload)
                count += 1
            assert reported or count == len(original)
            assert (
                set(bag.attachments().values()) <= {b"graph: rig\n"}
                or reported
                or len(bag.attachments()) == 2
            )
    except BagError:
        reported = True
    try:
        assert not (reported and bag_info(path).healthy)
    except BagError:
        assert reported
    try:
        report = recover(path, out)
    except BagError:
        assert not out.exists()
        return 0, reported
    saved = content(out)
    assert all(original[key] == value for key, value in saved.items())
    assert sum(report.message_count.values()) == len(saved)
    return len(saved), reported


def flips(bag: Path, folder: Path, count: int, seed: int) -> None:
    data, original = (bag / "run_0.mcap").read_bytes(), content(bag)
    rng = np.random.default_rng(seed)
    for place in range(count):
        changed = bytearray(data)
        changed[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        path = folder / f"{place}.mcap"
        path.write_bytes(changed)
        saved, _ = check(path, original, folder / f"saved{place}")
        assert saved >= len(original) - CHUNK_MESSAGES


def truncations(bag: Path, folder: Path, count: int, seed: int) -> None:
    data, original = (bag / "run_0.mcap").read_bytes(), content(bag)
    with Bag(bag) as opened:
        ends = [(p.offset + p.length, p.entry) for p in opened.files[0].chunks]
        counts = np.cumsum([len(opened.files[0].read_chunk(p)) for p in opened.files[0].chunks])
    rng = np.random.default_rng(seed)
    for place in range(count):
        size = int(rng.integers(len(data)))
        path = folder / f"{place}.mcap"
        path.write_bytes(data[:size])
        saved, reported = check(path, original, folder / f"saved{place}")
        whole = sum(end <= size for end, _ in ends)
        assert reported
        assert saved >= (counts[whole - 1] if whole else 0)


@pytest.fixture(params=["zstd", "none"])
def any_bag(request: pytest.FixtureRequest, tmp_path: Path, kit: Any) -> Path:
    folder: Path = kit.record(
        tmp_path / "run", kit.run_frames(200), chunk_bytes=4096, compression=request.param
    )[0]
    return folder


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("harm", [flips, truncations])
def test_a_flipped_bit_costs_a_chunk_at_most_and_a_cut_what_is_behind_it(
    any_bag: Path, tmp_path: Path, harm: Callable[..., None], count: int
) -> None:
    harm(any_bag, tmp_path, count, seed=1)


@pytest.mark.parametrize("seed", range(3))
def test_many_damages_at_once_do_no_silent_harm(any_bag: Path, tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    original = content(any_bag)
    changed = bytearray((any_bag / "run_0.mcap").read_bytes())
    for _ in range(int(rng.integers(2, 8))):
        begin = int(rng.integers(len(changed)))
        kind = rng.integers(3)
        if kind == 0:
            changed[begin : begin + 40] = rng.bytes(40)
        elif kind == 1:
            del changed[begin : begin + int(rng.integers(1, 200))]
        else:
            changed[begin:begin] = rng.bytes(int(rng.integers(1, 200)))
    path = tmp_path / "harmed.mcap"
    path.write_bytes(changed)
    check(path, original, tmp_path / "saved")


def test_of_a_torn_uncompressed_chunk_whole_messages_are_saved_and_marked(tmp_path: Path, kit: Any) -> None:
    bag, _ = kit.record(tmp_path / "run", kit.run_frames(100), compression="none")
    with Bag(bag) as opened:
        (place,) = opened.files[0].chunks
    path = tmp_path / "torn.mcap"
    path.write_bytes((bag / "run_0.mcap").read_bytes()[: place.offset + place.length // 2])
    report = recover(path, tmp_path / "saved")
    assert 40 < report.unverified_count == sum(report.message_count.values()) < 60
    assert "no CRC covers" in report.text()


def _without_crcs(bag: Path, library: bytes) -> bytearray:
    """Return a bag whose header names a program, whose chunks have no CRC, and of which a byte is wrong."""
    data = bytearray((bag / "run_0.mcap").read_bytes().replace(b"\4\0\0\0palp", b"\4\0\0\0" + library, 1))
    with Bag(bag) as opened:
        places = opened.files[0].chunks
    for place in places:
        data[place.offset + 33 : place.offset + 37] = bytes(4)
    data[places[0].offset + places[0].length - 3] ^= 1
    return data


def test_a_crc_of_0_is_a_crc_in_a_bag_of_ours_and_none_in_anothers(tmp_path: Path, kit: Any) -> None:
    bag, _ = kit.record(tmp_path / "run", kit.run_frames(100), compression="none")
    ours, theirs = tmp_path / "ours.mcap", tmp_path / "theirs.mcap"
    ours.write_bytes(_without_crcs(bag, b"palp"))
    theirs.write_bytes(_without_crcs(bag, b"some"))
    with pytest.raises(BagDamaged, match="the CRC does not match"):
        list(read(ours))
    with pytest.raises(BagError, match="no message could be saved: 0 intact chunks, 1 damaged chunk"):
        recover(ours, tmp_path / "of_ours")
    report = recover(theirs, tmp_path / "of_theirs")
    assert report.unchecked_chunk_count == report.chunk_count == 1
    assert report.unverified_count == sum(report.message_count.values()) > 100
    assert "they may be wrong" in report.text()


def place_of(data: bytes, op: Op, number: int = 0) -> int:
    """Return where the record of a kind begins: the first, the second (1) ..., in a file or after it."""
    places, offset = [], len(MAGIC)
    while offset < len(data) - len(MAGIC):
        places.append((data[offset], offset))
        offset += 9 + int.from_bytes(data[offset + 1 : offset + 9], "little")
    return [place for found, place in places if found == op][number]


def put(data: bytes, op: Op, shift: int, new: bytes, number: int = 0) -> bytes:
    """Replace bytes of a record; ``shift`` counts from its beginning."""
    begin = place_of(data, op, number) + shift
    return data[:begin] + new + data[begin + len(new) :]


def cut(data: bytes, op: Op, shift: int = 0) -> bytes:
    return data[: place_of(data, op) + shift]


def longer_in_its_index(data: bytes) -> bytes:
    """Let the entry of a chunk, in a summary whose CRC matches, claim a length beyond the file."""
    data = put(data, Op.CHUNK_INDEX, 9 + 24, (1 << 62).to_bytes(8, "little"))
    crc = zlib.crc32(data[place_of(data, Op.DATA_END) + 13 : -12])
    return data[:-12] + crc.to_bytes(4, "little") + data[-8:]


def with_two_definitions(_: bytes) -> bytes:
    """A file of another program in which a channel's encoding changes on its way."""
    one, two = (Channel(1, "/a", name, {}, 0) for name in ("json", "cdr"))
    parts: list[McapRecord] = [Header("", "other"), one, Message(1, 0, b"{}", 0, 1), two, DataEnd(0)]
    return MAGIC + b"".join(map(pack, [*parts, Footer(0, 0, 0)])) + MAGIC


Harm = Callable[[bytes], bytes]
OPEN = "it was not closed: its writer ended without warning"
DAMAGES: list[tuple[Harm, bool, tuple[str, ...]]] = [
    (lambda data: b"", True, ("not an MCAP file|it is empty",)),
    (lambda data: b"x" + data[1:], True, ("not an MCAP file",)),
    (lambda data: cut(data, Op.CHUNK), True, (OPEN,)),
    (lambda data: cut(data, Op.DATA_END), True, (OPEN,)),
    (lambda data: cut(data, Op.CHUNK, 20), True, ("the file ends amid a record",)),
    (lambda data: cut(data, Op.DATA_END, 5), True, ("the file ends amid a record",)),
    (lambda data: cut(data, Op.FOOTER), False, ("the summary is missing, or something follows it",)),
    (lambda data: data + b"more", True, ("the summary is missing, or something follows it",)),
    (lambda data: put(data, Op.STATISTICS, 9, b"~"), False,
     ("the summary is damaged: its CRC does not match",)),
    (lambda data: put(data, Op.FOOTER, 14, b"~"), False,
     ("the summary is damaged: its footer points outside",)),
    (lambda data: put(data, Op.CHUNK, 0, b"~"), True, ("a chunk is damaged: record 126 is not a chunk",)),
    (lambda data: put(data, Op.CHUNK, 9, b"~"), True, ("it is not the chunk that the summary describes",)),
    (with_two_definitions, True, ("two definitions of channel 1",)),
    (longer_in_its_index, True, ("it is not the chunk that the summary describes",)),
    (lambda data: put(data, Op.CHUNK, 1, b"~"), True,
     ("a chunk is damaged: its lengths contradict each other",)),
    (lambda data: put(data, Op.CHUNK, 33, b"~"), True, ("a chunk is damaged: the CRC does not match",)),
    (lambda data: put(data, Op.CHUNK, 90, b"~~~~"), True, ("a chunk is damaged: zstd cannot decompress it",)),
    (lambda data: put(data, Op.ATTACHMENT, 50, b"~"), True, ("attachment 'launch.yaml': the CRC does not",)),
    (lambda data: put(cut(data, Op.FOOTER), Op.CHUNK, 0, b"~"), True, ("no record begins here",)),
    (lambda data: put(cut(data, Op.FOOTER), Op.MESSAGE_INDEX, 11, b"~"), False,
     ("a message index is damaged",)),
    (lambda data: put(cut(data, Op.FOOTER), Op.CHUNK, 41, b"brot"), True,
     ("the summary is missing", "a chunk is damaged: unknown compression 'brot'")),
    (lambda data: put(cut(data, Op.FOOTER), Op.CHUNK, 29, b"~"), True,
     ("the summary is missing", "a chunk is damaged: a chunk of [0-9]+ bytes is not plausible")),
]  # fmt: skip
"""What is done to a bag, whether a part of its content is lost, and what is reported."""


@pytest.mark.parametrize("place", range(len(DAMAGES)))
def test_each_damage_is_reported_once_with_its_reason_and_what_is_lost_is_known(
    bag: Path, tmp_path: Path, place: int
) -> None:
    harm, lost, expected = DAMAGES[place]
    path = tmp_path / "harmed.mcap"
    path.write_bytes(harm((bag / "run_0.mcap").read_bytes()))
    before = path.read_bytes()
    try:
        problems = bag_info(path).problems
    except BagError as error:
        problems = [str(error)]
    assert len(problems) == len(expected)
    try:
        report = recover(path, tmp_path / "saved")
        saved = report.problems
        assert report.complete == bag_info(tmp_path / "saved").complete == (not lost)
    except BagError as error:
        saved = [str(error)]
        assert lost
        assert not (tmp_path / "saved").exists()
    for reason, shown in zip(expected, problems, strict=True):
        assert re.search(reason, shown)
        assert any(re.search(reason, one) for one in saved)
    assert path.read_bytes() == before


def test_damages_at_the_same_place_of_two_files_are_two(bag: Path, tmp_path: Path) -> None:
    rewrite([bag], tmp_path / "parts", max_duration_ns=100_000_000)
    first, second = in_order(tmp_path / "parts")
    data = first.read_bytes()
    first.write_bytes(put(data, Op.CHUNK, 33, b"~"))
    second.write_bytes(put(cut(data, Op.FOOTER), Op.CHUNK, 0, b"~"))
    at = place_of(data, Op.CHUNK)
    assert [re.findall(rf"at byte {at}( of|:)", problem) for problem in bag_info(first.parent).problems] == [
        [" of"], [":"],
    ]  # fmt: skip


def _killed_as_it_names_a_file(work: Callable[[], object]) -> None:
    sys.addaudithook(lambda event, _: os.kill(os.getpid(), signal.SIGKILL) if event == "os.rename" else None)
    work()


@pytest.mark.parametrize(
    "work",
    [
        recover,
        lambda bag, out: rewrite([bag], out),
        lambda bag, out: rewrite([bag], out, max_duration_ns=50_000_000),
        lambda bag, out: convert(bag, out, "json"),
        lambda bag, out: convert(bag, out, "csv"),
        lambda bag, out: convert(bag, out, "ros2"),
    ],
)
def test_after_kill_9_no_part_of_a_copy_has_its_name_and_the_next_is_whole(
    bag: Path, tmp_path: Path, work: Callable[[Path, Path], object]
) -> None:
    before = {path: path.read_bytes() for path in bag.iterdir()}
    out = tmp_path / "copies" / "copy"
    process = get_context("fork").Process(target=_killed_as_it_names_a_file, args=(lambda: work(bag, out),))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert not out.exists()
    work(bag, out)
    assert out.exists()
    assert {path: path.read_bytes() for path in bag.iterdir()} == before


def test_a_damaged_chunk_stops_reading_after_what_is_intact(tmp_path: Path, bag: Path) -> None:
    data = bytearray((bag / "run_0.mcap").read_bytes())
    with Bag(bag) as opened:
        place = opened.files[0].chunks[3]
        before = sum(len(opened.files[0].read_chunk(p)) for p in opened.files[0].chunks[:3])
    data[place.offset + place.length - 5] ^= 4
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    found: list[Any] = []
    with pytest.raises(BagDamaged, match="palp bag recover") as caught:
        found.extend(read(path))
    assert caught.value.offset == place.offset
    assert len(found) == before
    report = recover(path, tmp_path / "saved")
    assert report.damaged_chunk_count == 1
    assert report.gaps["/torque/block"] == 202 - sum(report.message_count.values())


WRITER = """
import sys
from palp_core.graph.bag.recorder import BagRecorder
from palp_core.graph.messages.topic import Topic
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.messages.frame import pack
writer = BagWriter(sys.argv[1], chunk_bytes=8192)
recorder = BagRecorder(writer, [Topic(name="/a")])
for i in range(1, 10_000_000):
    recorder(i, pack(b"/a", 0, 0, i, i, 0, b"\\x81\\xa1x" + bytes([i % 100])))
    if i % 97 == 0:
        writer.tick(i * 10**9)
        print(i, flush=True)
"""


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 4))]
)
def test_after_kill_9_everything_that_was_flushed_is_there(tmp_path: Path, seed: int) -> None:
    arguments = [sys.executable, "-c", WRITER, str(tmp_path / "run")]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        acknowledged = 0
        for _ in range(int(np.random.default_rng(seed).integers(1, 400))):
            acknowledged = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    report = recover(tmp_path / "run", tmp_path / "saved")
    sequences = [m.sequence for m in read(tmp_path / "saved")]
    assert len(sequences) == report.message_count["/a"] >= acknowledged
    assert sequences == list(range(1, len(sequences) + 1))
    assert not bag_info(tmp_path / "run").healthy
    assert bag_info(tmp_path / "run").message_count == len(sequences)


@pytest.mark.parametrize("lost", [0, 3])
def test_what_is_saved_of_a_bag_without_one_of_its_files_is_not_complete(
    tmp_path: Path, bag: Path, lost: int
) -> None:
    rewrite([bag], tmp_path / "parts", max_duration_ns=50_000_000)
    assert bag_info(tmp_path / "parts").complete
    gone = in_order(tmp_path / "parts")[lost]
    gone.unlink()
    report = recover(tmp_path / "parts", tmp_path / "saved")
    assert f"{gone.name} is missing, with all its messages" in report.text()
    found = bag_info(tmp_path / "saved")
    assert (found.complete, found.healthy) == (False, True)
    assert next(iter(read(tmp_path / "saved"))).value.level == 0.5  # latched, it is in every file


def test_files_that_have_each_others_names_are_a_problem(tmp_path: Path, bag: Path) -> None:
    rewrite([bag], tmp_path / "parts", max_duration_ns=50_000_000)
    first, second, *_ = in_order(tmp_path / "parts")
    first.rename(tmp_path / "aside")
    second.rename(first)
    (tmp_path / "aside").rename(second)
    found = bag_info(tmp_path / "parts")
    assert not found.complete
    assert found.problems == [
        f"{first.name}: it is {second.name} by metadata.yaml; rename it",
        f"{second.name}: it is {first.name} by metadata.yaml; rename it",
    ]
    report = recover(tmp_path / "parts", tmp_path / "saved")
    assert (report.complete, report.problems) == (False, found.problems)
    with pytest.raises(BagError, match=f"{first.name}: it is {second.name} by metadata.yaml; rename it"):
        rewrite([tmp_path / "parts"], tmp_path / "copy")
