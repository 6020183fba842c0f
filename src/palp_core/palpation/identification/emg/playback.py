"""A recording in an amplifier's place: plays what a person's muscles did in the phase that is asked for."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np

from palp_core.errors import DeviceError, PalpError
from palp_core.palpation.devices.health import HEALTHY, DeviceHealth
from palp_core.palpation.devices.limits import check_range
from palp_core.palpation.devices.protocols import EmgSamples
from palp_core.palpation.identification.emg.muscles import ImportOptions, read_muscles
from palp_core.units import Float64Array

_NS = 1e9


class EmgPlaybackState(msgspec.Struct):
    """Where the playback is: samples delivered in all, and of each phase."""

    start_ns: int = -1
    sample_count: int = 0
    doing: str = "pause"
    played: dict[str, int] = {}


@dataclass(frozen=True)
class EmgPlayback:
    """Which recordings; each phase goes on where it stopped, and begins again at its end."""

    LINK: ClassVar[str] = "none: a recording"
    state_type: ClassVar[type[EmgPlaybackState]] = EmgPlaybackState

    path: str  # A recording whose phases are marked, as in a bag; or one of palpation alone
    mvc: str = ""  # A recording of the MVC; empty: the phase `mvc` of `path`
    rest: str = ""  # One at rest; empty: the phase `rest` of `path`
    rate_hz: float = 1500.0  # The recordings' rate
    _phases: dict[str, Float64Array] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        check_range("emg", "rate_hz", self.rate_hz, 1.0, 1e5)
        named = {"palpation": self.path, "mvc": self.mvc or self.path, "rest": self.rest or self.path}
        if self.path:  # a launch file may name none as long as another source is chosen
            self._phases.update({phase: self._load(path, phase) for phase, path in named.items()})

    def _load(self, path: str, phase: str) -> Float64Array:
        try:
            found = read_muscles(Path(path), ImportOptions())
        except PalpError as error:
            raise DeviceError(f"emg: {error}") from error
        both = found.samples
        if len(both) != 2:
            raise DeviceError(f"emg: {path} has one muscle; flexor and extensor are needed")
        if abs(found.rate_hz / self.rate_hz - 1.0) > 1e-3:
            raise DeviceError(
                f"emg: {path} has {found.rate_hz:g} Hz and not {self.rate_hz:g} Hz; set rate_hz"
            )
        if found.file.phases:
            part = found.phase(phase)
            both = both[:, :0] if part is None else part
        elif phase != "palpation" and path == self.path:
            both = both[:, :0]
        both = both[:, np.isfinite(both).all(axis=0)]
        if both.shape[1] == 0:
            raise DeviceError(f"emg: {path} has no phase '{phase}'; name a recording of it ({phase}: FILE)")
        return both

    def cue(self, phase: str, phantom: str, state: EmgPlaybackState) -> None:
        """Play another phase from the next sample on; a phase without a recording is played as rest."""
        state.doing = phase

    def open(self, now_ns: int, state: EmgPlaybackState, rng: np.random.Generator) -> None:
        """Start with sample 0 now; go on where a state was."""
        if not self._phases:
            raise DeviceError("emg: a recording is to be played and none is named; give recording:=FILE")
        if state.start_ns < 0:
            state.start_ns = now_ns

    def close(self) -> None:
        """Do nothing: there is no link."""

    def health(self, now_ns: int) -> DeviceHealth:
        """Return that all is well."""
        return HEALTHY

    def drain(self, now_ns: int, state: EmgPlaybackState, rng: np.random.Generator) -> EmgSamples:
        """Return every sample since the last call up to and including ``now_ns``."""
        first = state.sample_count
        due = max(first, int((now_ns - state.start_ns) * self.rate_hz / _NS) + 1)
        index = np.arange(first, due)
        phase = state.doing if state.doing in self._phases else "rest"
        recorded, at = self._phases[phase], state.played.get(phase, 0)
        place = (at + np.arange(due - first)) % recorded.shape[1]
        state.played = state.played | {phase: int((at + due - first) % recorded.shape[1])}
        state.sample_count = due
        times_ns = state.start_ns + np.rint(index * _NS / self.rate_hz).astype(np.int64)
        none = np.zeros(due - first, dtype=np.bool_)
        return EmgSamples(times_ns, recorded[0, place], recorded[1, place], index, none)
