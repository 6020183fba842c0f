"""Whom a restarted publisher waits for, and how long."""

from pathlib import Path

import pytest

from palp_core.graph.transport import restart_files as audiences
from palp_core.graph.transport.restart_files import WAIT_NS, MatchedReaders
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.graph.transport.test_publisher_socket import Publisher


class Clock:
    now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(audiences, "monotonic_ns", made)
    return made


def noted(file: Path, *names: str) -> None:
    """Let a process be read by some."""
    process = MatchedReaders(lambda: set(names), file)
    assert process.all_present()
    process.write_down()


@pytest.mark.parametrize("list_of_before", [None, b"[tr"])
def test_who_knows_of_no_reader_waits_for_nobody(tmp_path: Path, list_of_before: bytes | None) -> None:
    file = tmp_path / "a.readers"
    if list_of_before is not None:
        file.write_bytes(list_of_before)
    assert MatchedReaders(set, file).all_present()
    assert MatchedReaders(set, None).all_present()


def test_a_successor_waits_for_its_predecessors_readers_and_for_nobody_else(tmp_path: Path) -> None:
    file, present = tmp_path / "a.readers", {"stranger"}
    noted(file, "sink", "policy")
    successor = MatchedReaders(lambda: present, file)
    assert not successor.all_present()
    assert successor.missing == ["policy", "sink"]
    present.add("sink")
    assert not successor.all_present()
    present.add("policy")
    assert successor.all_present()
    assert successor.missing == []


def test_the_wait_ends_and_says_who_is_missing(tmp_path: Path, clock: Clock) -> None:
    noted(tmp_path / "a.readers", "sink")
    successor = MatchedReaders(set, tmp_path / "a.readers")
    clock.now_ns = 5 * WAIT_NS  # the time before it is ready to speak does not count
    assert not successor.all_present()
    clock.now_ns += WAIT_NS - 1
    assert not successor.all_present()
    clock.now_ns += 1
    assert successor.all_present()
    assert successor.missing == ["sink"]


def test_a_process_that_dies_while_it_waits_leaves_the_list_to_the_next(tmp_path: Path, clock: Clock) -> None:
    file = tmp_path / "a.readers"
    noted(file, "sink")
    second = MatchedReaders(set, file)
    second.write_down()
    assert not second.all_present()
    second.write_down()
    assert MatchedReaders(set, file).missing == ["sink"]
    clock.now_ns = WAIT_NS
    second.write_down()  # it has given up: nobody waits for that reader again
    assert MatchedReaders(set, file).missing == []


def test_a_publisher_knows_its_readers_by_name_while_they_listen(tmp_path: Path) -> None:
    publisher = Publisher(tmp_path)
    publisher.outlet("/a/x")
    place = {"/a/x": publisher.endpoint}
    named = [SubscriberSocket(place, name=name) for name in ("sink", "sink", "policy")]
    passing = SubscriberSocket(place)
    for reader in (*named, passing):
        publisher.match(reader)
    publisher.receive(
        passing, lambda _: len(publisher.sockets.publisher.named_readers) == 2
    )  # names follow the topics
    assert sorted(publisher.sockets.publisher.named_readers) == ["policy", "sink"]
    assert publisher.sockets.publisher.readers == {"/a/x": 4}
    named.pop().close()
    publisher.receive(passing, lambda _: "policy" not in publisher.sockets.publisher.named_readers)
    assert sorted(publisher.sockets.publisher.named_readers) == ["sink"]
    for reader in (*named, passing):
        reader.close()
    publisher.sockets.close()


def test_a_full_disk_costs_the_list_and_not_the_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(audiences, "write_whole", full)
    readers = MatchedReaders(lambda: {"sink"}, tmp_path / "relay.readers")
    assert readers.all_present()
    readers.write_down()
