"""Somebody who presses everything at a viewer until killed: swaps of the policy, page after page.

Run by stop.py: python -m benchmarks.view_bench.presses ADDRESS
"""

from __future__ import annotations

import itertools
import sys

from benchmarks.view_bench.running import quietly
from tests.support.view.browser import Page, chromium, chromium_running

POLICIES = ("nodes.policy_uniform:Uniform", "nodes.policy_markov:Markov")
PAGES = ("/", "/topics", "/topic/torque/block", "/timeline", "/node/estimator")


def main() -> None:
    """Press."""
    with chromium_running(chromium()) as chrome:
        viewing = Page(chrome, sys.argv[1])
        viewing.page.set_default_timeout(20_000)
        print("pressing", flush=True)
        for number in itertools.count():
            quietly(lambda: swap(viewing, POLICIES[number % 2]))  # noqa: B023 - done at once
            for page in PAGES:
                quietly(lambda: viewing.go(page))  # noqa: B023


def swap(viewing: Page, run: str) -> None:
    """Let another policy take over, and see how that goes."""
    viewing.go("/node/policy")
    viewing.swap(run)
    viewing.says("->")


if __name__ == "__main__":
    main()
