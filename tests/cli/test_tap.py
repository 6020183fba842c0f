"""``palp tap``: what a plotter gets that knows only ZeroMQ and msgpack."""

from __future__ import annotations

from pathlib import Path

import msgpack
import pytest
import zmq

from palp_core.cli.topic.tap_feed import TapFeed, points
from palp_core.errors import SecurityError
from tests.support.palp import CHAIN, PATIENCE_S, Palp, wait_for_line


def block(start_ns: int, count: int) -> dict[str, object]:
    torque_n_m = [0.001 * i for i in range(count)]
    return {"start_ns": start_ns, "rate_hz": 1000.0, "over_phantom": True, "torque_n_m": torque_n_m}


def received(subscriber: zmq.Socket[bytes], count: int) -> list[tuple[str, dict[str, object]]]:
    found = []
    for _ in range(count):
        assert subscriber.poll(round(PATIENCE_S * 1e3))
        parts = subscriber.recv_multipart()
        assert len(parts) == 2
        found.append((parts[0].decode(), msgpack.unpackb(parts[1])))
    return found


def test_a_block_becomes_a_point_per_sample_at_its_own_time() -> None:
    found = list(points(block(2_000_000_000, 3), 5))
    assert [time_s for time_s, _ in found] == pytest.approx([2.0, 2.001, 2.002])
    assert [point["torque_n_m"] for _, point in found] == [0.0, 0.001, 0.002]
    assert all(point["over_phantom"] is True for _, point in found)


def test_another_message_keeps_its_lists_and_loses_the_endless_ones() -> None:
    message = {"posterior": [0.1, 0.9], "image": [0.0] * 101, "inner": {"long": [1] * 101, "short": [1]}}
    ((time_s, point),) = points(message, 3_500_000_000)
    assert time_s == 3.5
    assert point == {"posterior": [0.1, 0.9], "inner": {"short": [1]}}


@pytest.mark.parametrize(("fastest_hz", "step"), [(0.0, 1), (1000.0, 1), (200.0, 5)])
def test_what_comes_too_fast_is_thinned_evenly_across_blocks(
    tmp_path: Path, fastest_hz: float, step: int
) -> None:
    feed = TapFeed(f"ipc://{tmp_path}/tap", fastest_hz)
    for k in range(10):
        feed.send("/torque/block", block(k * 50_000_000, 50), 0)
    assert feed.sent_count == 500 // step
    feed.send("/torque/block", block(0, 1), 0)  # the graph has begun again
    assert feed.sent_count == 500 // step + 1
    feed.close()


def test_other_hosts_are_not_fed() -> None:
    with pytest.raises(SecurityError, match="other hosts could read along"):
        TapFeed("tcp://0.0.0.0:9872", 0.0)


def test_a_plain_subscriber_gets_plain_numbers_of_a_running_graph(palp: Palp, tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/tap"
    context = zmq.Context()
    subscriber = context.socket(zmq.SUB)
    subscriber.setsockopt(zmq.SUBSCRIBE, b"")
    subscriber.connect(endpoint)
    graph = palp.start("launch", CHAIN, "count:=100000")
    try:
        wait_for_line(graph, "blocks: 1/")
        tap = palp.start("tap", "--endpoint", endpoint, "-e", "sample|amplified")
        assert tap.stderr is not None
        assert "2 topics of graph 'chain' at ipc://" in tap.stderr.readline()
        found = received(subscriber, 20)
        taken = palp.here("tap", "--endpoint", "tcp://10.255.255.1:9872")
        assert taken.returncode == 2
        assert "other hosts could read along" in taken.stderr
        unknown = palp.here("tap", "/relay/amplifed")
        assert unknown.returncode == 2
        assert "did you mean '/relay/amplified'?" in unknown.stderr
    finally:
        subscriber.close()
        context.term()
        graph.terminate()
    assert {topic for topic, _ in found} == {"/source/sample", "/relay/amplified"}
    for _, message in found:
        assert isinstance(message["timestamp"], float)
        assert isinstance(message["torque_n_m"], list)
        assert len(message["torque_n_m"]) == 50
        assert all(isinstance(value, float) for value in message["torque_n_m"])
    assert graph.wait(PATIENCE_S) != 0
    assert tap.wait(PATIENCE_S) == 0
