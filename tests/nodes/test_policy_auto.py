"""The policy that the register chooses: it follows it, says so, or says why there is none."""

from __future__ import annotations

import pytest

from nodes.policy_auto import Auto, AutoParams
from palp_core import Bench
from palp_core.methods import Bound, method, register
from palp_core.palpation.perception.strategy.policies import FixedRing
from tests.nodes.test_policy_information import trial


def test_it_follows_the_registers_choice_and_reports_it_as_chosen() -> None:
    bench = Bench(Auto, {})
    bench.feed(Auto.trial, trial(0))
    assert [one.ring_m for one in bench.sent(Auto.command)] == [FixedRing().ring_m]
    (told,) = bench.sent(Auto.methods)
    assert [(one.task, one.name, one.asked) for one in told.uses] == [("policy", "fixed", False)]


@pytest.mark.parametrize(
    ("params", "place", "words"),
    [
        ({"height_sd_mm": 0.5}, "", "no policy method gives 'decision' within 5.0% at "),
        ({"trained_mm": "4, 8"}, "", "16 mm"),
        ({"noise": "no.yaml"}, "noise", "no.yaml"),
    ],
    ids=["no-choice", "untrained-ring", "no-file"],
)
def test_a_session_for_which_there_is_no_choice_is_refused(
    params: dict[str, object], place: str, words: str
) -> None:
    assert words in Auto.examine(AutoParams(**params))[place]  # type: ignore[arg-type]


def test_a_choice_that_cannot_be_made_of_its_defaults_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(register, "_REGISTER", dict(register._REGISTER))
    method(
        task="policy", name="needy", cost_s=1e-9, bounds=[Bound("decision", 0.01)], evidence="the lab",
        fails="without a model",
    )(lambda model: model)  # fmt: skip
    assert "'needy', which has no default settings" in Auto.examine(AutoParams())[""]
