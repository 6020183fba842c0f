"""A launcher that is killed, with all that it has started, when a message comes: no sleep decides where."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.support.palp import PATIENCE_S, ROOT, Palp


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


def _launched(palp: Palp, words: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.graph.launch.killed", *words],
        env={**palp.environment, "PYTHONHASHSEED": "0", "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'src'}"},
        cwd=ROOT,
        start_new_session=True,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def main() -> None:
    """Launch, and kill oneself, or ask oneself to end."""
    from palp_core.graph.launch import checkpoints
    from palp_core.graph.launch.graph import Graph
    from palp_core.graph.messages.frame import parse
    from palp_core.graph.supervision.interrupt import Interrupted

    file, topic, sequence, how, record, *overrides = sys.argv[1:]

    def observe(_: int, frame: bytes) -> None:
        found = parse(frame)
        reached = found.sequence if topic else graph.checkpoints.cost.count
        if found.topic == (topic or found.topic) and reached >= int(sequence):
            os.kill(os.getpid(), signal.SIGINT) if asked else os.killpg(os.getpgrp(), signal.SIGKILL)

    asked = how.endswith(" asked")
    checkpoints.EVERY_NS = sys.maxsize if asked else 0  # or each that is due
    compose = how.startswith("composed")
    try:
        with Graph(
            file, compose=compose, observe=observe, overrides=overrides, record=record or None
        ) as graph:
            graph.run()
    except Interrupted:
        sys.exit(130)


if __name__ == "__main__":
    main()
