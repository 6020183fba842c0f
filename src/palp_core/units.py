"""Quantities: a number with its unit and its bounds, as an annotation.

A message or parameter field names its unit and uses one of these aliases. Decoding checks the bounds, and a
bound also refuses NaN and infinity, which a bare ``float`` lets through. On the wire everything is SI;
millimetres, milliseconds and N mm appear only where a person types or reads, as :data:`Millimetres`.
A parameter takes the narrowest alias that is true of it (a spread is not negative, a rate is positive): the
check of a launch file then refuses what could only fail later, and says where it stands.
"""

from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]


def _quantity(unit: str, low: float, high: float) -> Meta:
    return Meta(ge=low, le=high, extra_json_schema={"x-unit": unit})


def _array(unit: str, low: float, high: float) -> Meta:
    """Bounds of every element; checked at decode by :mod:`palp_core.graph.messages.message`."""
    return Meta(extra_json_schema={"x-unit": unit, "x-dtype": "<f8"}, extra={"bounds": (low, high)})


Nanoseconds = Annotated[int, Meta(ge=0, extra_json_schema={"x-unit": "ns"})]
Count = Annotated[int, Meta(ge=0)]
CountPositive = Annotated[int, Meta(ge=1)]
Seconds = Annotated[float, _quantity("s", 0.0, 1e9)]
SecondsPositive = Annotated[float, _quantity("s", 1e-9, 1e9)]
MillisecondsPositive = Annotated[float, _quantity("ms", 1e-6, 1e12)]
DeadlineMilliseconds = Annotated[float, _quantity("ms", 1.0, 10_000.0)]
"""A longest time without a word: under a millisecond nothing is heard, over 10 s nothing is guarded."""
Hertz = Annotated[float, _quantity("Hz", 0.0, 1e6)]
HertzPositive = Annotated[float, _quantity("Hz", 1e-3, 1e6)]
Metres = Annotated[float, _quantity("m", -1e3, 1e3)]
MetresNonNegative = Annotated[float, _quantity("m", 0.0, 1e3)]
Millimetres = Annotated[float, _quantity("mm", -1e6, 1e6)]
MillimetresNonNegative = Annotated[float, _quantity("mm", 0.0, 1e6)]
MillimetresPositive = Annotated[float, _quantity("mm", 1e-6, 1e6)]
MetresPerSecond = Annotated[float, _quantity("m/s", -1e3, 1e3)]
MetresPerSecondPositive = Annotated[float, _quantity("m/s", 1e-6, 1e3)]
Radians = Annotated[float, _quantity("rad", -1e3, 1e3)]
Newtons = Annotated[float, _quantity("N", -1e4, 1e4)]
NewtonsPositive = Annotated[float, _quantity("N", 1e-9, 1e4)]
NewtonMetres = Annotated[float, _quantity("N m", -1e3, 1e3)]
NewtonMillimetresNonNegative = Annotated[float, _quantity("N mm", 0.0, 1e6)]
NewtonMillimetresPositive = Annotated[float, _quantity("N mm", 1e-6, 1e6)]
Kilograms = Annotated[float, _quantity("kg", 0.0, 1e6)]
Pascals = Annotated[float, _quantity("Pa", 0.0, 1e12)]
Probability = Annotated[float, _quantity("1", 0.0, 1.0)]
Ratio = Annotated[float, _quantity("1", -1e12, 1e12)]
RatioNonNegative = Annotated[float, _quantity("1", 0.0, 1e12)]

MetresArray = Annotated[Float64Array, _array("m", -1e3, 1e3)]
MetresPerSecondArray = Annotated[Float64Array, _array("m/s", -1e3, 1e3)]
NewtonMetresArray = Annotated[Float64Array, _array("N m", -1e3, 1e3)]
VoltsArray = Annotated[Float64Array, _array("V", -1e3, 1e3)]
ProbabilityArray = Annotated[Float64Array, _array("1", 0.0, 1.0)]
RatioArray = Annotated[Float64Array, _array("1", -1e12, 1e12)]
