"""Tables within pages: what a study has written, the bounds of the register, the names of Python.

``python -m docs.site.tables`` writes each of them again, after its mark in a page.
"""

from __future__ import annotations

import ast
import csv
import importlib
import importlib.util
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from docs.site.launch_page import top_keys
from docs.site.promises_page import promises
from docs.site.scene_page import top_scene_keys
from docs.site.units_page import units_table
from docs.site.verbs_page import verb_lines
from palp_core.methods import Range, find
from palp_core.palpation.method_table.mechanics import LOADS, PHANTOMS

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
MARK = re.compile(r"(<!-- generated: python -m docs\.site\.tables (\w+) -->\n\n)((?:\|[^\n]*\n)*)")
READINGS = (
    ("peak", "paper", "peak, {}, paper"),
    ("peak", "threshold", "peak, {}, threshold"),
    ("contrast", "paper", "contrast, {}, paper"),
    ("contrast", "threshold", "contrast, {}, threshold"),
    ("trace", "paper", "trace, {}, paper"),
    ("trace", "threshold", "trace, {}, threshold"),
    ("trace within the sweep", "threshold", "trace, {}, threshold, swift"),
)
"""Reading, stop rule, and the study's name of both, in which the policy is missing."""
POLICIES = {"fixed": "fixed_best", "human": "markov", "information gain": "information_gain"}

Row = Sequence[str]


def rows_of(file: str) -> list[dict[str, str]]:
    """Return the rows of a table in docs/."""
    return list(csv.DictReader((ROOT / "docs" / file).read_text(encoding="utf-8").splitlines()))


def _percent(share: str, digits: int = 1) -> str:
    text = f"{100.0 * float(share):.{digits}f}"
    return "100" if text == "100.0" else text


def _frontier() -> dict[tuple[str, str], dict[str, str]]:
    return {(row["world"], row["scheme"]): row for row in rows_of("frontier/frontier.csv")}


def _accuracy(row: dict[str, str]) -> str:
    found = _percent(row["accuracy"])
    return (
        found
        if float(row["accuracy"]) == 1.0
        else f"{found} ({_percent(row['low'])}-{_percent(row['high'])})"
    )


def _frontier_in(world: str) -> Iterator[Row]:
    yield "reading", "stop rule", *(f"{policy}: %, s" for policy in POLICIES)
    found = _frontier()
    for reading, rule, scheme in READINGS:
        rows = [found[world, scheme.format(policy)] for policy in POLICIES.values()]
        yield reading, rule, *(f"{_accuracy(row)}, {float(row['seconds']):.1f}" for row in rows)


def speed() -> Iterator[Row]:
    """Yield the quickest way of each reading, in the lab's world."""
    yield "reading, policy, stop rule", "accuracy, %", "seconds"
    found = _frontier()
    for words, scheme in {
        "trace within the sweep, information gain": "trace, information_gain, threshold, swift",
        "contrast, fixed, threshold, short path and low lift": "contrast, fixed_best, threshold, swift",
        "contrast, fixed, threshold": "contrast, fixed_best, threshold",
        "peak, fixed, paper": "peak, fixed_best, paper",
        "peak, information gain, threshold": "peak, information_gain, threshold",
    }.items():
        row = found["lab", scheme]
        yield words, _accuracy(row), f"{float(row['seconds']):.1f}"


def depths() -> Iterator[Row]:
    """Yield the error of a depth after one sweep at the best fixed position."""
    yield "reading", "paper's world, mm", "lab's world, mm"
    for reading in ("peak", "contrast", "trace"):
        scheme, found = f"{reading}, fixed_best, threshold", []
        for row in rows_of("frontier/depths.csv"):
            if (row["scheme"], row["sweeps"]) == (scheme, "1"):
                rmse, low, high = (
                    f"{1e3 * float(row[name]):.2f}" for name in ("rmse_m", "ci_low", "ci_high")
                )
                found.append(f"{rmse} ({low}-{high})")
        yield reading, *found


