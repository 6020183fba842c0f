"""Readings analysed: accuracy, calibration and cost of policies, likelihoods and stop rules."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palp_core.errors import PerceptionError
from palp_core.palpation.perception.belief.stopping import require_classes, stop_rule
from palp_core.palpation.perception.statistics.resampling import calibration_interval
from palp_core.palpation.perception.statistics.statistics import Proportion, calibration, confusion, wilson
from palp_core.palpation.readings.judgement import POLICIES, JudgedTrial, judge_all, trials_of
from palp_core.palpation.readings.readings import Readings
from palp_core.palpation.readings.training import Covariance, Fold, Training, training


@dataclass(frozen=True)
class Plan:
    """By which methods readings are analysed; every combination is a row.

    Attributes:
        policies: Of :data:`~palp_core.palpation.readings.judgement.POLICIES`; ``fixed`` is a row per setting.
        likelihoods: Methods of task ``likelihood``; ``auto``: Student's t where a cell has few readings.
        stops: Methods of task ``stop``.
        stop_value: The stop rule's own number; 0 for its default.
        most: Readings after which a trial is undecided.
        covariance: Of a reading's columns.
        fold_count: In so many parts the trials are left out of training; 0: one by one.
        seed: Of parts, of the policy ``uniform`` and of resamples.
    """

    policies: Sequence[str] = ("recorded",)
    likelihoods: Sequence[str] = ("auto",)
    stops: Sequence[str] = ("posterior_threshold",)
    stop_value: float = 0.0
    most: int = 15
    covariance: Covariance = "auto"
    fold_count: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        for name in self.policies:
            if name not in POLICIES:
                raise PerceptionError(f"no policy '{name}' of a table; there are {', '.join(POLICIES)}")
        if not (self.policies and self.likelihoods and self.stops):
            raise PerceptionError("nothing to analyse: name a policy, a likelihood and a stop rule")


@dataclass(frozen=True, eq=False)
class Result:
    """What came of one combination of methods.

    Attributes:
        policy: Its name, with the setting of a fixed one.
        likelihood: Its name.
        stop: Its name.
        trials: Those in which the policy found a reading.
    """

    policy: str
    likelihood: str
    stop: str
    trials: tuple[JudgedTrial, ...]


@dataclass(frozen=True, eq=False)
class Analysis:
    """An analysis before it is written.

    Attributes:
        training: What was learnt from which trials.
        results: By combination.
        record: All of it as plain numbers.
    """

    training: Training
    results: tuple[Result, ...]
    record: dict[str, Any]


def analyse(readings: Readings, plan: Plan | None = None) -> Analysis:
    """Judge every trial by what all others taught, with every combination of methods.

    Raises:
        PerceptionError: The readings do not suffice (a cell of one reading, no setting common to all
            classes), or a method cannot be used on them.
        MethodError: No such method.
    """
    plan = plan or Plan()
    how = training(readings, fold_count=plan.fold_count, covariance=plan.covariance, seed=plan.seed)
    for stop in plan.stops:
        require_classes(stop, len(readings.classes))
    results = tuple(_results(how, tuple(how.learnt()), plan))
    record = _record(how, plan) | {"results": [_line(how.readings, one, plan.seed) for one in results]}
    return Analysis(how, results, record)


def _results(how: Training, folds: Sequence[Fold], plan: Plan) -> Iterator[Result]:
    likelihoods = dict.fromkeys(how.likelihood(name)[0] for name in plan.likelihoods)
    for name in plan.policies:
        settings = range(len(how.readings.settings)) if name == "fixed" else (None,)
        for setting in settings:
            shown = name if setting is None else f"fixed: {how.readings.settings[setting]}"
            for likelihood in likelihoods:
                for stop in plan.stops:
                    rule = stop_rule(stop, plan.stop_value, max_probes=plan.most)
                    found = tuple(
                        judge_all(
                            how.readings,
                            folds,
                            name,
                            setting,
                            likelihood=likelihood,
                            rule=rule,
                            most=plan.most,
                            seed=plan.seed,
                        )
                    )
                    yield Result(shown, likelihood, stop, found)


def _record(how: Training, plan: Plan) -> dict[str, Any]:
    of = how.readings
    return {
        "readings": len(of.values),
        "columns": list(of.columns),
        "classes": list(of.classes),
        "settings": list(of.settings),
        "trials": len(trials_of(of)),
        "notes": [*of.notes, *_shared_names(of)],
        "training": {
            "parts": len(how.folds),
            "least_readings_of_a_cell": how.least,
            "covariance": "full" if how.full else "diagonal",
            "covariance_why": how.why,
            "likelihoods": [
                dict(zip(("asked", "used", "why"), (name, *how.likelihood(name)), strict=True))
                for name in plan.likelihoods
            ],
            "prior": "all classes alike",
        },
        "interval": "95 %: of shares Wilson's over the trials, of the calibration error resampled trials",
        "seed": plan.seed,
    }


def _shared_names(of: Readings) -> list[str]:
    shared = [t for t, count in Counter(one.trial_index for one in trials_of(of)).items() if count > 1]
    if not shared:
        return []
    return [
        f"{len(shared)} names of trials are those of several classes, as '{of.trials[shared[0]]}': each of "
        "them has a trial of that name, and all of one name are kept out of training together"
    ]


def _line(of: Readings, result: Result, seed: int) -> dict[str, Any]:
    names = {"policy": result.policy, "likelihood": result.likelihood, "stop": result.stop}
    if not result.trials:
        return names | {"trials": 0, "accuracy": None}
    right = np.array([one.right for one in result.trials])
    stated = np.array([one.confidence for one in result.trials])
    true = np.array([one.trial.class_index for one in result.trials])
    found = calibration(stated, right.tolist())
    low, high = calibration_interval(
        [(stated[i : i + 1], right[i : i + 1]) for i in range(len(right))], np.random.default_rng(seed)
    )
    words = Counter(one.verdict for one in result.trials)
    return names | {
        "trials": len(right),
        "accuracy": _share(wilson(int(right.sum()), len(right))),
        "accuracy_by_class": {
            name: _share(wilson(int(right[true == c].sum()), int((true == c).sum())))
            for c, name in enumerate(of.classes)
            if (true == c).any()
        },
        "chance": 1.0 / len(of.classes),
        "readings_a_trial": float(np.mean([len(one.rows) for one in result.trials])),
        "calibration_error": {"value": found.expected_error, "ci": [low, high]},
        "overconfidence": found.overconfidence,
        "reliability": [
            {"low": b.low, "high": b.high, "stated": b.mean_confidence, "accuracy": _share(b.accuracy)}
            for b in found.bins
        ],
        "confusion": confusion(
            true.tolist(), [one.estimate for one in result.trials], len(of.classes)
        ).tolist(),
        **{word: words[word] for word in ("decided", "undecided", "ran_out")},
    }


def _share(of: Proportion) -> dict[str, Any]:
    return {"value": of.value, "ci": [of.low, of.high], "right": of.success_count, "of": of.trial_count}
