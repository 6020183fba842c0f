"""Promises about the repository: nodes are tested and used, and what a text names is there."""

from __future__ import annotations

import ast
import functools
import json
import os
import pkgutil
import re
from pathlib import Path
from typing import Any

import pytest

from palp_core.cli.workspace.new import named
from palp_core.graph.description.checked import CheckedGraph
from palp_core.graph.description.diagram import mermaid
from palp_core.graph.foxglove import log_entries
from palp_core.graph.launch.checking import check_file
from palp_core.graph.messages.message_text import parse_path
from palp_core.graph.node.loading import load_class
from palp_core.graph.node.node import Node
from tests.docs.pages import blocks
from tests.support.rig_session import check_here

ROOT = Path(__file__).resolve().parents[1]
OWN = {ROOT / "launch"}
"""Folders of launch files whose nodes are the repository's own; an example has others of those names."""

LAUNCH_FILES = [
    *sorted((ROOT / "launch").glob("*.yaml")),
    *sorted((ROOT / "examples").rglob("launch/*.yaml")),
]
PARTS = sorted((ROOT / "launch" / "parts").glob("*.yaml"))  # of launch files, checked with them
TEXT = {".py", ".yaml", ".yml", ".toml", ".md", ".txt", ".cfg", ".json", ".csv", ".html", ".sh", ""}
OUTSIDE = {".git", "build", "dist", "results"}


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def node_classes() -> dict[str, ast.ClassDef]:
    """Return the node of each file in ``nodes/``: the class that takes the file's name without underscores.

    A file of helpers has none.
    """
    found = {}
    for path in sorted((ROOT / "nodes").glob("*.py")):
        wanted = {path.stem.replace("_", ""), path.stem.rpartition("_")[2]}
        for statement in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(statement, ast.ClassDef) or statement.name.lower() not in wanted:
                continue
            if not statement.name.endswith(("Params", "State")):
                found[path.stem] = statement
    return found


NODES = node_classes()
BASES = {ast.unparse(base) for node in NODES.values() for base in node.bases}
CONCRETE = [stem for stem, node in NODES.items() if node.name not in BASES]


@functools.cache
def tree() -> tuple[Path, ...]:
    """Return every file and folder but what is hidden: an environment has some thirty thousand."""
    found = []
    for folder, folders, files in os.walk(ROOT):
        folders[:] = [name for name in folders if name == ".ci" or not name.startswith(".")]
        found += [Path(folder, name) for name in (*folders, *files)]
    return tuple(sorted(found))


def written_files() -> list[Path]:
    """Return every file a person wrote: what is not hidden and not built."""
    return [
        path
        for path in tree()
        if path.suffix in TEXT
        and path.is_file()
        and not any(
            (part.startswith(".") and part != ".ci")
            or part in OUTSIDE
            or part == "__pycache__"
            or part.endswith(".egg-info")
            for part in path.relative_to(ROOT).parts
        )
    ]


@pytest.fixture(scope="module")
def graphs() -> dict[str, CheckedGraph]:
    """Check every launch file; it raises where one is wrong."""
    return {name_of(path): (check_here if path.parent in OWN else check_file)(path) for path in LAUNCH_FILES}


def test_the_rigs_nodes_are_found() -> None:
    assert len(CONCRETE) >= 11
    for stem in CONCRETE:
        node = load_class(f"nodes.{stem}:{NODES[stem].name}", str(ROOT))
        assert issubclass(node, Node)


def test_each_node_has_a_test_and_a_place_in_a_launch_file_and_each_part_is_included() -> None:
    launched = "".join(file.read_text(encoding="utf-8") for file in LAUNCH_FILES)
    run = set(re.findall(r"\bnodes\.\w+:\w+", launched + "".join(p.read_text("utf-8") for p in PARTS)))
    tests = "".join(path.read_text("utf-8") for path in (ROOT / "tests" / "nodes").rglob("test_*.py"))
    assert [stem for stem in CONCRETE if f"from nodes.{stem} import" not in tests] == []
    assert [stem for stem in CONCRETE if f"nodes.{stem}:{NODES[stem].name}" not in run] == []
    assert [part.name for part in PARTS if f"file: parts/{part.name}" not in launched] == []


def test_each_launch_file_passes_the_check(graphs: dict[str, CheckedGraph]) -> None:
    assert "launch/sim.yaml" in graphs
    assert all(graph.nodes for graph in graphs.values())


@pytest.mark.parametrize("policy", ["fixed", "markov", "uniform"])
def test_the_rig_passes_the_check_with_each_policy(policy: str) -> None:
    graph = check_here(ROOT / "launch" / "sim.yaml", [f"policy:={policy}"])
    (run,) = [spec.run for spec in graph.nodes if spec.name == "policy"]
    assert run == f"nodes.policy_{policy}:{policy.capitalize()}"


def test_only_the_phantom_and_the_record_read_the_truth(graphs: dict[str, CheckedGraph]) -> None:
    readers = {
        spec.name
        for spec in graphs["launch/sim.yaml"].nodes
        for source in spec.inputs.values()
        if source.endswith("/truth")
    }
    assert readers == {"phantom", "experiment"}


