"""Record the golden runs again, after a change that is meant to change what a node says.

Each recording holds a short run of ``launch/sim.yaml``: what its nodes consumed and in which order, and what
they published. ``test_golden.py`` drives every node from it and shows the first output that differs.

This prints the first difference of each topic. A recording that differs is replaced only with a reason.
Reason and differences are then kept in ``renewed.yaml``; a recording that is equal stays as it is.

Run: .venv/bin/python tests/golden/renew.py [--reason "the estimator rounds to 1 uN m"] [session sweep emg]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import msgspec
import yaml

from palp_core.graph.bag.diff import diff_bags, first_difference
from palp_core.graph.bag.edit import copy_messages
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.rounds import NODES_ATTACHMENT
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.description.checked import resolved_yaml
from palp_core.graph.launch.checking import check_file
from palp_core.graph.launch.graph import Graph
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.node.spec import NodeSpec

HERE = Path(__file__).parent
SIM = HERE.parents[1] / "launch" / "sim.yaml"
ARGUMENTS = ("trials:=1", "training:=1", "seed:=1")
RENEWED = "renewed.yaml"
"""Beside the recordings: of each the reason why it was renewed last, and what differed then."""
RELATIVE, TOLERANCE = 1e-9, 1e-12
"""What another processor may change, whose vector instructions round otherwise: parts, and SI units."""
OUT = {"out": "record"}
"""Where the experiment keeps its record: below the folder from which it is driven again."""


class Golden(msgspec.Struct, frozen=True):
    """A recording: which nodes it is of, what they read besides each other, until when it lasts."""

    nodes: tuple[str, ...]
    read: tuple[str, ...]
    until_s: float


GOLDEN = {
    "session": Golden(
        ("estimator", "policy", "experiment", "actuator"),
        (
            "/torque/block",
            "/stage/status",
            "/phantom/truth",
            "/phantom/guard",
            "/cocontraction/cocontraction",
        ),
        160.0,
    ),
    "sweep": Golden(
        ("stage", "phantom", "torque"), ("/experiment/goal", "/experiment/mount", "/actuator/truth"), 8.6
    ),
    "emg": Golden(("emg", "cocontraction"), (), 9.2),
}


def main(
    words: Sequence[str] | None = None,
    folder: Path = HERE,
    recorded: Callable[[str, Path], Path] | None = None,
) -> None:
    """Record what is asked for, print what differs, and keep it if there is a reason."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reason", help="why the outputs differ from now on; without it nothing is written")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(GOLDEN)}; default: all")
    options = parser.parse_args(words)
    if unknown := [name for name in options.names if name not in GOLDEN]:
        parser.error(f"no golden recording {', '.join(unknown)}; there are: {', '.join(GOLDEN)}")
    if os.environ.get("PYTHONHASHSEED") != "0":  # sets in the order they have in nodes' processes
        os.execve(sys.executable, sys.orig_argv, {**os.environ, "PYTHONHASHSEED": "0"})
    different = []
    for name in options.names or GOLDEN:
        old = folder / f"{name}.mcap"
        with tempfile.TemporaryDirectory() as place:
            new = (recorded or record)(name, Path(place))
            found = differences(old, new)
            sys.stdout.write("\n  ".join([f"{name}:", *(found or ["equal"])]) + "\n")
            if found:
                different.append(name)
            if found and options.reason:
                shutil.move(new, old)
                keep(folder / RENEWED, name, {"reason": options.reason, "differences": found})
    if different and not options.reason:
        sys.exit(f'{", ".join(different)}: not renewed; if that is meant, say why: --reason "..."')


def close(a: float, b: float) -> bool:
    """Tell whether two numbers differ by no more than another processor may change."""
    return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=TOLERANCE)


def differences(old: Path, new: Path) -> list[str]:
    """Return the first difference of each topic, and that of the nodes' entries."""
    if not old.exists():
        return [f"{old.name} is new"]
    found = diff_bags(old, new, tolerance=TOLERANCE, relative=RELATIVE)
    lines = [f"{topic}: {one.first.text()}" for topic, one in found.items() if one.first is not None]
    if (entry := first_difference(entries(old), entries(new), close)) is not None:
        lines.append("nodes: {}: {} != {}".format(*entry))
    return lines


def entries(path: Path) -> dict[str, Any]:
    """Return what the graph of a recording says of each node."""
    with Bag(path) as bag:
        return {spec["name"]: spec for spec in json.loads(bag.attachments()[NODES_ATTACHMENT])}


def keep(file: Path, name: str, why: dict[str, Any]) -> None:
    """Write down why a recording was renewed, in the place of what was said before."""
    kept = yaml.safe_load(file.read_text(encoding="utf-8")) if file.exists() else {}
    text = yaml.safe_dump({**kept, name: why}, sort_keys=False, allow_unicode=True, width=100)
    file.write_text(text, encoding="utf-8")


def record(name: str, folder: Path) -> Path:
    """Run the rig and write what the nodes of one recording consumed and said; return the file."""
    golden, whole = GOLDEN[name], folder / "whole"
    with Graph(short_rig(folder), compose=True, record=whole) as graph:
        graph.run(golden.until_s)
    with Bag(whole) as bag, BagWriter(folder / name, chunk_bytes=1 << 22) as writer:
        attached = bag.attachments()
        specs = [
            msgspec.structs.replace(
                spec, params={**spec.params, **OUT} if "out" in spec.params else spec.params
            )
            for spec in msgspec.json.decode(attached[NODES_ATTACHMENT], type=list[NodeSpec])
        ]
        writer.attach(NODES_ATTACHMENT, msgspec.json.encode(specs), "application/json")
        topics = [t for t in bag.topics() if t.split("/")[1] in golden.nodes] + list(golden.read)
        account = json.loads(attached[SUMMARY_NAME])
        account["topics"] = {t: entry for t, entry in account["topics"].items() if t in topics}
        writer.attach(SUMMARY_NAME, json.dumps(account).encode(), "application/json")
        copy_messages(lean(bag.recorded(topics)), writer)
    return next((folder / name).glob("*.mcap"))


def short_rig(folder: Path) -> Path:
    """Write the launch file of the simulated rig, with a subject who palpates for a moment only.

    EMG weighs most, and a moment of it shows what its nodes do.
    """
    tree = yaml.safe_load(resolved_yaml(check_file(SIM, ARGUMENTS)))
    tree["nodes"]["emg"]["params"]["palpation_s"] = 0.5
    tree["nodes"]["experiment"]["params"]["out"] = str(folder / "out")
    for name in ("nodes", "msgs"):
        (folder / name).symlink_to(SIM.parents[1] / name)
    (folder / "launch").mkdir()
    file = folder / "launch" / "rig.yaml"
    file.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return file


def lean(messages: Iterator[RecordedMessage]) -> Iterator[RecordedMessage]:
    """Leave out the states written down on the way: a golden run is driven from its beginning."""
    for message in messages:
        if message.stream.topic.name.endswith("/_order"):
            order = msgspec.structs.replace(decode(Order, message.payload), hand_over=b"")
            yield message._replace(payload=encode(order))
        else:
            yield message


if __name__ == "__main__":
    main()
