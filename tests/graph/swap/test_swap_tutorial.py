"""The tutorial's own policy takes over from the rig's, as its reader would do it."""

import re
import signal
from pathlib import Path

import pytest

from tests.support.palp import ROOT, SIM, Palp, wait_for_line


@pytest.mark.nightly
def test_the_policy_that_the_tutorial_shows_takes_over_in_the_middle_of_a_run(
    palp: Palp, tmp_path: Path
) -> None:
    (source,) = re.findall(
        r"```python\n(# my_policy\.py\n.*?)```", (ROOT / "docs/tutorial/swap.md").read_text(), re.DOTALL
    )
    assert len(source.splitlines()) <= 30
    (tmp_path / "my_policy.py").write_text(source)
    run = palp.start("launch", SIM, "trials:=100000", "training:=3", f"out:={tmp_path / 'out'}")
    wait_for_line(run, "estimation")
    done = palp.run("swap", "policy", tmp_path / "my_policy.py:MyPolicy")
    assert done.returncode == 0, done.stderr
    assert "my_policy.py:MyPolicy at" in done.stdout
    tried = palp.run("swap", "policy", "nodes.policy_uniform:Uniform", "--shadow", "60", "--dry-run")
    assert tried.returncode == 0, tried.stderr
    assert "messages of both compared" in tried.stdout
    assert palp.run("swap", "policy", "--reload").returncode == 0
    refused = palp.run("swap", "stage", "nodes.stage:Stage")
    assert refused.returncode == 11
    assert "safe state" in refused.stderr
    run.send_signal(signal.SIGINT)
    assert run.wait() == 128 + signal.SIGINT
