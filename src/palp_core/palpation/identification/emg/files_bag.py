"""EMG from a bag: blocks of both muscles, with their phases; a lost block becomes NaN."""

from pathlib import Path
from typing import Any

import numpy as np

from palp_core.errors import PalpError
from palp_core.graph.bag.reader import Bag
from palp_core.palpation.identification.emg.files import Column, EmgFile
from palp_core.units import Float64Array

_MOST_LOST = 10  # grid over samples; beyond it the blocks are not one recording


def read_bag(path: Path) -> EmgFile:
    """Read the one topic whose messages carry ``fds_v`` and ``edc_v``."""
    blocks: dict[str, list[Any]] = {}
    with Bag(path) as bag:
        names = [name for name in bag.topics() if not name.startswith("/_")]
        likely = [name for name in names if "emg" in name.lower()] or names
        for message in bag.messages(likely or None):
            if all(hasattr(message.value, name) for name in ("fds_v", "edc_v", "start_ns", "rate_hz")):
                blocks.setdefault(message.topic, []).append(message.value)
    if len(blocks) != 1:
        found = ", ".join(blocks) or "none"
        raise PalpError(f"{path}: needs one topic of EMG blocks (fds_v, edc_v), has: {found}")
    ((topic, parts),) = blocks.items()
    rates = {part.rate_hz for part in parts}
    if len(rates) != 1:
        raise PalpError(f"{path}: {topic} changes its rate: {sorted(rates)} Hz")
    (rate_hz,) = rates
    begin_ns = parts[0].start_ns
    places = [round((part.start_ns - begin_ns) * rate_hz / 1e9) for part in parts]
    sizes = [len(part.fds_v) for part in parts]
    if any(b < a + n for a, b, n in zip(places, places[1:], sizes, strict=False)):
        raise PalpError(f"{path}: blocks of {topic} overlap; it was recorded from two sources")
    length = places[-1] + sizes[-1]
    if length > _MOST_LOST * max(1, sum(sizes)):
        raise PalpError(f"{path}: {length - sum(sizes)} samples of {topic} are missing; split the bag")
    muscles: Float64Array = np.full((2, length), np.nan)
    phases: dict[str, list[tuple[int, int]]] = {}
    for place, size, part in zip(places, sizes, parts, strict=True):
        muscles[0, place : place + size] = part.fds_v
        muscles[1, place : place + size] = part.edc_v
        stretches = phases.setdefault(str(getattr(part, "phase", "palpation")), [])
        if stretches and place - stretches[-1][1] < rate_hz:  # a lost block does not end a phase
            stretches[-1] = (stretches[-1][0], place + size)
        else:
            stretches.append((place, place + size))
    columns = (Column("fds_v", muscles[0], "V", rate_hz), Column("edc_v", muscles[1], "V", rate_hz))
    return EmgFile(
        path,
        "bag",
        columns,
        {name: tuple(one) for name, one in phases.items()},
        (f"topic {topic}",),
        begin_s=begin_ns / 1e9,
        rate_from=f"topic {topic}",
    )
