"""Draw docs/first_run.svg, the moving picture of the README, from commands that really run.

Two terminals: the rig in one, what a user types in the other. Lines appear as they were printed; longer waits
last two seconds. Run it from the checkout: ``python docs/site/first_run.py``.
"""

import html
import os
import shutil
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
from pathlib import Path
from typing import NamedTuple

OUT = Path(__file__).resolve().parents[1] / "first_run.svg"
PALP = Path(sys.executable).with_name("palp")
COLUMNS, ROWS = 92, (9, 12)  # of each terminal
LINE_PX, CHARACTER_PX, MARGIN_PX = 17, 7.8, 12
LONGEST_WAIT_S, LAST_S = 2.0, 5.0
LAUNCH = "palp launch launch/sim.yaml trials:=100000 training:=3 out:=results/long"
SWAP = "palp swap policy nodes.policy_uniform:Uniform"
END = "palp graph end"
RECORD = (
    "palp launch launch/sim.yaml trials:=2 training:=3 out:=results/bagged --compose --record bags/session"
)
REPLAY = "palp bag replay bags/session --nodes estimator,policy"


class Line(NamedTuple):
    at_s: float
    terminal: int
    text: str


class Recording:
    """What two terminals show, in a copy of the rig's folders."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._start_s = folder, time.monotonic()
        self._has_more = threading.Condition()
        self.lines: list[Line] = []

    def add(self, terminal: int, text: str) -> None:
        with self._has_more:
            self.lines.append(Line(time.monotonic() - self._start_s, terminal, text))
            self._has_more.notify_all()

    def start(self, terminal: int, command: str) -> tuple[subprocess.Popen[str], threading.Thread]:
        self.add(terminal, f"$ {command}")
        process = subprocess.Popen(
            [PALP, *command.split()[1:]],
            cwd=self._folder,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "XDG_RUNTIME_DIR": str(self._folder)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        follow = threading.Thread(target=self._follow, args=(terminal, process))
        follow.start()
        return process, follow

    def _follow(self, terminal: int, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self.add(terminal, line.rstrip())

    def run(self, terminal: int, command: str) -> None:
        process, follow = self.start(terminal, command)
        if process.wait():
            raise SystemExit("\n".join([*(line.text for line in self.lines), f"status {process.returncode}"]))
        follow.join()

    def wait_for(self, text: str, count: int) -> None:
        with self._has_more:
            self._has_more.wait_for(lambda: sum(text in line.text for line in self.lines) >= count)


def record(folder: Path) -> list[Line]:
    """Launch the rig and swap its policy in the middle of a trial; record a session and replay two nodes."""
    recording = Recording(folder)
    rig, follow = recording.start(0, LAUNCH)
    recording.wait_for("estimation:", 2)
    recording.run(1, SWAP)
    recording.wait_for("estimation:", 4)
    recording.run(1, END)
    rig.wait()
    follow.join()
    recording.run(1, RECORD)
    recording.run(1, REPLAY)
    return recording.lines


def shortened(lines: list[Line]) -> list[Line]:
    """Return the lines with long waits cut, folded to the terminal's width."""
    found: list[Line] = []
    before_s = now_s = 0.0
    for line in lines:
        now_s += min(line.at_s - before_s, LONGEST_WAIT_S)
        before_s = line.at_s
        texts = textwrap.wrap(line.text, COLUMNS, subsequent_indent="  ") or [""]
        found.extend(Line(now_s, line.terminal, text) for text in texts)
    return found


def screens(lines: list[Line]) -> list[tuple[float, list[list[str]]]]:
    """Return what both terminals show from each time on."""
    shown: list[list[str]] = [[], []]
    found: list[tuple[float, list[list[str]]]] = []
    for line in lines:
        shown[line.terminal] = [*shown[line.terminal], line.text][-ROWS[line.terminal] :]
        if found and line.at_s - found[-1][0] < 0.05:
            found.pop()
        found.append((line.at_s, [list(texts) for texts in shown]))
    return found


def svg(lines: list[Line]) -> str:
    """Return the picture: one group for each screen, shown in turn by a style that browsers animate."""
    steps = screens(lines)
    end_s = steps[-1][0] + LAST_S
    width = round(COLUMNS * CHARACTER_PX + 2 * MARGIN_PX)
    height = sum(ROWS) * LINE_PX + 3 * MARGIN_PX
    styles, groups = [], []
    for i, (at_s, terminals) in enumerate(steps):
        next_s = steps[i + 1][0] if i + 1 < len(steps) else end_s
        begin, end = 100 * at_s / end_s, 100 * next_s / end_s
        shown = f"{begin + 0.001:.3f}%,{end:.3f}%{{opacity:1}}"
        hidden = f"{end + 0.001:.3f}%,100%{{opacity:0}}" if end < 99.99 else ""
        styles.append(f"@keyframes s{i}{{0%,{begin:.3f}%{{opacity:0}}{shown}{hidden}}}")
        styles.append(f"#s{i}{{animation:s{i} {end_s:.1f}s infinite}}")
        texts, top = [], MARGIN_PX
        for rows, terminal in zip(ROWS, terminals, strict=True):
            for row, text in enumerate(terminal):
                y = top + (row + 1) * LINE_PX - 4
                kind = ' class="c"' if text.startswith("$ ") else ""
                texts.append(f'<text x="{MARGIN_PX}" y="{y}"{kind}>{html.escape(text)}</text>')
            top += rows * LINE_PX + MARGIN_PX
        groups.append(f'<g id="s{i}">{"".join(texts)}</g>')
    split = MARGIN_PX * 1.5 + ROWS[0] * LINE_PX
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    text = (
        "text{font:13px monospace;fill:#d8dee9;white-space:pre}.c{fill:#8fd6c0;font-weight:bold}g{opacity:0}"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{text}{"".join(styles)}</style>'
        f'<rect width="{width}" height="{height}" rx="8" fill="#1d2430"/>'
        f'<path d="M0 {split}H{width}" stroke="#4c566a"/>{"".join(groups)}</svg>\n'
    )


def main() -> None:
    root = OUT.parents[1]
    with tempfile.TemporaryDirectory() as place:
        for name in ("launch", "nodes", "msgs"):
            shutil.copytree(root / name, Path(place) / name, ignore=shutil.ignore_patterns("__pycache__"))
        lines = record(Path(place))
    OUT.write_text(svg(shortened(lines)), encoding="utf-8")
    sys.stdout.write(f"{OUT}: {OUT.stat().st_size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
