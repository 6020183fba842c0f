"""A simulated person of the human experiment: does what is asked of the muscles, in their own time.

The muscles are those of :mod:`palp_core.palpation.devices.sim.emg`; what they do is not a schedule but the
latest cue: rest, contract as hard as possible, or palpate a phantom, each with the chain of its own depth.
Such a person says nothing about people: no answer of theirs is ever scored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import EmgSamples
from palp_core.palpation.devices.sim.emg import SimEmg, SimEmgState
from palp_core.units import Float64Array


class SimSubjectState(SimEmgState):
    """What the subject carries from block to block: also what is done now, and on which phantom."""

    doing: str = "pause"
    phantom: str = ""


@dataclass(frozen=True)
class SimSubject(SimEmg):
    """Parameters of the person, in addition to those of the muscles.

    Attributes:
        chains: Transition probabilities by the phantom's code; of another phantom those of ``matrix``.
        rail_v: Largest size that the amplifier gives; beyond it samples are clipped.
    """

    state_type = SimSubjectState

    chains: Mapping[str, Sequence[Sequence[float]] | Float64Array] = field(default_factory=dict)
    rail_v: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for code, chain in self.chains.items():
            if np.shape(chain) != np.shape(self.matrix):
                raise DeviceError(f"emg: the chain of phantom '{code}' has shape {np.shape(chain)}")

    def cue(self, phase: str, phantom: str, state: SimSubjectState) -> None:
        """Do something else from the next sample on; a palpation begins from its start."""
        state.doing, state.phantom = phase, phantom
        state.level, state.left_count = -1, 0

    def drain(self, now_ns: int, state: SimEmgState, rng: np.random.Generator) -> EmgSamples:
        """Return every sample since the last call, as far as the amplifier's rails let them through."""
        found = super().drain(now_ns, state, rng)
        low_v, high_v = -self.rail_v, self.rail_v
        return EmgSamples(
            found.times_ns,
            np.clip(found.fds_v, low_v, high_v),
            np.clip(found.edc_v, low_v, high_v),
            found.index,
            found.gap,
        )

    def _target(self, first: int, draws: Float64Array, state: SimEmgState) -> Float64Array:
        assert isinstance(state, SimSubjectState)
        target = np.full(len(draws), 1.0 if state.doing == "mvc" else 0.0)
        if state.doing == "palpation":
            self._follow_chain(target, 0, draws, state)
        return target

    def _chain(self, state: SimEmgState) -> Float64Array:
        assert isinstance(state, SimSubjectState)
        return np.asarray(self.chains.get(state.phantom, self.matrix), dtype=np.float64)
