"""Swaps under faults: each turn swaps the relay of a running graph and kills or stops one of its processes.

A turn is a function of seed and number, so that one alone can be run again (``--first``). After each, what
the processes have on tape is judged (:mod:`.storm_tapes`), and all readers must hear new numbers.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import psutil
from swap_bench.storm_tapes import (
    BY,
    INDEX,
    LIFE,
    READER,
    Deaths,
    Judge,
    Rows,
    Verdict,
    reached,
    read_tape,
)

from palp_core.errors import GraphError
from palp_core.graph.discovery.run_directory import RunRecord
from palp_core.graph.discovery.running_graph import RunningGraph
from palp_core.whole_file import write_whole

LAUNCH = Path(__file__).parent / "launch/storm.yaml"
READERS = ("reliable", "best_effort", "latched")
VICTIMS = ("old", "new", "reader", "source", "launcher")
FAULTS = ("none", *(f"{deed} {who}" for who in VICTIMS for deed in ("kill", "stop")))
STEPS = ("configure", "state", "take over", "first number", "leave")
"""Where the new process can strike, and the old one as it leaves; instants fall anywhere else, too."""

STOPS_S = (0.2, 1.0, 3.0, 12.0)
"""How long a stop lasts at most, the rarest last."""

GIVEN_UP_S = 9.0
"""A stop that lasts longer than this may make palp, which waits 10 s, start another process."""

MARK = "PALP_STORM"
COUNTED = ("lost", "repeated", "reordered", "explained")
POLL_S = 0.005
FLOW_S = 60.0
"""Within which every reader must hear new numbers after a fault: six times palp's patience with a node."""

END_S = 30.0
"""Within which everything has ended after the launcher was killed."""


@dataclass(frozen=True)
class Plan:
    """What a turn does.

    Attributes:
        fault: One of :data:`FAULTS`.
        reader: Which reader, if it is a reader's.
        step: At which step of the swap; "": at an instant.
        instant: That, as a share of the time that a swap takes.
        stop_s: How long a stop lasts.
    """

    fault: str
    reader: str
    step: str
    instant: float
    stop_s: float

    @classmethod
    def drawn(cls, seed: int, number: int) -> Plan:
        """Draw the plan of a turn."""
        chance = random.Random(f"{seed}:{number}")
        fault = FAULTS[number % len(FAULTS)]  # each as often as the others
        reader = chance.choice(READERS)
        step = chance.choice(STEPS) if chance.random() < 0.5 else ""
        longest_s = chance.choices(STOPS_S, (8, 8, 4, 1))[0]
        return cls(fault, reader, step, chance.uniform(0.0, 1.3), longest_s * chance.uniform(0.5, 1.0))


@dataclass
class Turn:
    """What came of one.

    Attributes:
        outcome, text: ``swapped``, or the step that failed or refused, and why.
        struck, victim: Whether the signal was sent, and to which process.
        flow_s: From the fault's end until all readers heard new numbers; of a killed launcher: to the end.
        wrong: What was not as promised.
    """

    number: int
    plan: Plan
    outcome: str = ""
    text: str = ""
    struck: bool = False
    victim: int = 0
    flow_s: float = 0.0
    verdicts: dict[str, Verdict] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)


class Stranded(Exception):
    """The graph is not alive, or a reader hears nothing."""


