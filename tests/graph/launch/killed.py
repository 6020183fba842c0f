"""A launcher that is killed, with all that it has started, when a message comes: no sleep decides where."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.support.palp import PATIENCE_S, ROOT, Palp

_COMMAND = (sys.executable, "-m", "tests.graph.launch.killed")


def launch_and_kill(
    palp: Palp, file: Path, topic: str, sequence: int, *overrides: str, compose: bool, record: str = ""
) -> None:
    """Launch a graph, and kill the whole group with SIGKILL as a message of a topic is published.

    With no topic, as any message is shown after so many checkpoints have been written.
    """
    words = (str(file), topic, str(sequence), "composed" if compose else "processes", record, *overrides)
    done = _launched(palp, words)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert palp.all_gone()


def launch_and_end(
    palp: Palp, file: Path, topic: str, sequence: int, *overrides: str, compose: bool, record: str = ""
) -> None:
    """Launch a graph, and ask it to end, as Ctrl-C does, as a message of a topic is published.

    Of the checkpoints it writes the first one and the one at the end.
    """
    how = "composed" if compose else "processes"
    done = _launched(palp, (str(file), topic, str(sequence), f"{how} asked", record, *overrides))
    assert done.returncode == 130, done.stderr
    assert palp.all_gone()


def launch_to_its_end(
    palp: Palp, file: Path, *overrides: str, compose: bool, record: str = "", resume: bool = False
) -> None:
    """Launch a graph, or go on with it, as the others do; with all that it records it comes to its end."""
    how = ("composed" if compose else "processes") + (" resumed" if resume else "")
    done = _launched(palp, (str(file), "", str(sys.maxsize), how, record, *overrides))
    assert done.returncode == 0, done.stderr


def command(file: Path, how: str, *overrides: str) -> list[str]:
    """Return the command that launches a graph to its end: composed, or composed resumed."""
    return [*_COMMAND, str(file), "", str(sys.maxsize), how, "", *overrides]


def environment(palp: Palp) -> dict[str, str]:
    """Return what the command needs."""
    return {**palp.environment, "PYTHONHASHSEED": "0", "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'src'}"}


def _launched(palp: Palp, words: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*_COMMAND, *words],
        env=environment(palp),
        cwd=ROOT,
        start_new_session=True,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def main() -> None:
    """Launch, and kill oneself, or ask oneself to end."""
    from palp_core.errors import PalpError
    from palp_core.graph.launch import checkpoints
    from palp_core.graph.messages.frame import parse
    from palp_core.graph.supervision.interrupt import Interrupted
    from tests.support.rig_session import BriefGraph

    file, topic, sequence, how, record, *overrides = sys.argv[1:]

    def observe(_: int, frame: bytes) -> None:
        found = parse(frame)
        reached = found.sequence if topic else graph.checkpoints.cost.count
        if found.topic == (topic or found.topic) and reached >= int(sequence):
            os.kill(os.getpid(), signal.SIGINT) if asked else os.killpg(os.getpgrp(), signal.SIGKILL)

    asked = how.endswith(" asked")
    checkpoints.EVERY_NS = sys.maxsize if asked else 0  # or each that is due
    graph = BriefGraph(
        file,
        compose=how.startswith("composed"),
        resume=how.endswith(" resumed"),
        observe=observe,
        overrides=overrides,
        record=record or None,
    )
    try:
        with graph:
            summary = graph.run()
    except Interrupted:
        sys.exit(130)
    except PalpError as error:
        sys.stderr.write(f"{error}\n")
        if graph.summary is not None:
            sys.stderr.write(f"{graph.summary.report}\n")
        sys.exit(2)
    sys.exit(summary.exit_code or int(not graph.recorders.complete))


if __name__ == "__main__":
    main()
