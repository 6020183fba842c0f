"""The reference of launch files, made from the table of keys that the checker goes by."""

from __future__ import annotations

from collections.abc import Iterator

from palp_core.graph.description.keys import SECTIONS, SUBSTITUTIONS, Key, Table

_HEAD = """# Launch file: every key

A launch file names nodes, their parameters and their wires. `palp launch FILE --check` tells every mistake
with file,
line and column and starts nothing; this page, that check and the schema for editors are made from one table.
YAML is read by version 1.2: `on` is a text and `1e-3` a number; a key that is given twice is an error.

```yaml
# count.yaml
graph: count
clock: sim
nodes:
  counter: {run: count.py:Counter, params: {rate_hz: 20.0}}
  watcher: {run: count.py:Watcher, inputs: {number: counter/number}, on_exit: shutdown}
```

## In an editor

`palp graph schema` prints the JSON Schema (draft 7) of launch files. Editors with the YAML language
server complete
keys and mark mistakes by it, if the file's first line says where it is:

<!-- not run: a line of a launch file, for editors -->
```yaml
# yaml-language-server: $schema=launch.schema.json
```

The schema knows keys, words and bounds. Which arguments, parameters and ports there are, the check alone
knows.
"""

_SUBSTITUTIONS = """## Substitutions

In any value. None holds another; where one stands alone, the value keeps its type.

"""

_SELECTIONS = """## One of several

`run`, `params` and `inputs` of a node may depend on an argument. Every branch is checked, whichever is given:

<!-- not run: a part of a launch file -->
```yaml
run:
  select: $(var policy)
  fixed: nodes.policy_fixed:Fixed
  markov: nodes.policy_markov:Markov
```

What files that share nodes share, and what `sets` does, is told in
[The command line](../command_line.md#launch-files-that-share-nodes).
"""


def launch_page() -> str:
    """Return the page as Markdown."""
    parts = [_HEAD]
    parts += ["\n".join(_section(place, title, table)) for place, (title, table) in SECTIONS.items()]
    parts.append(_SUBSTITUTIONS + "\n".join(f"- {text}" for text in SUBSTITUTIONS.values()) + "\n")
    parts.append(_SELECTIONS)
    return "\n".join(parts)


def _section(place: str, title: str, table: Table) -> Iterator[str]:
    yield f"## {title}\n"
    yield f"At `{place}`.\n" if place else "At the top.\n"
    yield "| key | what stands there | without it | what it is for |"
    yield "|---|---|---|---|"
    for name, key in table.items():
        scope = " Of the file that is launched, not of one that it includes." if key.root_only else ""
        example = f" As in `{_cell(key.example)}`." if key.example else ""
        yield f"| `{name}` | {_cell(form_of(key))} | {_without(key)} | {_cell(key.says)}{scope}{example} |"
    yield ""


def form_of(key: Key) -> str:
    """Return in words what stands at a key."""
    match key.form:
        case "word":
            text = " or ".join(f"`{word}`" for word in key.words)
        case "flag":
            text = "`true` or `false`"
        case "whole" | "number":
            noun = "whole number" if key.form == "whole" else "number"
            text = (
                f"{noun}, at least {key.least}"
                if key.most is None
                else f"{noun}, {key.least} to {key.most:,}"
            )
        case "any":
            text = "text, number, `true` or `false`, mapping"
        case _:
            text = key.form
    short = f"; or {form_of(key.short)}" if key.short is not None else ""
    return f"{text}{short}" + ("; or a selection" if key.selects else "")


def _without(key: Key) -> str:
    if key.required:
        return "an error"
    return f"`{key.default}`" if key.default else ""


def _cell(text: str) -> str:
    return text.replace("|", r"\|")