MISMATCHES = {
    "none": "none",
    "friction -20 %": "friction -20%",
    "friction +20 %": "friction +20%",
    "indentation -0.3 mm": "indentation -0.3 mm",
    "indentation +0.3 mm": "indentation +0.3 mm",
    "modulus +10 %": "modulus +10%",
    "tip radius +0.3 mm": "tip radius +0.3 mm",
    "ring +-0.6 mm, stated +-0.3": "ring +-0.6 mm",
    "contact by L2, trained by L4": "contact by L2",
    "bead 3 mm off the path": "bead 3 mm off the path",
}
"""Differences that the page shows, and the study's names of them."""


def mismatch() -> Iterator[Row]:
    """Yield accuracy and calibration error of trials that differ from training, in the lab's world."""
    fixed = {f"{reading}, {rule}": name.format("fixed_best") for reading, rule, name in READINGS}
    gain = {"peak, threshold": "peak, information_gain, threshold"}
    schemes = {name: scheme for name, scheme in (fixed | gain).items() if name != "trace, paper"}
    yield "difference", *schemes
    found = {
        (row["world"], row["difference"], row["scheme"]): row for row in rows_of("frontier/mismatch.csv")
    }
    for words, difference in MISMATCHES.items():
        rows = [found["lab", difference, scheme] for scheme in schemes.values()]
        yield words, *(f"{_percent(row['accuracy'], 0)}, {float(row['ece']):.2f}" for row in rows)


def emg_levels() -> Iterator[Row]:
    """Yield how many levels of known contractions are right, in %."""
    rows = [row for row in rows_of("emg_bursts.csv") if row["table"] == "known"]
    models = list(dict.fromkeys(row["model"] for row in rows))
    yield "condition", *models
    right = {(row["condition"], row["model"]): _percent(row["levels_right"]) for row in rows}
    for condition in dict.fromkeys(row["condition"] for row in rows):
        yield condition, *(right[condition, model] for model in models)


_SHOWN = {
    "ring_m": ("r_a {} mm", 1e3),
    "modulus_pa": ("E {} kPa", 1e-3),
    "indentation_m": ("indentation {} mm", 1e3),
    "depth_ratio": ("ratio of depths {}", 1.0),
}
"""Quantities of a bound's last column; the page states the others in words."""


def _range(low: float, high: float, scale: float = 1.0) -> str:
    least, most = f"{low * scale:.4g}", f"{high * scale:.4g}"
    return f"to {most}" if low == 0.0 else f"from {least}" if high * scale > 500.0 else f"{least} to {most}"


def _box(within: dict[str, Range], boxes: Mapping[str, Mapping[str, Range]]) -> str:
    """Return the name of the box that ranges have, and take it out of them."""
    for name, box in boxes.items():
        if box.items() <= within.items():
            for quantity in box:
                del within[quantity]
            return name
    return ""


def _bounds(prefix: str) -> Iterator[Row]:
    """Yield the bounds of the contact models on outputs that begin so."""
    yield "model", "output", "within, %", "phantoms", "load", "d, mm", "yielding", "further"
    for model in ("l2", "l4", "l5"):
        for bound in find("contact", model).bounds:
            if bound.output.startswith("finite_") != bool(prefix):
                continue
            within = dict(bound.within)
            boxes = _box(within, PHANTOMS), _box(within, LOADS)
            d = _range(*within["depth_m"], 1e3) if "depth_m" in within else ""
            yields = f"from {within['yielding'][0]:g}" if "yielding" in within else ""
            more = (
                words.format(_range(*within[name], by))
                for name, (words, by) in _SHOWN.items()
                if name in within
            )
            output = bound.output.removeprefix(prefix).replace("_", " ")
            yield model.upper(), output, f"{100.0 * bound.error:.3g}", *boxes, d, yields, "; ".join(more)


def _boxes(boxes: Mapping[str, Mapping[str, Range]], shown: dict[str, tuple[str, float]]) -> Iterator[Row]:
    yield "", *shown
    for name, box in boxes.items():
        yield name, *(_range(*box[key], by) for key, by in shown.values())


