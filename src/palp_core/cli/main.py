"""``palp``: launch a graph, look at a running one. Every import waits until a verb needs it."""

import os
import sys
from typing import Annotated

import typer

from palp_core import __version__
from palp_core.cli.lazy import Verb, lazy_app
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
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Tell the version.")
    ] = False,
) -> None:
    """What belongs to no verb."""


app = lazy_app(
    "Robotic palpation as a graph of processes.",
    {
        "init": Verb(
            f"{_CLI}.workspace.init:init",
            "Write a workspace of one's own: nodes, messages, launch file, tests; it runs as it is.",
            part="Graphs",
        ),
        "new": Verb(
            f"{_CLI}.workspace.new:app",
            "Write a node, message, policy or driver, with its test, into the workspace one is in.",
        ),
        "launch": Verb(f"{_CLI}.launch.launch:launch", "Check a launch file, run its graph, end it cleanly."),
        "run": Verb(f"{_CLI}.launch.run:run", "Run one node on the machine's clock, or add it to a graph."),
        "swap": Verb(f"{_CLI}.launch.swap:swap", "Let another class take a running node's place."),
        "graph": Verb(
            f"{_CLI}.launch.graph:app",
            "Draw a launch file's graph (palp graph FILE), list the running ones, or end one.",
        ),
        "topic": Verb(f"{_CLI}.topic.topic:app", "Topics of the running graph.", part="A running graph"),
        "node": Verb(f"{_CLI}.node.node:app", "Nodes of the running graph."),
        "service": Verb(f"{_CLI}.node.service:app", "Services of the running graph."),
        "action": Verb(f"{_CLI}.node.action:app", "Actions of the running graph."),
        "param": Verb(f"{_CLI}.node.param:app", "Parameters of running nodes."),
        "lifecycle": Verb(f"{_CLI}.node.lifecycle:app", "States of running nodes."),
        "interface": Verb(f"{_CLI}.node.interface:app", "Types of messages and services."),
        "logs": Verb(f"{_CLI}.launch.logs:logs", "Show what nodes have printed."),
        "top": Verb(f"{_CLI}.doctor.top:top", "Show live how the nodes of a graph do."),
        "view": Verb(f"{_CLI}.view.view:view", "Show a running graph, a bag or results in the browser."),
        "foxglove": Verb(
            f"{_CLI}.topic.foxglove:foxglove",
            "Show a running graph in Foxglove: topics, log, parameters, services.",
        ),
        "ros2": Verb(f"{_CLI}.ros2.ros2:app", "A running graph beside ROS 2."),
        "doctor": Verb(f"{_CLI}.doctor.doctor:doctor", "Look for what is wrong with host and graph."),
        "wtf": Verb(f"{_CLI}.doctor.doctor:doctor", "The same as doctor.", hidden=True),
        "keys": Verb(f"{_CLI}.launch.keys:app", "Keys for graphs that reach beyond this host."),
        "bag": Verb(f"{_CLI}.bag.bag:app", "Recordings.", part="Recordings"),
        "devices": Verb(
            f"{_CLI}.rig.devices:app", "Devices: which there are, try them, emulate them.", part="The rig"
        ),
        "safety": Verb(f"{_CLI}.rig.safety:app", "The safety node of the running graph."),
        "stop": Verb(
            f"{_CLI}.rig.safety:stop",
            "Stop all motion now: ABORT, then DISABLE.",
        ),
        "phantom": Verb(f"{_CLI}.rig.phantom:app", "Phantoms: their gel, from sweeps over it."),
        "session": Verb(
            f"{_CLI}.session.session:app",
            "Sessions: their sheets, with people, by operators, and what was decided about their trials.",
            part="Sessions",
        ),
        "sessions": Verb(
            f"{_CLI}.session.sessions:sessions",
            "List the sessions below a folder and pool them, with intervals over subjects or sessions.",
        ),
        "report": Verb(
            f"{_CLI}.rig.report:report", "Make the report of a stored session, whole or cut short."
        ),
        "why": Verb(
            f"{_CLI}.rig.why:why",
            "Tell which methods a run used and why, what was refused, what they met and what they cost.",
        ),
        "analyse": Verb(
            f"{_CLI}.rig.analyse:analyse",
            "Decide sessions' stored sweeps again with other methods, or judge the trials of any table.",
        ),
        "export": Verb(
            f"{_CLI}.session.export:export",
            "Write a session for other tools: trials, iterations, sweeps, EMG, each a tidy table.",
        ),
        "emg": Verb(
            f"{_CLI}.rig.emg:app", "Recorded EMG: co-contraction, bursts, levels, quality.", part="Muscles"
        ),
        "markov": Verb(f"{_CLI}.rig.markov:app", "Strategies of stiffness levels, learnt from EMG."),
        "scene": Verb(
            f"{_CLI}.rig.scene:app",
            "Scenes: which model, why, and what comes out.",
            part="Methods and studies",
        ),
        "methods": Verb(
            f"{_CLI}.rig.methods:methods",
            "List the methods of every task, cheapest first, and their state in a scene.",
        ),
        "tradeoff": Verb(
            f"{_CLI}.rig.tradeoff:tradeoff",
            "Measure error against time of every method in a scene, and draw one page.",
        ),
        "study": Verb(
            f"{_CLI}.rig.study:app", "Studies: the paper re-run, speed against accuracy, where methods fail."
        ),
        "cache": Verb(f"{_CLI}.rig.cache:app", "Set-ups of contact models, kept on disk."),
    },
    add_completion=True,
    callback=_root,
)


def main() -> None:
    """Run the command line; palp's own errors are a message and exit status 2, never a traceback."""
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

        if not (words := advice(error)):
            raise
        note(words)
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
