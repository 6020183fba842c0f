"""The reference of scene and phantom files, made from the classes that their reader fills."""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Iterator
from typing import Any

from palp_core.errors import OutOfRange
from palp_core.palpation.mechanics.phantom import Bead, Phantom
from palp_core.palpation.mechanics.probe import Probe
from palp_core.palpation.mechanics.scene.scene import OUTPUTS, STRAINS, Scene, StagePath, Tolerance

SECTIONS: dict[str, tuple[str, type]] = {
    "": ("The file", Scene),
    "phantom": ("The phantom", Phantom),
    "phantom.bead": ("The bead", Bead),
    "probe": ("The probe", Probe),
    "path": ("The path", StagePath),
    "tolerance": ("The tolerance", Tolerance),
}
"""Title and class by the place in a scene file."""

_WORDS = {"output": OUTPUTS, "strain": STRAINS}

_PHANTOMS = """## A file of phantoms

`phantoms:=FILE` lists phantoms by your own codes, each with the keys of `phantom` above; `bead: none` is bare
gel. Without a file the codes are A, B and C: the paper's beads, 2, 4 and 8 mm deep.

```yaml
# phantoms.yaml
A: {modulus_pa: 20000.0, bead: {depth_m: 0.002}}
deep: {modulus_pa: 20000.0, bead: {depth_m: 0.010}}
aside: {modulus_pa: 20000.0, bead: {depth_m: 0.004, beside_m: 0.003}}
bare: {modulus_pa: 20000.0, bead: none}
```

For texture, wear and spread of phantoms, see [the simulated world](../explanation/world.md).
"""


def scene_page() -> str:
    """Return every key as Markdown."""
    parts = ["\n".join(_section(place, title, kind)) for place, (title, kind) in SECTIONS.items()]
    return "\n" + "\n".join([*parts, _PHANTOMS])


def top_scene_keys() -> Iterator[tuple[str, str]]:
    """Yield the keys at the top of a file, with what each means."""
    yield "key", "meaning"
    yield from ((f"`{name}`", text) for name, text in _sentences(Scene).items())


def _section(place: str, title: str, kind: type) -> Iterator[str]:
    yield f"## {title}\n"
    yield (f"At `{place}`. " if place else "") + (inspect.getdoc(kind) or "").splitlines()[0] + "\n"
    yield "| key | default | bounds | meaning |"
    yield "|---|---|---|---|"
    sentences = _sentences(kind)
    for field in dataclasses.fields(kind):
        words = " or ".join(f"`{word}`" for word in _WORDS.get(field.name, ()))
        bound = words or _bounds(kind, field)
        yield f"| `{field.name}` | {_default(field)} | {bound} | {sentences[field.name]} |"
    yield ""


def _sentences(kind: type) -> dict[str, str]:
    """Return what a class's docstring has of each attribute."""
    text = (inspect.getdoc(kind) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    found = re.findall(r"^    (\w+): (.*(?:\n {8,}.*)*)", text, flags=re.MULTILINE)
    plain = {name: re.sub(r":\w+:`~?([\w.]+)`", r"`\1`", " ".join(words.split())) for name, words in found}
    return {name: words.replace("``", "`").replace(" None", " `none`") for name, words in plain.items()}


def _bounds(kind: type, field: dataclasses.Field[Any]) -> str:
    """Return the bounds that a constructor states when it refuses what is no number."""
    if field.type not in (float, "float"):
        return ""
    given = {"depth_m": 0.004} if kind is Bead else {}
    try:
        kind(**given | {field.name: math.nan})
    except OutOfRange as error:
        bounds = re.search(r"not in \[(\S+), (\S+)\]", str(error))
        return f"{bounds[1]} to {bounds[2]}" if bounds else ""
    return ""


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is dataclasses.MISSING:
        return "an error" if field.default_factory is dataclasses.MISSING else "the published one"
    if field.default is None:
        return "none"
    if field.default == ():
        return "the paper's three"
    if isinstance(field.default, tuple):
        return f"`[{', '.join(f'{item:g}' for item in field.default)}]`"
    return f"`{field.default}`" if isinstance(field.default, str) else f"`{field.default:g}`"
