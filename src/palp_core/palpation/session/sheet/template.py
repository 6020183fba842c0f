"""The sheet to fill in: ``palp session new``."""

from collections.abc import Sequence

_HEAD = """\
# The sheet of a session: fill in every line, then name it: palp launch launch/rig.yaml session:=FILE
# palp checks it before anything moves, and copies it to the record, the report, bags and exports.
lab:        # where the session is run
operator:   # who runs it: initials or a code
subject:    # code of who is measured, as S01, never a name; none where nobody is
ethics:     # id of the approval; none where nobody is measured
phantoms:
"""
_PHANTOM = """\
  {code}:
    id:                  # what is written on it
    batch:               # of its silicone
    cured:               # day, as 2026-03-01
    cure_temperature_c:  # at which it was cured
"""
_SENSOR = """\
sensor:
  serial:     # of the torque sensor
  bias_n_m:   # what it reads with nothing on it
"""
_NOTE = """\
note: ""      # anything else
"""


def template(codes: Sequence[str], *, by_hand: bool = False) -> str:
    """Return the sheet to fill in, for phantoms of these codes; where a person palpates, without a sensor."""
    phantoms = "".join(_PHANTOM.format(code=code) for code in codes)
    if by_hand:
        return _HEAD.replace("rig.yaml", "human.yaml") + phantoms + _NOTE
    return _HEAD + phantoms + _SENSOR + _NOTE