def marked(value: str) -> list[psutil.Process]:
    """Return all living processes of a graph, known by a variable in their environment."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.environ().get(MARK) == value and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


def rest(seconds: float) -> None:
    """Let time go by in which nothing can be waited for."""
    threading.Event().wait(seconds)


class Storm:
    """One graph after another, and what is on their tapes.

    Args:
        seed: Of the plans.
        folder: Where the tapes are, and what is kept of a turn that went wrong.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        self._seed, self._folder = seed, folder
        self._launch_count = self._births = 0
        self._swap_s = 1.0  # a guess, until one was made
        self._launcher: subprocess.Popen[bytes] | None = None

    # The graph

    def launch(self) -> None:
        """Start a graph on new tapes; return when every reader hears it."""
        self._launch_count += 1
        self._mark = uuid.uuid4().hex
        self.tapes = self._folder / f"launch{self._launch_count}"
        self.tapes.mkdir(parents=True)
        self._runtime = Path(tempfile.mkdtemp(prefix="storm-", dir="/tmp"))  # short enough for sockets
        environment = {**os.environ, MARK: self._mark, "XDG_RUNTIME_DIR": str(self._runtime)}
        command = [sys.executable, "-m", "palp_core", "launch", str(LAUNCH), f"out:={self.tapes}"]
        with (self.tapes / "launcher.txt").open("wb") as output:
            self._launcher = subprocess.Popen(command, stdout=output, stderr=output, env=environment)
        self._judges = {name: Judge(best_effort=name == "best_effort") for name in READERS}
        self.wait(
            lambda: all(len(self.tape(name)) for name in READERS), "not every reader has heard anything"
        )
        (record,) = (self._runtime / "palp").glob("*/graph.json")
        self.graph = RunningGraph(msgspec.json.decode(record.read_bytes(), type=RunRecord))

    def end(self) -> None:
        """End the graph, in order if it can."""
        assert self._launcher is not None
        self._launcher.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._launcher.wait(END_S)
        self.sweep()

    def sweep(self) -> list[int]:
        """Kill what is left of the graph, and return whom."""
        assert self._launcher is not None
        left = marked(self._mark)
        for process in left:
            with contextlib.suppress(psutil.Error):
                process.kill()
        self._launcher.wait()
        shutil.rmtree(self._runtime, ignore_errors=True)
        return [process.pid for process in left]

    def tape(self, name: str) -> Rows:
        """Return what is on a tape by now."""
        return read_tape(self.tapes, name)

    def wait(self, condition: Callable[[], bool], failure: str, within_s: float = FLOW_S) -> float:
        """Wait until something is so; return how long it took, in s.

        Raises:
            Stranded: It is not so in time, or the graph has ended.
        """
        assert self._launcher is not None
        begun_s = time.monotonic()
        while not condition():
            if self._launcher.poll() is not None:
                raise Stranded(f"the graph has ended with status {self._launcher.returncode}")
            if time.monotonic() - begun_s > within_s:
                raise Stranded(f"{failure} within {within_s:g} s")
            rest(10 * POLL_S)
        return time.monotonic() - begun_s

    # One turn

    def turn(self, number: int) -> Turn:
        """Swap the relay, do the fault, and judge."""
        turn = Turn(number, Plan.drawn(self._seed, number))
        try:
            former = int(self.tape("passed")[-1, BY])
            self._swap(turn, former)
            if turn.struck and turn.plan.fault == "kill launcher":
                self._expect_end(turn, former)
            else:
                self._expect_flow(turn, former)
        except Stranded as stranded:
            turn.wrong.append(str(stranded))
        for name, verdict in turn.verdicts.items():
            if verdict.faults:
                turn.wrong.append(f"{name}: {verdict}")
        if turn.wrong:
            self._keep(turn)
        if turn.wrong or (turn.struck and turn.plan.fault == "kill launcher"):
            turn.wrong += self._launch_anew(turn)
        return turn

    def _launch_anew(self, turn: Turn) -> list[str]:
        self.sweep()
        if not turn.wrong:
            shutil.rmtree(self.tapes)
        try:
            self.launch()
        except Stranded as stranded:
            return [f"launched again: {stranded}"]
        return []

    def _swap(self, turn: Turn, former: int) -> None:
        """Ask for the swap and strike meanwhile."""
        begun_s = time.monotonic()
        with ThreadPoolExecutor(1) as pool:
            answer = pool.submit(self._ask)
            try:
                self._strike(turn, answer, self._parts(turn, former))
            finally:
                self._continue(turn)
            turn.outcome, turn.text = answer.result()
        (self.tapes / "strike.json").unlink(missing_ok=True)
        (self.tapes / "struck.json").unlink(missing_ok=True)
        if turn.plan.fault == "none" and turn.outcome == "swapped":
            self._swap_s = 0.5 * (self._swap_s + time.monotonic() - begun_s)

    def _ask(self) -> tuple[str, str]:
        """Swap the relay for the other class; return what came of it, and why."""
        try:
            run = self.graph.ask("relay", "info")["run"]
            other = "Second" if run.endswith("First") else "First"
            answer = self.graph.swap("relay", f"nodes.storm:{other}", params={"out": str(self.tapes)})
        except GraphError as error:
            return "no answer", str(error)
        if "report" in answer:
            return "swapped", f"gap {answer['report']['gap_s'] * 1e3:.1f} ms"
        return answer["failed"]["step"], answer["failed"]["text"]

    def _parts(self, turn: Turn, former: int) -> dict[str, int]:
        """Return the process numbers of those that can be struck; the new one has none yet."""
        assert self._launcher is not None
        self._births = len(self.tape("born"))
        return {
            "old": former,
            "reader": int(self.tape(turn.plan.reader)[-1, READER]),
            "source": int(self.tape("sent")[-1, BY]),
            "launcher": self._launcher.pid,
        }

    def _new(self) -> int:
        """Return the process number of the one that is to take over; 0 before it is there."""
        born = self.tape("born")
        return int(born[self._births, 0]) if len(born) > self._births else 0

    def _strike(self, turn: Turn, answer: Future[Any], parts: dict[str, int]) -> None:
        """Send the signal at its step or instant; one whose victim is not there by then is not sent."""
        plan = turn.plan
        deed, _, who = plan.fault.partition(" ")
        if not who:
            return
        number = signal.SIGKILL if deed == "kill" else signal.SIGSTOP
        if plan.step:
            wanted = {"step": plan.step, "pid": parts.get(who, 0), "signal": int(number)}
            write_whole(self.tapes / "strike.json", json.dumps(wanted).encode())
            struck = self.tapes / "struck.json"
            while not answer.done() and not struck.exists():
                rest(POLL_S)
            turn.struck, turn.victim = struck.exists(), parts.get(who) or self._new()
            return
        end_s = time.monotonic() + plan.instant * self._swap_s
        while time.monotonic() < end_s or (who == "new" and not self._new() and not answer.done()):
            rest(POLL_S)
        turn.victim = parts.get(who) or self._new()
        turn.struck = self._send(turn.victim, number)

    def _continue(self, turn: Turn) -> None:
        """Let go on who was stopped."""
        if turn.struck and turn.plan.fault.startswith("stop"):
            rest(turn.plan.stop_s)
            self._send(turn.victim, signal.SIGCONT)

    def _send(self, pid: int, number: signal.Signals) -> bool:
        """Send a signal to a process if it is one of the graph's, and lives; return whether it was."""
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(pid)
            if pid and process.environ().get(MARK) == self._mark:
                process.send_signal(number)
                return True
        return False

    # What came of it

    def _expect_flow(self, turn: Turn, former: int) -> None:
        """Wait until all readers hear new numbers, and judge."""
        sent = self.tape("sent")
        count = len(sent)
        self.wait(lambda: len(self.tape("sent")) > count, "the source sent nothing")
        sent = self.tape("sent")
        last = int(sent[-1, LIFE]), int(sent[-1, INDEX])
        late = {name: self.tapes / name for name in READERS}

        def flows() -> bool:
            for name in list(late):
                if reached(self.tape(name), *last):
                    del late[name]
            return not late

        try:
            turn.flow_s = self.wait(flows, "")
        except Stranded as stranded:
            raise Stranded(f"no new number at {', '.join(late)}: {stranded}") from None
        finally:
            self._judge(turn, sent, former)

    def _expect_end(self, turn: Turn, former: int) -> None:
        """The launcher was killed: everything ends within a bound, and what came before is whole."""
        assert self._launcher is not None
        self._launcher.wait()
        begun_s = time.monotonic()
        while (left := marked(self._mark)) and time.monotonic() - begun_s < END_S:
            rest(10 * POLL_S)
        turn.flow_s = time.monotonic() - begun_s
        if left:
            turn.wrong.append(f"{END_S:g} s after the launcher: {[p.name() for p in left]} live")
        self._judge(turn, self.tape("sent"), former, all_ended=True)

    def _judge(self, turn: Turn, sent: Rows, former: int, *, all_ended: bool = False) -> None:
        plan = turn.plan
        given_up = plan.fault == "stop reader" and plan.stop_s > GIVEN_UP_S  # palp has started another
        killed = turn.struck and (plan.fault.startswith("kill") or given_up)
        deaths = Deaths(
            frozenset([turn.victim] if killed else []),
            frozenset([former] if turn.outcome == "swapped" else []),
            all_ended,
        )
        passed = self.tape("passed")
        for name, judge in self._judges.items():
            turn.verdicts[name] = judge.judge(sent, passed, self.tape(name), deaths)

    def _keep(self, turn: Turn) -> None:
        """Keep what is needed to understand and repeat a turn that went wrong."""
        kept = self._folder / f"turn{turn.number}"
        kept.mkdir(parents=True, exist_ok=True)
        (kept / "turn.json").write_text(json.dumps(dataclasses.asdict(turn), indent=2))
        (kept / "again.txt").write_text(f"--storm 1 --seed {self._seed} --first {turn.number}\n")
        shutil.copytree(self.tapes, kept / "tapes", dirs_exist_ok=True)
        for run in (self._runtime / "palp").glob("*"):
            with contextlib.suppress(OSError, shutil.Error):
                shutil.copytree(run / "log", kept / "log", dirs_exist_ok=True)


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute."""
    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def run_storm(
    turns: int, seed: int, *, first: int, burning: int, folder: Path, show: Callable[[Turn], None]
) -> dict[str, Any]:
    """Run so many turns; return what came of them, which is also in ``storm.json`` in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    storm, done = Storm(seed, folder), []
    with busy(burning):
        storm.launch()
        try:
            for number in range(first, first + turns):
                done.append(storm.turn(number))
                show(done[-1])
                found = summary(done, seed, burning)
                (folder / "storm.json").write_text(json.dumps(found, indent=2))
        finally:
            storm.end()
    return found


