from __future__ import annotations

import dataclasses
import importlib

from palp_core.graph.node.node import Params
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.session.parameter_basis import BASIS, SCENE

PARAMS = {
    "experiment": ("nodes.experiment:ExperimentParams",),
    "policy": (
        "nodes.policy_auto:AutoParams",
        "nodes.policy_fixed:FixedParams",
        "nodes.policy_markov:MarkovParams",
        "nodes.policy_uniform:UniformParams",
        "nodes.policy_information:InformationParams",
        "nodes.policy_emg:EmgPolicyParams",
    ),
    "actuator": ("nodes.actuator:ActuatorParams",),
    "stage": ("nodes.stage:StageParams",),
    "phantom": ("nodes.phantom:PhantomParams",),
    "torque": ("nodes.torque:TorqueParams",),
    "estimator": ("nodes.estimator:EstimatorParams",),
    "emg": ("nodes.emg:EmgParams",),
    "cocontraction": ("nodes.cocontraction:CoContractionParams",),
}


def declared(node: str) -> set[str]:
    classes: list[type[Params]] = []
    for target in PARAMS[node]:
        module, _, name = target.partition(":")
        classes.append(getattr(importlib.import_module(module), name))
    return {name for cls in classes for name in cls.__struct_fields__}


def test_each_basis_is_of_a_parameter_that_exists() -> None:
    assert set(BASIS) <= {f"{node}.{name}" for node in PARAMS for name in declared(node)}


def test_every_number_of_the_simulated_scene_has_a_basis() -> None:
    numbers = {f.name for kind in (Probe, Phantom, Bead) for f in dataclasses.fields(kind)} - {"bead"}
    assert numbers == set(SCENE)
