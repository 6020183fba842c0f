"""Quantities: a number with its unit and its bounds, as an annotation.

A message or parameter field names its unit and uses one of these aliases. Decoding checks the bounds, and a
bound also refuses NaN and infinity, which a bare ``float`` lets through. On the wire everything is SI;
millimetres, milliseconds and N mm appear only where a person types or reads, as :data:`Millimetres`.
A parameter takes the narrowest alias that is true of it (a spread is not negative, a rate is positive): the
check of a launch file then refuses what could only fail later, and says where it stands.

What is not here is made in a line, in a module of one's own::

    Moles = Annotated[float, quantity("mol", 0.0, 1e3)]
    MolesArray = Annotated[Float64Array, array_of("mol", 0.0, 1e3)]
"""

from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]


def quantity(unit: str, low: float, high: float) -> Meta:
    """Return the unit and bounds that make a number a quantity; the module shows how.

    Args:
        unit: As it is written, in SI: ``"mol"``, ``"m/s"``, ``"N m"``, or ``"1"``.
        low: The least that can be meant; below it lies a mistake.
        high: The greatest.
    """
    return Meta(ge=low, le=high, extra_json_schema={"x-unit": unit})


def array_of(unit: str, low: float, high: float) -> Meta:
    """Return the unit and bounds that make an array one of quantities; the module shows how.

    Of a field of a message; the bounds are those of every element and are checked where it is decoded.

    Args:
        unit: As for :func:`quantity`.
        low: The least that an element can be.
        high: The greatest.
    """
    return Meta(extra_json_schema={"x-unit": unit, "x-dtype": "<f8"}, extra={"bounds": (low, high)})


Nanoseconds = Annotated[int, Meta(ge=0, extra_json_schema={"x-unit": "ns"})]
Count = Annotated[int, Meta(ge=0)]
CountPositive = Annotated[int, Meta(ge=1)]
Seconds = Annotated[float, quantity("s", 0.0, 1e9)]
SecondsPositive = Annotated[float, quantity("s", 1e-9, 1e9)]
MillisecondsPositive = Annotated[float, quantity("ms", 1e-6, 1e12)]
DeadlineMilliseconds = Annotated[float, quantity("ms", 1.0, 10_000.0)]
"""A longest time without a word: under a millisecond nothing is heard, over 10 s nothing is guarded."""
Hertz = Annotated[float, quantity("Hz", 0.0, 1e6)]
HertzPositive = Annotated[float, quantity("Hz", 1e-3, 1e6)]
Metres = Annotated[float, quantity("m", -1e3, 1e3)]
MetresNonNegative = Annotated[float, quantity("m", 0.0, 1e3)]
Millimetres = Annotated[float, quantity("mm", -1e6, 1e6)]
MillimetresNonNegative = Annotated[float, quantity("mm", 0.0, 1e6)]
MillimetresPositive = Annotated[float, quantity("mm", 1e-6, 1e6)]
MetresPerSecond = Annotated[float, quantity("m/s", -1e3, 1e3)]
MetresPerSecondPositive = Annotated[float, quantity("m/s", 1e-6, 1e3)]
Radians = Annotated[float, quantity("rad", -1e3, 1e3)]
Newtons = Annotated[float, quantity("N", -1e4, 1e4)]
NewtonsPositive = Annotated[float, quantity("N", 1e-9, 1e4)]
NewtonMetres = Annotated[float, quantity("N m", -1e3, 1e3)]
NewtonMillimetresNonNegative = Annotated[float, quantity("N mm", 0.0, 1e6)]
NewtonMillimetresPositive = Annotated[float, quantity("N mm", 1e-6, 1e6)]
Kilograms = Annotated[float, quantity("kg", 0.0, 1e6)]
Volts = Annotated[float, quantity("V", -1e3, 1e3)]
Amperes = Annotated[float, quantity("A", -1e3, 1e3)]
Celsius = Annotated[float, quantity("degC", -273.15, 1e4)]
Kelvins = Annotated[float, quantity("K", 0.0, 1e4)]
Pascals = Annotated[float, quantity("Pa", 0.0, 1e12)]
Probability = Annotated[float, quantity("1", 0.0, 1.0)]
Ratio = Annotated[float, quantity("1", -1e12, 1e12)]
RatioNonNegative = Annotated[float, quantity("1", 0.0, 1e12)]

SecondsArray = Annotated[Float64Array, array_of("s", 0.0, 1e9)]
MetresArray = Annotated[Float64Array, array_of("m", -1e3, 1e3)]
MetresPerSecondArray = Annotated[Float64Array, array_of("m/s", -1e3, 1e3)]
RadiansArray = Annotated[Float64Array, array_of("rad", -1e3, 1e3)]
NewtonsArray = Annotated[Float64Array, array_of("N", -1e4, 1e4)]
NewtonMetresArray = Annotated[Float64Array, array_of("N m", -1e3, 1e3)]
VoltsArray = Annotated[Float64Array, array_of("V", -1e3, 1e3)]
AmperesArray = Annotated[Float64Array, array_of("A", -1e3, 1e3)]
CelsiusArray = Annotated[Float64Array, array_of("degC", -273.15, 1e4)]
PascalsArray = Annotated[Float64Array, array_of("Pa", 0.0, 1e12)]
ProbabilityArray = Annotated[Float64Array, array_of("1", 0.0, 1.0)]
RatioArray = Annotated[Float64Array, array_of("1", -1e12, 1e12)]
