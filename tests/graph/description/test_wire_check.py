"""Whether a wire fits is said in the same words to whoever asks."""

from __future__ import annotations

from typing import Any

import pytest

from palp_core.graph.description.checked import TopicInfo
from palp_core.graph.description.wire_check import misfit, misfits
from palp_core.graph.messages.qos import Qos


def info(**changed: Any) -> TopicInfo:
    known: dict[str, Any] = {
        "node": "torque", "port": "block", "type": "Sample", "type_hash": "0" * 16,
        "ros_text": "int64 stamp_ns\nfloat64 force_n\n", "json_schema": {}, "qos": Qos(),
    }  # fmt: skip
    return TopicInfo(**known | changed)


MISFITS: dict[str, tuple[dict[str, Any], str]] = {
    "another field": (
        {"type_hash": "1", "ros_text": "int64 stamp_ns\nfloat32 force_n\n"},
        "with 'float64 force_n' where 'float32 force_n' is wanted",
    ),
    "a field less": (
        {"type_hash": "1", "ros_text": "int64 stamp_ns\n"},
        "with 'float64 force_n', too",
    ),
    "a field more": (
        {"type_hash": "1", "ros_text": "int64 stamp_ns\nfloat64 force_n\nbool ok\n"},
        "without 'bool ok'",
    ),
    "another field inside": (
        {"type_hash": "1"},
        "which differs in a nested type",
    ),
}


@pytest.mark.parametrize("name", MISFITS)
def test_a_wire_that_does_not_fit_is_refused_for_what_is_wrong(name: str) -> None:
    wanted, difference = MISFITS[name]
    text = f"/torque/block carries another Sample, {difference}"
    assert misfit(info(**wanted), info(), reads_truth=False) == ("type", text)


def test_every_reason_is_told() -> None:
    wanted = info(port="truth", qos=Qos(durability="transient_local"))
    assert [found.part for found in misfits(wanted, info(port="truth"), reads_truth=False)] == [
        "qos",
        "truth",
    ]


def test_a_wire_that_fits_is_not_refused() -> None:
    assert misfit(info(), info(), reads_truth=False) is None
    assert misfit(info(port="truth"), info(port="truth"), reads_truth=True) is None
