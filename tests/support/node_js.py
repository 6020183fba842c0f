"""Packages of Node.js for a test, installed in a folder of its own."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.palp import PATIENCE_S


def node_with(folder: Path, *packages: str) -> str:
    """Install packages, or what ``package.json`` in the folder names; return where Node.js is.

    Without Node.js, npm or a source of packages, skip the test.
    """
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("needs node and npm: apt-get install npm")
    quiet = ("--ignore-scripts", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=0")
    try:
        done = subprocess.run(
            [npm, "install", *quiet, *packages],
            cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        pytest.skip(f"needs packages of Node.js: npm install has not ended within {PATIENCE_S:g} s")
    if done.returncode:
        pytest.skip(f"needs packages of Node.js: {done.stderr.strip().partition(chr(10))[0]}")
    return node
