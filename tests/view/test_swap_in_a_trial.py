"""The rig's policy swapped from its page in the middle of a trial, which goes on with the new one."""

from __future__ import annotations

import re
import signal
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from palp_core.graph.bag.reader import read
from tests.support.palp import PATIENCE_S, SIM, Palp
from tests.support.view.accounts import Accounts
from tests.support.view.browser import address_of
from tests.support.view.page_socket import PageServer, PageSocket

pytest.importorskip("nicegui")
POLICIES = ("nodes.policy_uniform:Uniform", "nodes.policy_markov:Markov")
SWAPPED = re.compile(r" since ([\d.]+) s; gap")
ENDLESS = (
    "shared.stop:=fixed_number",
    "shared.stop_value:=100000",
    "shared.max_probes:=100000",
    "trials:=1",
    "training:=1",
)
"""A trial that goes on for as long as anybody looks."""


@pytest.mark.nightly
def test_the_policy_is_swapped_in_the_middle_of_a_trial(shared_palp: Palp, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    rig = shared_palp.start("launch", SIM, "--compose", "--record", bag, *ENDLESS, f"out:={tmp_path / 'out'}")
    assert rig.stdout is not None
    for line in rig.stdout:
        if line.startswith("estimation: "):
            break
    server = PageServer(address_of(shared_palp.start("view", "--no-browser", "--graph", "rig")))
    at_s = []
    with closing(PageSocket(server, "/node/policy")) as page:
        for policy in POLICIES:
            page.fill("class", policy)
            page.click("swap")
            found = SWAPPED.search(page.says(f"swapped: {policy} is at work in place of "))
            assert found is not None
            at_s.append(float(found[1]))
    Accounts(shared_palp, "rig", "estimator", "/torque/block").go_on()
    rig.send_signal(signal.SIGINT)
    rig.communicate(timeout=PATIENCE_S)
    commands = [(message.publish_ns / 1e9, message.value.trial) for message in read(bag, ["/policy/command"])]
    within = [
        swap_s
        for swap_s in at_s
        for (before_s, before), (after_s, after) in pairwise(commands)
        if before_s <= swap_s < after_s and before == after
    ]
    assert within == at_s
