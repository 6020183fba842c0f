"""``palp``: launch a graph, look at a running one. Every import waits until a verb needs it."""

import atexit
import gc
import os
import sys
from typing import Annotated

import typer

from palp_core import __version__
from palp_core.cli.lazy import Verb, lazy_app
from palp_core.cli.options import option
from palp_core.cli.output import escape_foreign_characters, note
from palp_core.errors import PalpError

_CLI = "palp_core.cli"


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"palp {__version__}\n")
        raise typer.Exit


def _root(
    *,
    version: Annotated[
        bool, option("Show the version.", "--version", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """What belongs to no verb."""


app = lazy_app(
    {
        "init": Verb(f"{_CLI}.workspace.new:init", "Create a workspace that runs as it is.", part="Graphs"),
        "new": Verb(f"{_CLI}.workspace.new:app", "Create a node, message, policy or driver, with its test."),
        "launch": Verb(f"{_CLI}.launch.launch:launch", "Check a launch file and run its graph."),
        "run": Verb(f"{_CLI}.launch.run:run", "Run one node, alone or in a running graph."),
        "swap": Verb(f"{_CLI}.launch.swap:swap", "Replace a running node's class; no message is lost."),
        "graph": Verb(f"{_CLI}.launch.graph:app", "Show launch files; list and end running graphs."),
        "topic": Verb(
            f"{_CLI}.topic:app", "List, print, measure and publish topics.", part="A running graph"
        ),
        "node": Verb(f"{_CLI}.node.node:app", "List and describe nodes."),
        "service": Verb(f"{_CLI}.node.node:services", "List, describe and call services."),
        "action": Verb(f"{_CLI}.node.action:app", "List and describe actions; send and cancel goals."),
        "param": Verb(f"{_CLI}.node.param:app", "Read and set parameters of running nodes."),
        "lifecycle": Verb(f"{_CLI}.node.node:states", "Show and change the states of running nodes."),
        "interface": Verb(f"{_CLI}.node.interface:app", "Show the types of messages and services."),
        "logs": Verb(f"{_CLI}.launch.logs:logs", "Show node output."),
        "top": Verb(f"{_CLI}.doctor:top", "Show state, CPU, rate, latency and losses live."),
        "view": Verb(f"{_CLI}.view:view", "Show a graph or a bag in the browser."),
        "bridge": Verb(f"{_CLI}.bridge:app", "Connect a running graph to Foxglove or ROS 2."),
        "doctor": Verb(f"{_CLI}.doctor:doctor", "Look for faults of the host and of running graphs."),
        "keys": Verb(f"{_CLI}.launch.keys:app", "Manage keys for graphs on several hosts."),
        "bag": Verb(f"{_CLI}.bag.bag:app", "Record, play, inspect and convert bags.", part="Recordings"),
        "devices": Verb(f"{_CLI}.rig.devices:app", "List, probe and emulate devices.", part="The rig"),
        "safety": Verb(f"{_CLI}.rig.safety:app", "Show the safety node's state; acknowledge a stop."),
        "stop": Verb(f"{_CLI}.rig.safety:stop", "Stop all motion now: ABORT, then DISABLE."),
        "session": Verb(
            f"{_CLI}.session:app",
            "Plan, run, report, compare and export sessions.",
            part="Sessions and science",
        ),
        "emg": Verb(f"{_CLI}.rig.emg:app", "Analyse recorded EMG, and fit a policy to it."),
        "scene": Verb(f"{_CLI}.rig.scene:app", "Choose, explain and run contact models of a scene."),
        "methods": Verb(f"{_CLI}.rig.methods:app", "List and measure methods; explain a run's choices."),
        "study": Verb(f"{_CLI}.rig.study:app", "Run studies: the paper, accuracy, failing methods."),
    },
    text="Robotic palpation as a graph of processes.",
    callback=_root,
)


def main() -> None:
    """Run the command line; palp's own errors are a message and exit status 2, never a traceback."""
    atexit.register(gc.freeze)  # a last look for garbage would take a tenth of a second
    _open_standard_streams()
    escape_foreign_characters()
    # One BLAS thread, before anything imports numpy: the same bytes on every machine, no fight for cores.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    try:
        app(prog_name="palp")
    except PalpError as error:
        note(str(error))
        sys.exit(2)
    except ModuleNotFoundError as error:
        from palp_core.extras import advice

        if not (text := advice(error)):
            raise
        note(text)
        sys.exit(2)
    except UnicodeEncodeError as error:
        wrong = error.object[max(0, error.start - 20) : error.end + 20]
        note(f"{wrong!r} is not UTF-8 text; write it as such")
        sys.exit(2)
    except OSError as error:  # a disk that is full, a folder that is gone: no fault of the program
        where = f"{error.filename}: " if error.filename else ""
        note(f"{where}{error.strerror or error}")
        sys.exit(2)


def _open_standard_streams() -> None:
    """Give a standard stream that is closed the null device, so that no socket gets its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(null, True)
            setattr(sys, name, os.fdopen(null, "w" if number else "r", encoding="utf-8"))


if __name__ == "__main__":
    main()
