"""``palp``: launch a graph, look at a running one. Heavy imports wait until a verb needs them."""

from __future__ import annotations

import os
import sys

import typer

from palp_core.cli import bag, graph, launch, node, replay, topic
from palp_core.errors import PalpError

__all__ = ["app", "main"]

app = typer.Typer(
    name="palp",
    help="Robotic palpation as a graph of processes.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("launch", help="Check a launch file, run its graph, end it cleanly.")(launch.launch)
app.command("graph", help="Draw a launch file's graph.")(graph.graph)
app.add_typer(node.app, name="node")
app.add_typer(topic.app, name="topic")
bag.app.command("replay")(replay.replay)
app.add_typer(bag.app, name="bag")


def main() -> None:
    """Run the command line; palp's own errors are a message and exit status 2, never a traceback."""
    _open_standard_streams()
    # One BLAS thread, before anything imports numpy: the same bytes on every machine, no fight for cores.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    try:
        app()
    except PalpError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    except BrokenPipeError:  # the reader of our output has gone, as in `palp topic echo ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(0)


def _open_standard_streams() -> None:
    """Give a standard stream that is closed the null device, so that no socket gets its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(null, True)
            setattr(sys, name, os.fdopen(null, "w" if number else "r", encoding="utf-8"))


if __name__ == "__main__":
    main()
