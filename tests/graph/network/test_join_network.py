"""A node on another host: here a network namespace of its own, behind a cable that can be pulled."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator

import pytest

from tests.support.hosts import Host, Launched, joining, keeping, own_host
from tests.support.palp import finished


def ip(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=False)


class Cable:
    """Two namespaces and a cable between them."""

    home_address, away_address = "10.213.7.1", "10.213.7.2"

    def __init__(self) -> None:
        self.home, self.away = f"palp-home-{os.getpid()}", f"palp-away-{os.getpid()}"

    def lay(self) -> str:
        """Return why it cannot be laid; "" if it lies."""
        ends = (f"ph{os.getpid()}", f"pa{os.getpid()}")
        places = tuple(zip((self.home, self.away), ends, (self.home_address, self.away_address), strict=True))
        steps: list[tuple[str, ...]] = [("netns", "add", self.home), ("netns", "add", self.away)]
        steps.append(("link", "add", ends[0], "type", "veth", "peer", "name", ends[1]))
        for place, end, address in places:
            steps.append(("link", "set", end, "netns", place))
            steps.append(("-n", place, "address", "add", f"{address}/24", "dev", end))
            steps.append(("-n", place, "link", "set", end, "up"))
            steps.append(("-n", place, "link", "set", "lo", "up"))
        for step in steps:
            done = ip(*step)
            if done.returncode:
                return f"ip {' '.join(step)}: {done.stderr.strip()}"
        return ""

    def set(self, state: str) -> None:
        """Pull it, ``down``, or put it back, ``up``."""
        assert ip("-n", self.away, "link", "set", f"pa{os.getpid()}", state).returncode == 0

    def remove(self) -> None:
        for place in (self.home, self.away):
            ip("netns", "delete", place)


@pytest.fixture(scope="module")
def cable() -> Iterator[Cable]:
    if shutil.which("ip") is None:
        pytest.skip("no command ip here")
    laid = Cable()
    try:
        if reason := laid.lay():
            pytest.skip(f"no network namespaces here: {reason}")
        yield laid
    finally:
        laid.remove()


@pytest.fixture(scope="module")
def home(cable: Cable) -> Iterator[Host]:
    with own_host() as host:
        host.prefix = ["ip", "netns", "exec", cable.home]
        host.keys.generate("home")
        yield host


@pytest.fixture(scope="module")
def graph(cable: Cable, home: Host) -> Launched:
    launched = home.launch(listen="tcp://0.0.0.0:0")
    launched.address = launched.address.replace("0.0.0.0", cable.home_address)
    return launched


@pytest.fixture
def away(cable: Cable) -> Iterator[Host]:
    with own_host() as host:
        host.prefix = ["ip", "netns", "exec", cable.away]
        host.keys.generate("away")
        yield host


def test_a_stranger_on_the_network_is_refused_with_its_address(
    cable: Cable, home: Host, graph: Launched, away: Host
) -> None:
    done = away.run(*joining(home, graph, "nodes.toys:Ticker"))
    assert done.returncode == 2
    assert "its public key is not allowed there" in done.stderr
    entry = json.loads(graph.wait_for("refused", "").data)
    own = away.keys.own()
    assert own is not None
    assert (entry["address"], entry["key"]) == (cable.away_address, own.public)
    unsaid = away.run("run", "nodes.toys:Ticker", "--join", graph.address)
    assert unsaid.returncode == 2
    assert "give its public key with --server-key" in unsaid.stderr


def test_a_node_joins_over_the_network_and_is_safe_when_the_cable_is_pulled(
    cable: Cable, home: Host, graph: Launched, away: Host
) -> None:
    home.keys.allow(str(away.keys.path / "away.public"), "away")
    book, guest = keeping(home, graph, away, "guest")
    ticks = [int(book.until("tick")[1]) for _ in range(50)]
    assert ticks == list(range(ticks[0], ticks[0] + 50))
    assert json.loads(graph.wait_for("joined", "guest").data)["address"] == cable.away_address
    cable.set("down")
    status, said = finished(guest)
    assert status == 1
    assert "answers no longer" in said
    book.until("safe")
    assert "nothing came from it for 3 s" in graph.until_printed("/guest has left")
    assert graph.ask("ticker", op="info")["lifecycle"] == "active"
    cable.set("up")