def test_the_picture_of_the_architecture_is_the_graph_of_the_simulated_rig(
    graphs: dict[str, CheckedGraph],
) -> None:
    text = ARCHITECTURE.read_text(encoding="utf-8")
    pictures = re.findall(r"^```mermaid\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    assert mermaid(graphs["launch/sim.yaml"]) in pictures, (
        f"{name_of(ARCHITECTURE)} needs a ```mermaid block of 'palp graph draw launch/sim.yaml'"
    )


def texts_in(value: Any) -> list[str]:
    """Return every text in a JSON value."""
    if isinstance(value, dict | list):
        return [
            text for item in (value.values() if isinstance(value, dict) else value) for text in texts_in(item)
        ]
    return [value] if isinstance(value, str) else []


@pytest.mark.parametrize("file", ["launch/sim.yaml", "launch/emulated.yaml", "launch/rig.yaml"])
def test_the_layout_for_foxglove_shows_what_the_rig_publishes(
    graphs: dict[str, CheckedGraph], file: str
) -> None:
    layout = json.loads((ROOT / "launch" / "rig.foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    assert panels.keys() < set(texts_in(layout["layout"])) <= {*panels, "row", "column"}
    schemas = {name: topic.json_schema for name, topic in graphs[file].topics.items()}
    schemas[log_entries.LOG] = log_entries.SCHEMA
    shown = {text for text in texts_in(panels) if text.startswith("/")}
    assert len(shown) > 20
    for path in shown:
        topic, _, field = path.partition(".")
        if file == "launch/sim.yaml" and topic == "/safety/beat":
            continue  # nothing is simulated that could be unsafe
        assert topic in schemas
        if field:
            assert parse_path(field.replace("[:]", "[0]"), schemas[topic])  # or it raises: no such field


def test_no_file_knows_where_it_was_written() -> None:
    private = [f"{ROOT}/".encode(), b"/wo" + b"rk/"]
    guilty = [
        name_of(path) for path in written_files() if any(words in path.read_bytes() for words in private)
    ]
    assert guilty == []


def test_ci_runs_the_readmes_test_command() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    section = readme.partition("## Test it\n")[2]
    commands = section.partition("```sh\n")[2].partition("```")[0].splitlines()
    assert commands[-1] == ".venv/bin/pytest"
    run = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert [line for line in commands if not re.search(rf"^{re.escape(line)}( |$)", run, re.MULTILINE)] == []


TEXTS = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
TOP = r"src|nodes|msgs|launch|docs|tests|benchmarks|examples|\.ci"


def modules_named(text: str) -> set[str]:
    """Return each name of a module of palp's, or of what is in one, that a text states."""
    names = {name.replace(":", ".") for name in re.findall(r"\bpalp_core(?:\.\w+)+(?::\w+)?", text)}
    for module, imported in re.findall(r"^from (palp_core[.\w]*) import (.*)$", text, flags=re.MULTILINE):
        names |= {f"{module}.{name}" for name in re.findall(r"\w+", imported)}
    return names


def is_module_or_in_one(name: str) -> bool:
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def files_written_by(text: str) -> set[str]:
    """Return the path of each file that a text has its reader write: a block, or what palp makes for him."""
    new = {f"/drivers/{word}.py" for word in re.findall(r"\bpalp new driver (\w+)", text)}
    made = ROOT / "src/palp_core/cli/workspace/templates/default"
    new |= {
        f"/{folder}/{file.relative_to(made)}".removesuffix(".txt")
        for folder in re.findall(r"\bpalp init (\w+)", text)
        for file in made.rglob("*.*")
    }
    return new | {f"/{block.file}" for block in blocks(text) if block.file}


def nodes_amiss(text: str) -> set[str]:
    """Return each class of a module in ``nodes`` that a text names and no workspace of the repository has.

    What the text itself writes, by ``palp new``, is there.
    """
    kinds = {"node": "", "policy": "policy_"}
    made = {
        (f"{kinds[kind]}{named(word).module}", named(word).class_name)
        for kind, word in re.findall(r"\bpalp new (node|policy) (\w+)", text)
    }
    return {
        f"nodes.{module}:{name}"
        for module, name in re.findall(r"\bnodes\.(\w+)(?::| import )(\w+)", text)
        if (module, name) not in made
        and not any(
            f"\nclass {name}(" in file.read_text(encoding="utf-8")
            for folder in ("", "examples/*/", "benchmarks/*/")
            for file in ROOT.glob(f"{folder}nodes/{module}.py")
        )
    }


def paths_named(text: str) -> set[str]:
    """Return each path of the repository, or end of one, that a text states."""
    words = re.findall(r"(?<![\w./~$-])[\w.-]+(?:/[\w.-]+)+/?", re.sub(r"\w+://\S+", "", text))
    source = re.compile(rf"(?:{TOP})/.*|[^.].*\.(?:py|mjs|md)")
    return {word.rstrip("./") for word in words if source.fullmatch(word)}


def classes_named(text: str) -> set[str]:
    """Return each class of several words that a text quotes and does not show in a block."""
    quoted = re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text)
    named = {name for code in quoted for name in re.findall(r"\b(?:[A-Z][a-z0-9]+){2,}\b", code)}
    return named - {word for block in blocks(text) for word in re.findall(r"\w+", block.text)}


def test_what_a_text_names_is_there() -> None:
    texts = {name_of(path): path.read_text(encoding="utf-8") for path in TEXTS}
    there = {f"/{name_of(file)}".removesuffix(".txt") for file in tree()}
    sources = "\n".join(file.read_text(encoding="utf-8") for file in written_files() if file.suffix == ".py")
    known = {name for name in set().union(*map(modules_named, texts.values())) if is_module_or_in_one(name)}
    known |= set(re.findall(r"[A-Z]\w+", sources))
    for page, text in texts.items():
        unknown = ((modules_named(text) | classes_named(text)) - known) | nodes_amiss(text)
        files = "\n".join([*there, *files_written_by(text), ""])
        unknown |= {name for name in paths_named(text) if f"/{name}\n" not in files}
        assert unknown == set(), page


ARCHITECTURE = ROOT / "docs" / "contribute" / "architecture.md"
SYMBOLS = ROOT / "docs" / "reference" / "symbols.md"
TABLE_2 = (
    *("s_i^max", "i", "s_i", "s_i^N", "s_CC^max", "s_CC", "s_CC^N", "d", "S", "t", "P_{S,t}", "M_mk", "σ_S"),
    *("S̄", "l_0, l_1, l_2", "k_s", "K_s", "q", "R", "r_a", "τ_f", r"P_t(d \| τ_f)", "P_{t-1}(d)"),
    *(r"P(τ_f \| d, r_a)", "φ", "G_t", "T", "d_r", "d_est", "p"),
)
"""The paper's notation, as a table of Markdown writes it."""


def names_in(body: list[ast.stmt]) -> set[str]:
    """Return what statements define, what a class defines with the class's name before it."""
    found: set[str] = set()
    for statement in body:
        if isinstance(statement, ast.ClassDef):
            within = names_in(statement.body)
            found |= {statement.name, *(f"{statement.name}.{name}" for name in within)}
        elif isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef)):
            found.add(statement.name)
        elif isinstance(statement, ast.AnnAssign):
            found.add(ast.unparse(statement.target))
        elif isinstance(statement, ast.Assign):
            found |= {ast.unparse(target) for target in statement.targets}
    return found


