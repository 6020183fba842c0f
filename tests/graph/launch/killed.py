"""A launcher that is killed, with all that it has started, when a message comes: no sleep decides where."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.support.palp import PATIENCE_S, ROOT, Palp

_COMMAND = (sys.executable, "-m", "tests.graph.launch.killed")


def launch_and_kill(palp: Palp, file: Path, topic: str, sequence: int, *overrides: str) -> None:
    """Launch a graph, and kill the whole group with SIGKILL as a message of a topic is published.

    With no topic, as any message is shown after so many checkpoints have been written.
    """
    done = _launched(palp, (str(file), topic, str(sequence), "begin", *overrides))
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert palp.all_gone()


def launch_to_its_end(palp: Palp, file: Path, *overrides: str) -> None:
    """Resume a graph that was killed; with all that it records it comes to its end."""
    done = _launched(palp, (str(file), "", str(sys.maxsize), "resume", *overrides))
    assert done.returncode == 0, done.stderr


def _launched(palp: Palp, words: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*_COMMAND, *words],
        env={**palp.environment, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'src'}"},
        cwd=ROOT,
        start_new_session=True,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def main() -> None:
    """Launch, and kill the group when the message comes."""
    from palp_core.errors import PalpError
    from palp_core.graph.messages.frame import parse
    from tests.support.rig_session import BriefGraph

    file, topic, sequence, how, *overrides = sys.argv[1:]

    def observe(_: int, frame: bytes) -> None:
        found = parse(frame)
        reached = found.sequence if topic else graph.checkpoints.count
        if found.topic == (topic or found.topic) and reached >= int(sequence):
            os.killpg(os.getpgrp(), signal.SIGKILL)

    graph = BriefGraph(file, resume=how == "resume", observe=observe, overrides=overrides)
    try:
        with graph:
            summary = graph.run()
    except PalpError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(2)
    sys.exit(summary.exit_code or int(not graph.recorders.complete))


if __name__ == "__main__":
    main()
