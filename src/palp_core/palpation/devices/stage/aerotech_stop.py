"""A second link to the stage's controller, for stopping it: the safety process's own."""

import threading
from collections.abc import Callable
from dataclasses import replace
from time import monotonic_ns
from typing import get_args

from palp_core.errors import DeviceError
from palp_core.palpation.devices.protocols import AxisReport, Direction, StopTimes
from palp_core.palpation.devices.stage.aerotech_link import AerotechLink
from palp_core.palpation.devices.wire import aerotech as wire

_DIRECTIONS: tuple[Direction, ...] = get_args(Direction)
_KEPT = 100  # reports that were not fetched yet


class AerotechStop:
    """Abort and disable, and nothing that moves.

    Every command is written past whatever the link was waiting for. The controller closes an idle TCP
    connection, and a lost link must be noticed: a thread asks about one axis after another, so that the
    caller waits for no answer and an ABORT leaves at once. :meth:`reports` returns what was answered.
    """

    def __init__(
        self,
        url: str,
        axes: tuple[str, ...] = ("X", "Y"),
        baud: int = 115200,
        *,
        origin_m: tuple[float, ...] = (0.0, 0.0),
        sign: tuple[int, ...] = (1, 1),
        timeout_s: float = 0.1,
        rest_s: float = 0.2,
        look_hz: float = 0.0,
        clock: Callable[[], int] = monotonic_ns,
    ) -> None:
        self._axes, self._rest_ns, self._clock = axes, round(rest_s * 1e9), clock
        self._origin_m, self._sign = origin_m, sign
        self._turn = 0
        self._link = AerotechLink(url, baud, timeout_s)
        try:
            self._guarded = self._link.guard(axes)
        except DeviceError:
            self._link.close()
            raise
        self._abort = wire.each("ABORT", axes)
        self._disable = wire.each("DISABLE", axes)
        self._answers: list[AxisReport | DeviceError] = []
        self._reading, self._closing = threading.Lock(), threading.Event()
        self._poller: threading.Thread | None = None
        if look_hz > 0.0:
            self._poller = threading.Thread(
                target=self._keep_polling, args=(1.0 / look_hz,), name="palp-stop", daemon=True
            )
            self._poller.start()

    @property
    def guarded(self) -> bool:
        """Whether the axes are stopped by another process should this one die."""
        return self._guarded

    def poll(self) -> list[AxisReport]:
        """Return what every axis says."""
        return [self._report(number) for number in range(len(self._axes))]

    def reports(self) -> list[AxisReport]:
        """Return what the axes have answered since the last call, without waiting."""
        with self._reading:
            answers, self._answers = self._answers, []
        if self._poller is not None and not self._poller.is_alive():
            raise DeviceError("aerotech: the axes are not watched any more; connect again")
        for item in answers:
            if isinstance(item, DeviceError):
                raise item
        return [item for item in answers if isinstance(item, AxisReport)]

    def poll_next(self) -> AxisReport:
        """Return what one axis says, each in its turn: less of a wait than :meth:`poll`; errors as there."""
        number = self._turn % len(self._axes)
        self._turn += 1
        report = self._report(number)
        if not report.enabled:  # it is sent nowhere
            return report
        sent_m, after_m = self._place_m("PCMDPROG", number), self._place_m("PFBKPROG", number)
        # what the axis moved between the questions is no error of following
        off_m = abs(sent_m - 0.5 * (report.position_m + after_m)) - 0.5 * abs(after_m - report.position_m)
        return replace(report, following_m=max(0.0, off_m))

    def abort(self) -> int:
        """Write ABORT for every axis; return when it was written, in ns."""
        self._link.send_at_once(self._abort)
        return self._clock()

    def disable(self) -> None:
        """Write DISABLE for every axis."""
        self._link.send_at_once(self._disable)

    def trip(self) -> StopTimes:
        """Abort, wait a little for rest, disable whatever the answers were."""
        return self.finish_stop(self.abort())

    def finish_stop(self, written_ns: int) -> StopTimes:
        """Do the rest of a stop after ABORT was written: wait a little, then disable; errors as there."""
        while self._clock() - written_ns < self._rest_ns and self._moves():
            pass
        resting_ns = self._clock()
        self.disable()
        return StopTimes(written_ns, resting_ns, self._clock())

    def close(self) -> None:
        """End the thread and release the link."""
        self._closing.set()
        self._link.close()
        if self._poller is not None:
            self._poller.join()

    def _keep_polling(self, period_s: float) -> None:
        """Ask about one axis after another until the link is closed."""
        while not self._closing.wait(period_s):
            answer: AxisReport | DeviceError
            try:
                self._link.require_guard()
                answer = self.poll_next()
            except DeviceError as error:
                answer = error
            except Exception as error:  # noqa: BLE001 - or the watch would end unnoticed
                answer = DeviceError(f"aerotech: {type(error).__name__} when asked about an axis: {error}")
            with self._reading:
                self._answers = [*self._answers[-_KEPT:], answer]

    def _report(self, number: int) -> AxisReport:
        axis, asked_ns = self._axes[number], self._clock()
        status = self._link.bits(f"AXISSTATUS({axis})")
        fault = wire.Fault(self._link.bits(f"AXISFAULT({axis})"))
        return AxisReport(
            axis=axis,
            direction=_DIRECTIONS[number],
            fault=fault.words if fault else "",
            moving=bool(status & wire.AxisStatus.MOVING),
            enabled=bool(status & wire.AxisStatus.ENABLED),
            position_m=self._place_m("PFBKPROG", number),
            asked_ns=asked_ns,
            answered_ns=self._clock(),
        )

    def _place_m(self, question: str, number: int) -> float:
        controller_mm = self._link.number(f"{question}({self._axes[number]})")
        return wire.place_m(controller_mm, self._origin_m[number], self._sign[number])

    def _moves(self) -> bool:
        """Return whether an axis is known to move; no answer is no reason to wait."""
        try:
            return any(self._link.bits(f"AXISSTATUS({axis})") & wire.AxisStatus.MOVING for axis in self._axes)
        except DeviceError:
            return False