def summary(turns: list[Turn], seed: int, burning: int) -> dict[str, Any]:
    """Return what came of all turns, by fault and one by one."""
    faults = {fault: [turn for turn in turns if turn.plan.fault == fault] for fault in FAULTS}
    return {
        "seed": seed,
        "busy": burning,
        "turns": len(turns),
        "failures": [turn.number for turn in turns if turn.wrong],
        "by_fault": {fault: _row(some) for fault, some in faults.items()} | {"all": _row(turns)},
        "each": [dataclasses.asdict(turn) for turn in turns],
    }


def _row(turns: list[Turn]) -> dict[str, Any]:
    verdicts = [verdict for turn in turns for verdict in turn.verdicts.values()]
    outcomes = [turn.outcome for turn in turns]
    return {
        "tries": len(turns),
        "struck": sum(turn.struck for turn in turns),
        "swapped": outcomes.count("swapped"),
        "failed_at": {step: outcomes.count(step) for step in sorted(set(outcomes) - {"swapped"})},
        "wrong": sum(bool(turn.wrong) for turn in turns),
        **{what: sum(getattr(verdict, what) for verdict in verdicts) for what in COUNTED},
        "silence_max_ms": max((verdict.silence_ms for verdict in verdicts), default=0.0),
    }  # fmt: skip
