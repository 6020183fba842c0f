"""Record the golden runs anew, after a change that is meant to change what a node says.

Each recording holds a short run of ``launch/sim.yaml``: what its nodes consumed and in which order, and what
they published. ``test_golden.py`` drives every node from it and shows the first output that differs. The
reason for renewing them is kept with them, and shown with every failure.

Run: .venv/bin/python tests/golden/renew.py --reason "the estimator rounds to 1 uN m" [session sweep emg]
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import msgspec
import yaml

from palp_core.graph.bag.edit import copy_messages
from palp_core.graph.bag.reader import Bag, RecordedMessage
from palp_core.graph.bag.recorder import SUMMARY_NAME
from palp_core.graph.bag.rounds import NODES_ATTACHMENT
from palp_core.graph.bag.writer import BagWriter
from palp_core.graph.description.checked import resolved_yaml
from palp_core.graph.launch.graph import Graph, check_file
from palp_core.graph.messages.builtin import Order
from palp_core.graph.messages.message import decode, encode
from palp_core.graph.node.spec import NodeSpec

HERE = Path(__file__).parent
SIM = HERE.parents[1] / "launch" / "sim.yaml"
ARGUMENTS = ("trials:=1", "training:=1", "seed:=1")
REASON = "golden/reason"
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


def main() -> None:
    """Record what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reason", required=True, help="why the outputs differ from now on")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(GOLDEN)}; default: all")
    options = parser.parse_args()
    if unknown := [name for name in options.names if name not in GOLDEN]:
        parser.error(f"no golden recording {', '.join(unknown)}; there are: {', '.join(GOLDEN)}")
    if os.environ.get("PYTHONHASHSEED") != "0":  # sets in the order they have in nodes' processes
        os.execve(sys.executable, sys.orig_argv, {**os.environ, "PYTHONHASHSEED": "0"})
    for name in options.names or GOLDEN:
        renew(name, options.reason)
        sys.stdout.write(f"{name}: {(HERE / f'{name}.mcap').stat().st_size} bytes\n")


def renew(name: str, reason: str) -> None:
    """Run the rig and keep what the nodes of one recording consumed and said."""
    golden = GOLDEN[name]
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder, "whole")
        with Graph(short_rig(Path(folder)), compose=True, record=whole) as graph:
            graph.run(golden.until_s)
        with Bag(whole) as bag, BagWriter(Path(folder, name), chunk_bytes=1 << 22) as writer:
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
            writer.add_metadata(REASON, {"reason": reason})
            copy_messages(lean(bag.recorded(topics)), writer)
        shutil.move(next(Path(folder, name).glob("*.mcap")), HERE / f"{name}.mcap")


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
