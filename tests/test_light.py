"""Nothing loads what it does not use. A chain of steps is one interpreter, which looks after every step."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import blocks
from tests.support.palp import PATIENCE_S, ROOT, Palp

HEAVY = (
    *("palp_core.palpation", "matplotlib", "pandas", "pywt", "scipy", "skfem", "statsmodels"),
    *("serial", "can", "rosbags", "jinja2", "pyarrow", "nicegui"),
)
FOR_VERBS = (
    "numpy",
    "msgspec",
    "msgpack",
    "zmq",
    "psutil",
    "yaml",
    "rich",
    "scipy",
    "matplotlib",
    "pydantic",
)
GRAPH = (
    *("palp_core.graph", "palp_core.palpation.devices", "palp_core.palpation.session"),
    *("palp_core.palpation.studies", "palp_core.cli", "zmq"),
)

LOOK = """
import json, sys
for program, never in json.loads(sys.argv[1]):
    exec(program, {})
    found = [name for name in sys.modules if any(f"{name}.".startswith(f"{one}.") for one in never)]
    assert not found, f"{program}\\nloads {found}"
"""
TYPED = """
import sys
from palp_core.cli.main import main
sys.argv = ["palp", *{}]
try:
    main()
except SystemExit as end:
    assert end.code == {}
"""
ONLY_ITS_NAMES = """
import palp_core, sys
assert {name for name in sys.modules if name.startswith("palp_core.")} == {"palp_core.lazy_names"}
"""
EVERY_ROOM = """
import importlib, pkgutil
import palp_core.graph
names = [found.name for found in pkgutil.walk_packages(palp_core.graph.__path__, "palp_core.graph.")]
assert len(names) > 100
for name in names:
    importlib.import_module(name)
"""
EVERY_METHOD = """
from palp_core.methods import methods, tasks
assert sum(len(methods(task.name)) for task in tasks()) > 25
"""
EVERY_DRIVER = """
from palp_core.palpation.devices.registry import back_end, drivers
for one in drivers():
    back_end(*one)
"""
CHAINS: dict[str, list[tuple[str, tuple[str, ...]]]] = {
    "the face and the graph": [
        (ONLY_ITS_NAMES, ()),
        (TYPED.format(["--help"], 0), FOR_VERBS),
        (TYPED.format(["launch", "none.yaml", "--check"], 2), HEAVY),
        (TYPED.format(["topic", "echo", "/a/b"], 2), HEAVY),
        (TYPED.format(["bag", "info", "none"], 2), HEAVY),
        ("from palp_core import *\nimport palp_core.graph.process.main", ("palp_core.methods", *HEAVY)),
        (EVERY_ROOM, HEAVY),
    ],
    "a node of the rig, and drivers": [
        ("import palp_core.graph.process.main, nodes.rig_torque", ("palp_core.methods",)),
        ("import palp_core.palpation.devices", ("serial", "can", "pylsl")),
        (EVERY_DRIVER, ("palp_core.palpation.devices.sim",)),
    ],
    "mechanics": [
        ("from palp_core.palpation.mechanics import Scene, run_scene\nrun_scene(Scene())", GRAPH),
    ],
    "reports, and what the register lists": [
        (
            "from palp_core.palpation.perception.statistics.statistics import wilson\nwilson(3, 4)",
            ("scipy",),
        ),
        ("import palp_core.palpation.reporting.html_page", ("jinja2",)),
        ("import palp_core.palpation.session.report", ("matplotlib",)),
        (EVERY_METHOD, ("scipy.signal", "scipy.stats", "matplotlib")),
    ],
}


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_nothing_loads_what_it_does_not_use(chain: list[tuple[str, tuple[str, ...]]]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOOK, json.dumps(chain)],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


SPY = """
import json, sys
from palp_core import Node
class Spy(Node):
    def on_activate(self):
        with open("loaded.json", "w") as file:
            json.dump(list(sys.modules), file)
"""


def test_a_running_graph_loads_nothing_of_palpation_and_nothing_heavy(palp: Palp, tmp_path: Path) -> None:
    """Neither the launcher nor a node's process does, in the tutorial's graph."""
    text = (ROOT / "docs/tutorial/first_node.md").read_text(encoding="utf-8")
    for block in blocks(text):
        if block.file in ("count.py", "count.yaml"):
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
    (tmp_path / "spy.py").write_text(SPY, encoding="utf-8")
    with (tmp_path / "count.yaml").open("a", encoding="utf-8") as file:
        file.write("  spy: {run: spy.py:Spy}\n")
    program = "from palp_core import Graph\nwith Graph('count.yaml') as graph:\n    graph.run()"
    spied = "import json, sys\nsys.modules.update(dict.fromkeys(json.load(open('loaded.json'))))"
    done = subprocess.run(
        [sys.executable, "-c", LOOK, json.dumps([(program, HEAVY), (spied, HEAVY)])],
        cwd=tmp_path, env=palp.environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
