"""How a run's samples became bytes and came to their readers: by the register's names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.launch.summary import RunSummary, summary_of
from palp_core.graph.messages.qos import Qos
from palp_core.methods import names
from palp_core.palpation.session.methods.record import deliveries_of
from palp_core.palpation.session.methods.wires import delivery_uses, wire_uses
from tests.support.palp import SIM
from tests.support.rig_session import check_here


@pytest.fixture(scope="module")
def checked() -> CheckedGraph:
    return check_here(SIM)


def run(checked: CheckedGraph, **changes: Any) -> RunSummary:
    return summary_of(msgspec.structs.replace(checked, **changes), Path(checked.file))


@pytest.mark.parametrize(
    ("changes", "name"), [({"composed": True}, "composed"), ({}, "lockstep"), ({"clock": "wall"}, "reliable")]
)
def test_a_run_says_how_its_messages_were_delivered_as_the_register_has_it(
    checked: CheckedGraph, changes: dict[str, Any], name: str
) -> None:
    summary = run(checked, **changes)
    (inputs,) = summary.deliveries.values()
    assert len(inputs) == sum(len(wires) for wires in checked.readings.values())
    (told,) = delivery_uses(summary)
    assert (told.use.name, told.use.asked, told.use.of, told.use.bound) == (name, False, "", 0.0)
    (entry,) = deliveries_of(summary, [])
    assert (entry["method"], entry["evidence"]) == (name, "tests/graph/launch/test_deliveries.py")


def test_an_input_that_wants_the_latest_only_is_named(checked: CheckedGraph) -> None:
    wires = dict(checked.readings["estimator"])
    wires["torque"] = msgspec.structs.replace(wires["torque"], qos=Qos(reliability="best_effort"))
    readings = checked.readings | {"estimator": wires}
    told = {one.use.name: one.use for one in delivery_uses(run(checked, clock="wall", readings=readings))}
    assert set(told) == {"reliable", "best_effort"} <= set(names("delivery"))
    assert told["reliable"].of == ""
    assert (told["best_effort"].of, told["best_effort"].asked) == ("/estimator/torque", True)


def test_a_run_that_nobody_noted_this_of_says_nothing(checked: CheckedGraph) -> None:
    assert list(delivery_uses(msgspec.structs.replace(run(checked), deliveries={}))) == []


@pytest.mark.parametrize(("samples", "name"), [(50, "one_frame"), (100_000, "pieces")])
def test_the_codec_is_the_registers_choice_for_the_largest_block(
    checked: CheckedGraph, samples: int, name: str
) -> None:
    summary = run(checked)
    params = {node: dict(given) for node, given in summary.params.items()}
    params["stage"]["block_samples"] = samples
    told = list(wire_uses(msgspec.structs.replace(summary, params=params)))
    (codec,) = (one.use for one in told if one.use.task == "codec")
    assert (codec.name, codec.asked) == (name, False)
