"""The reference of launch files, made from the checker's table of keys."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import yaml
from msgspec import inspect

from palp_core.graph.description.launch_keys import SECTIONS, SUBSTITUTIONS, Keys

_SUBSTITUTIONS = """## Substitutions

Any value may contain them. They do not nest. A substitution that is the whole value keeps its type.

"""

_SELECTIONS = """## One of several

`run`, `params` and `inputs` of a node may depend on an argument. Every branch is checked:

<!-- not run: a part of a launch file -->
```yaml
run:
  select: $(var policy)
  fixed: nodes.policy_fixed:Fixed
  markov: nodes.policy_markov:Markov
```
"""

_INCLUDES = """## Files that share nodes

`include` adds the nodes of another file. They come before or after your own `nodes`, in the order of the
keys:

<!-- not run: a part of a launch file -->
```yaml
include:
  - file: parts/experiment.yaml
    args: {stop_link: $(var stop_link)}
```

- Your file has all arguments of the included file. `palp graph args FILE` lists them, the included ones
  first.
- If you give an argument a value under `args`, it is no longer an argument of your file.
- If both files declare an argument, your file's default, choices and help count. The type must be the same,
  and both files must accept the value. Of two included files, the declaration of the first one counts.
- An included file sees only arguments that it, or a file that it includes, declares.
- If the value of an argument is empty, an input such as `inputs: {guard: $(var guard)}` stays open.
- `sets` lets one value set several others: with `protocol: {default: paper, choices: [paper, swift], sets:
  {swift: {lift_mm: 6.0}}}`, `protocol:=swift` also sets `lift_mm`. A value that you give yourself wins.
- `shared` gives a value to every node with a parameter of that name. The including file's values win. In an
  include with a `namespace` they stay within it.

## A report of your own

`report: module:function` receives the `RunSummary` (`exit_code` 0 and `ended` empty if the run came to its
end) and returns the text to print. The function may have these functions as attributes:

- `prepare(summary)`: called before anything starts; raise a `PalpError` to refuse the run.
- `advise(summary)`: called by `--check`; returns sentences to print.
- `attach(summary)`: returns texts by name, which are kept with each record of the run (a bag's
  `palp/launch.json`).
- `begin(summary)`: called before the nodes become active.
"""


def launch_page() -> str:
    """Return every key as Markdown."""
    parts = ["\n".join(_section(place, keys)) for place, keys in SECTIONS.items()]
    parts.append(_SUBSTITUTIONS + "\n".join(f"- {text}" for text in SUBSTITUTIONS.values()) + "\n")
    parts += [_SELECTIONS, _INCLUDES]
    return "\n" + "\n".join(parts)


def top_keys() -> Iterator[tuple[str, str]]:
    """Yield the keys at the top of a file, with what each is for."""
    yield "key", "purpose"
    for field in inspect.type_info(SECTIONS[""]).fields:  # type: ignore[attr-defined]
        sentence = _about(field.type)["description"].partition(". ")[0]
        yield f"`{field.encode_name}`", _cell(sentence.rstrip("."))


def _section(place: str, keys: type[Keys]) -> Iterator[str]:
    yield f"## {str(keys.__doc__).rstrip('.')}\n"
    yield f"At `{place}`.\n" if place else "At the top.\n"
    yield "| key | value | default | purpose |"
    yield "|---|---|---|---|"
    for field in inspect.type_info(keys).fields:  # type: ignore[attr-defined]
        about = _about(field.type)
        scope = " Counts only in the file that you launch." if about.get("root") else ""
        example = f" As in `{_cell(_written(about['examples'][0]))}`." if about.get("examples") else ""
        yield (
            f"| `{field.encode_name}` | {_cell(form_of(field.type))} | {_without(field)} "
            f"| {_cell(about['description'])}{scope}{example} |"
        )
    yield ""


def _about(kind: inspect.Type) -> dict[str, Any]:
    """Return the description of a key next to its type."""
    found: dict[str, Any] = {}
    while isinstance(kind, inspect.Metadata):
        found = {**(kind.extra or {}), **(kind.extra_json_schema or {}), **found}
        kind = kind.type
    return found


def form_of(kind: inspect.Type) -> str:
    """Return the kind of value of a key."""
    if isinstance(kind, inspect.Metadata):
        text = form_of(kind.type)
        return f"{text}; or a selection" if (kind.extra or {}).get("selects") else text
    match kind:
        case inspect.LiteralType(values=words):
            return " or ".join(f"`{word}`" for word in words)
        case inspect.BoolType():
            return "`true` or `false`"
        case inspect.IntType(ge=low, le=high) | inspect.FloatType(ge=low, le=high):
            noun = "whole number" if isinstance(kind, inspect.IntType) else "number"
            return f"{noun}, at least {low}" if high is None else f"{noun}, {low} to {high:,}"
        case inspect.AnyType():
            return "text, number, `true` or `false`, mapping"
        case inspect.UnionType(types=kinds):
            return "; or ".join(form_of(one) for one in kinds)
        case inspect.StrType():
            return "text"
        case inspect.ListType():
            return "list"
    return "mapping"


def _without(field: inspect.Field) -> str:
    if field.required:
        return "an error"
    shown = "" if field.default in (msgspec.NODEFAULT, "", 0) else _written(field.default)
    return f"`{shown}`" if shown else ""


def _written(value: Any) -> str:
    """Return a value as YAML writes it in a line."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=1000)
    return text.removesuffix("\n").removesuffix("\n...")


def _cell(text: str) -> str:
    return text.replace("|", r"\|")
