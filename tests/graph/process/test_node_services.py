"""Parameters, services, transitions and messages from outside, on either clock; calls to a dying server."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from palp_core.graph.clock import monotonic_ns
from palp_core.graph.transport.requester_socket import ask
from palp_core.graph.transport.subscriber_socket import SubscriberSocket
from tests.support.palp import PATIENCE_S, Palp, own_palp, wait_for_line
from tests.support.post import Post
from tests.support.supervised import Running


@pytest.fixture
def post(palp: Palp, tmp_path: Path) -> Post:
    return Post(palp, tmp_path)


class Office:
    """A running office, asked over its clerk's ROUTER."""

    def __init__(self, post: Post, *arguments: str) -> None:
        self.post = post
        self.process = post.palp.start("launch", post.office, *arguments)
        wait_for_line(self.process, "office: ")
        (clerk,) = [node for node in Running(post.palp).record["nodes"] if node["name"] == "clerk"]
        self.endpoint: str = clerk["serve"]
        self._publish: str = clerk["publish"]

    def ask(self, operation: str, **more: Any) -> dict[str, Any]:
        reply = ask(self.endpoint, {"op": operation, "node": "clerk", **more}, PATIENCE_S)
        assert reply is not None, f"{operation} was not answered"
        return reply

    def until(self, so: Callable[[], bool]) -> None:
        """Wait until something is so; look again with each number that the clerk publishes."""
        numbers = SubscriberSocket({"/clerk/number": self._publish})
        try:
            while not so():
                assert numbers.wait(PATIENCE_S)
                numbers.receive()
        finally:
            numbers.close()


@pytest.fixture(scope="module", params=["wall", "sim"])
def office(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Office]:
    """One office for all the tests that leave it as it was."""
    with own_palp() as palp:
        yield Office(Post(palp, tmp_path_factory.mktemp("office")), f"clock:={request.param}")


def test_parameters_are_set_as_a_whole_or_not_at_all(office: Office) -> None:
    before = office.ask("get_parameters")["parameters"]
    assert before == {"rate_hz": 100.0, "offset": 0, "mood": "kind", "desk": "left", "limit": 1000000}
    for changes, reason in (
        ({"offset": 11, "mood": "stern"}, "at most 10"),
        ({"mood": "stern", "desk": "right"}, "'desk' is read-only"),
        ({"mood": "stern", "offset": 7}, "a stern clerk has no offset of 7"),
        ({"mood": "stern", "nonsense": 1}, "nonsense"),
        ({"mood": "sad"}, "sad"),
    ):
        assert reason in office.ask("set_parameters", parameters=changes)["error"]
        assert office.ask("get_parameters")["parameters"] == before
    after = office.ask("set_parameters", parameters={"mood": "stern", "offset": 3})["parameters"]
    assert after == before | {"mood": "stern", "offset": 3}
    assert office.ask("set_parameters", parameters={"mood": "kind", "offset": 0})["parameters"] == before


def test_parameters_describe_themselves(office: Office) -> None:
    reply = office.ask("describe_parameters")
    described = reply["parameters"]
    assert reply["about"] == "Parameters of a clerk: ``desk`` is where it sits."
    assert described["offset"]["description"] == "what is added to a number"
    assert (described["offset"]["minimum"], described["offset"]["maximum"]) == (0, 10)
    assert described["mood"]["choices"] == ["kind", "stern"]
    assert [name for name, param in described.items() if param["read_only"]] == ["desk"]


def test_a_service_answers_a_stranger_and_a_repeated_request_is_done_once(office: Office) -> None:
    office.ask("transition", transition="deactivate")
    assert "activate it first" in office.ask("call", service="ask", request={"number": 1})["error"]
    office.ask("transition", transition="activate")
    call = {"service": "ask", "request": {"number": 5}, "id": "one"}
    first = office.ask("call", **call)
    assert office.ask("call", **call) == first
    assert "has no service 'axe'" in office.ask("call", service="axe", request={})["error"]
    assert "number" in office.ask("call", service="ask", request={"number": "x"})["error"]


def test_a_node_is_led_through_its_states_by_command(office: Office) -> None:
    before_ns = monotonic_ns()
    assert before_ns < office.ask("info")["counted_ns"] < monotonic_ns()
    for transition, state in (
        ("deactivate", "inactive"),
        ("cleanup", "unconfigured"),
        ("configure", "inactive"),
        ("activate", "active"),
    ):
        assert office.ask("transition", transition=transition) == {"lifecycle": state}
    assert "allowed: deactivate, shutdown" in office.ask("transition", transition="configure")["error"]
    assert "there are: configure" in office.ask("transition", transition="explode")["error"]


def test_an_external_port_takes_messages_and_no_other_does(office: Office) -> None:
    first = office.ask("publish", port="hint", message={"number": 1})["sequence"]
    assert office.ask("publish", port="hint", message={"number": 2})["sequence"] == first + 1
    assert "takes no messages from outside" in office.ask("publish", port="number", message={})["error"]
    assert "Question" in office.ask("publish", port="hint", message={"number": 2.5})["error"]
    office.until(lambda: office.ask("info")["inputs"]["/clerk/hint"]["received"] > first)


@pytest.mark.parametrize("clock", ["wall", "sim"])
def test_a_service_that_fails_tells_its_caller_and_fails_its_node(post: Post, clock: str) -> None:
    office = Office(post, f"clock:={clock}")
    assert "thirteen" in office.ask("call", service="ask", request={"number": 13})["error"]
    assert office.process.wait(PATIENCE_S) == 1


@pytest.mark.parametrize("compose", [pytest.param([], marks=pytest.mark.nightly), ["--compose"]])
def test_commands_to_a_lockstep_graph_are_in_its_record_and_replay(post: Post, compose: list[str]) -> None:
    bag = post.folder / "bag"
    office = Office(post, "clock:=sim", *compose, "--record", str(bag))
    office.ask("set_parameters", parameters={"offset": 2})
    office.ask("call", service="ask", request={"number": 100})
    office.ask("publish", port="hint", message={"number": 1000})
    office.until(lambda: office.ask("info")["inputs"]["/clerk/hint"]["received"] == 1)
    office.ask("transition", transition="deactivate")
    office.ask("transition", transition="activate")
    tick = office.ask("info")["params"]["limit"]
    assert tick == 1000000
    office.ask("set_parameters", parameters={"limit": 1400})
    assert office.process.wait(PATIENCE_S) == 0
    done = post.palp.printed("bag", "replay", bag, "--nodes", "clerk", "--json", "--launch", post.office)
    (report,) = json.loads(done)
    assert report["divergence"] is None
    assert report["compared"] > 100


def test_calls_to_a_server_that_dies_are_all_answered_in_the_end(post: Post) -> None:
    post.palp.printed("launch", post.calls, f"out:={post.out}")
    heard = post.out.read_text().splitlines()
    assert len(heard) == 20
    assert all(line.startswith("answer") for line in heard)
