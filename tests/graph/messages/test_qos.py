"""Request versus offer, as in ROS 2."""

import re
from itertools import product
from typing import Any

import msgspec
import pytest

from palp_core.graph.messages.qos import POLICIES, Qos, events_of, incompatibility, on_edge, strictest


@pytest.mark.parametrize(
    ("policy", "weak", "strong", "named"),
    [
        ("reliability", "best_effort", "reliable", ["reliable", "best_effort"]),
        ("durability", "volatile", "transient_local", ["transient_local", "volatile"]),
        ("liveliness", "automatic", "manual_by_topic", ["manual_by_topic", "automatic"]),
        ("deadline_ms", 50, 20, ["20 ms", "50 ms"]),
        ("lease_ms", 50, 20, ["20 ms", "50 ms"]),
    ],
)
def test_a_publisher_that_offers_less_than_its_reader_asks_for_is_refused_by_name(
    policy: str, weak: Any, strong: Any, named: list[str]
) -> None:
    for asks, offers in product((weak, strong), repeat=2):
        reason = incompatibility(Qos(**{policy: asks}), Qos(**{policy: offers}))
        assert (reason is not None) == (asks == strong and offers == weak)
        assert reason is None or all(word in reason for word in named)
    assert incompatibility(Qos(), Qos()) is None


def test_an_unknown_setting_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"relibility": "reliable"}, Qos)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"reliability": "perhaps"}, Qos)


def test_every_setting_is_a_policy() -> None:
    assert set(POLICIES) == set(Qos.__struct_fields__)


def test_of_two_lifespans_the_shorter_holds_and_of_the_rest_what_is_requested() -> None:
    requested, offered = Qos(depth=3, lifespan_ms=50), Qos(depth=7, lifespan_ms=20, deadline_ms=5)
    assert on_edge(requested, offered) == Qos(depth=3, lifespan_ms=20)
    assert on_edge(Qos(), offered) == Qos(lifespan_ms=20)


def test_inputs_of_one_topic_share_what_is_fetched_and_see_to_their_own_times() -> None:
    asked = [
        Qos(reliability="best_effort", depth=2, deadline_ms=5),
        Qos(durability="transient_local", depth=4),
    ]
    assert strictest(asked) == Qos(durability="transient_local", depth=4)


def test_what_is_stated_can_fail_and_says_so() -> None:
    assert events_of(Qos()) == []
    assert events_of(Qos(lease_ms=1, lifespan_ms=1, deadline_ms=1)) == ["deadline", "lifespan", "liveliness"]


def test_keep_all_holds_where_either_end_states_it_and_the_shorter_wait() -> None:
    keeps = Qos(history="keep_all", max_blocking_ms=50)
    assert on_edge(keeps, Qos()) == keeps
    assert on_edge(Qos(depth=3), keeps) == Qos(history="keep_all", max_blocking_ms=50, depth=3)
    assert on_edge(Qos(max_blocking_ms=20), keeps).max_blocking_ms == 20
    assert strictest([Qos(), keeps]).history == "keep_all"


def test_no_publisher_waits_for_a_best_effort_reader() -> None:
    best_effort = Qos(reliability="best_effort")
    assert on_edge(best_effort, Qos(history="keep_all")) == best_effort
    reason = incompatibility(Qos(reliability="best_effort", history="keep_all"), Qos())
    assert reason is not None
    assert "best_effort" in reason


@pytest.mark.parametrize(
    ("stated", "text"),
    [
        ({"reliability": "relible"}, "reliability = 'relible': give one of best_effort, reliable"),
        ({"depth": 0}, "depth = 0: give 1 to 1000000"),
        ({"depth": 1.5}, "depth = 1.5: give a whole number"),
        ({"deadline_ms": -1.0}, "deadline_ms = -1.0: give 0 to"),
        ({"lease_ms": float("nan")}, "lease_ms = nan: give 0 to"),
    ],
)
def test_what_is_no_policy_is_refused_where_it_is_written(stated: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=re.escape(text)):
        Qos(**stated)