@pytest.mark.parametrize("page", [ARCHITECTURE, SYMBOLS], ids=lambda page: page.stem)
def test_what_a_page_names_is_where_it_says(page: Path) -> None:
    """Names are written ``file.py:function``, ``file.py:Class.method``, ``Class.method`` or ``Class``."""
    text = page.read_text(encoding="utf-8")
    named = {*re.findall(r"([\w/]+\.py)", text)}
    classes = {*re.findall(r"`([A-Z]\w+)(?:\.\w+)?`", text)}
    sources = {
        f"/{name_of(file)}": file.read_text(encoding="utf-8")
        for folder in ("src", "nodes", "msgs")
        for file in (ROOT / folder).rglob("*.py")
    }
    defined = {
        name: names_in(ast.parse(source).body)
        for name, source in sources.items()
        if name.endswith(tuple(f"/{path}" for path in named))
        or not classes.isdisjoint(re.findall(r"^class (\w+)", source, re.MULTILINE))
    }
    unknown = {
        f"{path}:{name}"
        for path, name in re.findall(r"([\w/]+\.py):([\w.]+)", text)
        if not any(name in names for file, names in defined.items() if file.endswith(f"/{path}"))
    }
    folders = {f"/{name_of(folder)}/" for folder in tree() if folder.is_dir()}
    unknown |= {
        name
        for name in re.findall(r"`((?:\w+/)+)`", text)
        if not any(folder.endswith(f"/{name}") for folder in folders)
    }
    everything = set().union(*defined.values())
    unknown |= {name for name in re.findall(r"`([A-Z]\w+(?:\.\w+)?)`", text) if name not in everything}
    assert unknown == set()


def test_every_symbol_of_the_paper_s_notation_has_a_name_of_ours() -> None:
    rows = re.findall(r"^\| (.+?) \| .+ \| (.*`\w.*) \|$", SYMBOLS.read_text(encoding="utf-8"), re.MULTILINE)
    explained = {symbol for symbol, _ in rows}
    assert set(TABLE_2) - explained == set()


def test_the_architecture_names_every_room() -> None:
    rooms = (ROOT / "src" / "palp_core").glob("*/*/__init__.py")
    text = ARCHITECTURE.read_text(encoding="utf-8")
    wings = ("graph", "palpation", "cli", "view")
    named = [f"{path.parts[-3]}/{path.parts[-2]}/" for path in rooms if path.parts[-3] in wings]
    assert [room for room in named if f"`{room}`" not in text] == []
