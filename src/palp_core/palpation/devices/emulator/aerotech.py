"""The stage's controller as its clients see it: Aerotech's ASCII commands over the emulated axes."""

import re
from functools import partial
from itertools import count

from palp_core.palpation.devices.emulator.axis import Axes, Axis

_WORDS = re.compile(r"([A-Z@]+\d*)\s*(-?[\d.]+)")
_QUESTION = re.compile(
    r"(AXISSTATUS|AXISFAULT|PFBKPROG|PCMDPROG|VFBK|PLANESTATUS|GETPARM)\(([@A-Z0-9]+)(?:,\s*(\d+))?\)"
)
_LONGEST = 256
_CLIENTS = count(1)


class Aerotech:
    """One client's conversation with the controller; all clients command the same axes."""

    def __init__(
        self,
        axes: Axes,
        names: tuple[str, ...] = ("X", "Y", "Z"),
        *,
        always_end: bool = True,
        refuses_beyond: bool = True,
    ) -> None:
        self.greeting, self.ready_ns = b"", 0
        self._log, self._client = axes.log, next(_CLIENTS)
        numbered = list(enumerate(zip(names, (axes.y, axes.z, axes.x), strict=True)))
        self._axes: dict[str, Axis] = {name: axis for _, (name, axis) in numbered}
        self._axes |= {f"@{number}": axis for number, (_, axis) in numbered}
        self._lift, self._end = axes.z, b"\n" if always_end else b""
        self._refuses_beyond = refuses_beyond
        self._rest = b""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Answer every complete line."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-_LONGEST:]
        return b"".join(
            self._answer(line.decode("ascii", "replace").strip().upper(), now_ns) for line in lines
        )

    def _answer(self, line: str, now_ns: int) -> bytes:
        question = _QUESTION.fullmatch(line)
        if question:
            value = self._value(question[1], question[2], question[3], now_ns)
            return b"!" + self._end if value is None else b"%" + value.encode("ascii") + b"\n"
        self._log.append((now_ns, self._client, line))
        verb, _, rest = line.partition(" ")
        done = self._do(verb, rest.strip(), now_ns)
        return {True: b"%", False: b"#", None: b"!"}[done] + self._end

    def _value(self, name: str, axis_name: str, number: str | None, now_ns: int) -> str | None:
        if name == "PLANESTATUS":
            return (
                str(int(any(axis.moving(now_ns) for axis in self._axes.values())))
                if axis_name == "0"
                else None
            )
        axis = self._axes.get(axis_name)
        if axis is None:
            return None
        if name == "AXISSTATUS":
            return str(axis.status(now_ns))
        if name == "AXISFAULT":
            return str(axis.fault)
        if name == "VFBK":
            return f"{axis.velocity_m_per_s(now_ns) * 1e3:.3f}"
        if name == "GETPARM":
            settings = axis.settings
            known = {
                37: settings.soft_low_m,
                38: settings.soft_high_m,
                72: settings.ramp_m_per_s2,
                73: settings.abort_m_per_s2,
            }
            return f"{known[int(number)] * 1e3:g}" if number and int(number) in known else None
        return f"{axis.position_m(now_ns) * 1e3:.3f}"

    def _do(self, verb: str, rest: str, now_ns: int) -> bool | None:
        """Carry out a command: done, not executable, or not understood (None)."""
        if verb == "WAIT":
            return True if rest in ("MODE NOWAIT", "MODE MOVEDONE", "MODE INPOS") else None
        if verb in ("MOVEABS", "MOVEINC"):
            return self._move(verb, rest, now_ns)
        if verb == "ACKNOWLEDGEALL":
            return all(list(map(self._acknowledge, self._axes.values())))
        axes = [self._axes.get(name) for name in rest.split()]
        if not axes or None in axes:
            return None
        found = [axis for axis in axes if axis is not None]
        match verb:
            case "ENABLE":
                return all(list(map(self._enable, found)))
            case "DISABLE":
                for axis in found:
                    axis.abort(now_ns)
                    axis.enabled = False
            case "ABORT":
                for axis in found:
                    axis.abort(now_ns)
            case "FAULTACK":
                return all(list(map(self._acknowledge, found)))
            case "HOMEASYNC" | "HOME":
                return all(list(map(partial(Axis.home, now_ns=now_ns), found)))
            case _:
                return None
        return True

    @staticmethod
    def _enable(axis: Axis) -> bool:
        if axis.fault or axis.estop:
            return False
        axis.enabled = True
        return True

    @staticmethod
    def _acknowledge(axis: Axis) -> bool:
        if axis.estop:
            return False
        axis.fault = 0
        return True

    def _move(self, verb: str, rest: str, now_ns: int) -> bool | None:
        numbers = dict(_WORDS.findall(rest))
        targets = {name: value for name, value in numbers.items() if name in self._axes}
        if not targets or set(numbers) - set(targets) - {f"{name}F" for name in targets}:
            return None
        try:
            moves = [
                (self._axes[name], float(value) * 1e-3, float(numbers.get(f"{name}F", "10")) * 1e-3)
                for name, value in targets.items()
            ]
        except ValueError:
            return None
        for axis, target_m, _ in moves:
            if not axis.ready(now_ns):
                return False
            if not axis.inside(target_m + (axis.position_m(now_ns) if verb == "MOVEINC" else 0.0)):
                axis.enabled = False
                return not self._refuses_beyond
        if any(axis is not self._lift for axis, *_ in moves):
            self._lift.fall(0.0, now_ns)
        for axis, target_m, speed in moves:
            axis.move(target_m + (axis.position_m(now_ns) if verb == "MOVEINC" else 0.0), speed, now_ns)
        return True
