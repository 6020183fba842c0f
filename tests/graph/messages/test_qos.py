"""Request versus offer, as in ROS 2."""

from __future__ import annotations

from itertools import product

import msgspec
import pytest

from palp_core.graph.messages.qos import Qos, incompatibility


@pytest.mark.parametrize(("asks", "offers"), list(product(["best_effort", "reliable"], repeat=2)))
def test_a_reliable_reader_needs_a_reliable_publisher(asks, offers) -> None:  # type: ignore[no-untyped-def]
    reason = incompatibility(Qos(reliability=asks), Qos(reliability=offers))
    assert (reason is not None) == (asks == "reliable" and offers == "best_effort")


@pytest.mark.parametrize(("asks", "offers"), list(product(["volatile", "transient_local"], repeat=2)))
def test_a_transient_local_reader_needs_a_publisher_that_keeps_its_last(asks, offers) -> None:  # type: ignore[no-untyped-def]
    reason = incompatibility(Qos(durability=asks), Qos(durability=offers))
    assert (reason is not None) == (asks == "transient_local" and offers == "volatile")


def test_a_deadline_shorter_than_the_offered_one_is_refused_and_named() -> None:
    reason = incompatibility(Qos(deadline_ms=20), Qos(deadline_ms=50))
    assert reason is not None
    assert "20 ms" in reason
    assert "50 ms" in reason
    assert incompatibility(Qos(deadline_ms=50), Qos(deadline_ms=20)) is None
    assert incompatibility(Qos(), Qos(deadline_ms=20)) is None


def test_equal_offers_and_defaults_agree() -> None:
    assert incompatibility(Qos(), Qos()) is None


def test_an_unknown_setting_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"relibility": "reliable"}, Qos)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"reliability": "perhaps"}, Qos)