_ROLE = re.compile(r":\w+:`[.~]*([^`]*)`|``")


def _first_line(thing: object) -> str:
    own = vars(thing).get("__doc__") if inspect.isclass(thing) else thing.__doc__  # not that of a base
    line = (own or "").strip().partition("\n")[0]
    return _ROLE.sub(lambda found: f"`{found[1]}`" if found[1] else "`", line).replace("|", "\\|")


def _entries(name: str) -> Iterator[tuple[str, str, str]]:
    """Yield name, meaning and module of a name of Python; of a package or module, what is in it."""
    if _is_module(name):
        module = importlib.import_module(name)
        if hasattr(module, "__path__"):
            for inner in pkgutil.walk_packages(module.__path__, f"{name}."):
                if not inner.ispkg:
                    yield (
                        inner.name.rpartition(".")[2],
                        _first_line(importlib.import_module(inner.name)),
                        inner.name,
                    )
        for word, thing in vars(module).items():
            if inspect.isclass(thing) and thing.__module__ == name:
                yield word, _first_line(thing), name
        return
    home, _, word = name.rpartition(".")
    thing = getattr(importlib.import_module(home), word)
    made = inspect.isclass(thing) or inspect.isfunction(thing)
    yield word, _first_line(thing) if made else _of_value(home, word), home


def _of_value(module: str, word: str) -> str:
    """Return the docstring of a value, which is in the source only."""
    body = ast.parse(inspect.getsource(importlib.import_module(module))).body
    for line, after in pairwise(body):
        targets = line.targets if isinstance(line, ast.Assign) else [getattr(line, "target", None)]
        named = any(isinstance(one, ast.Name) and one.id == word for one in targets)
        if named and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return str(after.value.value).partition("\n")[0]
    return ""


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:  # what is before the last point is no package
        return False


def names(section: str) -> Iterator[Row]:
    """Yield the names that a section of a page has entries for, as a checkout shows no entries."""
    yield "name", "what it is", "file"
    for name in re.findall(r"^::: (\S+)$", section, re.MULTILINE):
        for word, meaning, module in _entries(name):
            yield f"`{word}`", meaning, f"`{module.removeprefix('palp_core.').replace('.', '/')}.py`"


TABLES: dict[str, Callable[[], Iterable[Row]]] = {
    "frontier_paper": lambda: _frontier_in("paper"),
    "frontier_lab": lambda: _frontier_in("lab"),
    "speed": speed,
    "depths": depths,
    "mismatch": mismatch,
    "emg_levels": emg_levels,
    "launch_keys": top_keys,
    "scene_keys": top_scene_keys,
    "verbs": verb_lines,
    "promises": promises,
    "units": units_table,
    "bounds": lambda: _bounds(""),
    "finite_bounds": lambda: _bounds("finite_"),
    "phantoms": lambda: _boxes(
        PHANTOMS,
        {
            "bead's radius, mm": ("bead_radius_m", 1e3),
            "ball's radius, mm": ("tip_radius_m", 1e3),
            "slab, mm": ("height_m", 1e3),
            "Poisson's ratio": ("poisson", 1.0),
        },
    ),
    "loads": lambda: _boxes(
        LOADS,
        {
            "E, kPa": ("modulus_pa", 1e-3),
            "friction": ("friction", 1.0),
            "indentation, mm": ("indentation_m", 1e3),
        },
    ),
}


def again(text: str) -> str:
    """Return a page with each of its tables made again."""

    def made(found: re.Match[str]) -> str:
        section = text[found.end() :].partition("\n## ")[0]
        head, *rows = names(section) if found[2] == "names" else TABLES[found[2]]()
        table = "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *rows))
        return found[1] + table + ("" if text[found.end() :].startswith("\n") else "\n")

    return MARK.sub(made, text)


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(again(page.read_text(encoding="utf-8")), encoding="utf-8")
