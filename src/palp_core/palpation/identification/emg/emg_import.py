"""Write any recording of EMG as the plainest table there is."""

from pathlib import Path

import numpy as np

from palp_core.errors import PalpError
from palp_core.palpation.identification.emg.files import read_emg
from palp_core.palpation.identification.emg.guess import is_voltage, muscles
from palp_core.palpation.identification.emg.trial import MUSCLES, Choices


def write_plain(path: Path, out: Path, choices: Choices) -> None:
    """Write ``time_s``, FDS and, where there is a second muscle, EDC as CSV; a lost sample is ``nan``.

    The unit is volts where the recording's is a voltage.

    Raises:
        PalpError: The recording cannot be used, or the table cannot be written.
    """
    file = read_emg(path)
    found = choices.guess(file)
    both = muscles(file, found)
    suffix = "_v" if is_voltage(found.unit) else ""
    times_s = np.arange(both.shape[1]) / float(found.rate_hz or 1.0)
    try:
        with out.open("w", encoding="utf-8") as table:
            table.write(",".join(["time_s", *(f"{name}{suffix}" for name in MUSCLES[: len(both)])]) + "\n")
            np.savetxt(table, np.column_stack([times_s, *both]), fmt="%.12g", delimiter=",")
    except OSError as error:
        raise PalpError(f"--out {out}: cannot be written: {error.strerror}") from error
