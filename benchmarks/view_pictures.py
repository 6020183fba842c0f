"""Take the pictures of docs/how_to/live_page.md and the README from graphs that run, in Chromium.

Run: .venv/bin/python -m benchmarks.view_pictures [--out docs/view] [--only NAME ...]

Live pages show the emulated rig, with the times and rates of this machine; bag, result and the page of the
rig are of a short simulated session.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, closing
from functools import cached_property
from pathlib import Path

from PIL import Image

from benchmarks.view_running import ROOT, SIM, browser, emulated, until, wait
from palp_core.palpation.session.trials_csv import read_rows
from tests.support.palp import own_palp
from tests.support.view.browser import Viewing
from tests.support.view.page_socket import PageServer, PageSocket

WIDTH, COLOURS = 1100, 64
LARGEST_BYTES = 150_000
PATH = ("shared.from_m:=-0.02", "shared.to_m:=0.03", "shared.lift_mm:=5.0")
POLICY = "nodes.policy_uniform:Uniform"
SWEPT_S = 12.0
"""Of torque in the plot: two sweeps."""
LATE = 0.7
"""In a sweep: over the bead."""
Shot = Callable[["Studio"], Viewing]


class Studio:
    """The emulated rig, a session that is over, viewers of both, and a browser; each when it is wanted.

    Args:
        folder: For what they write.
        stack: Ends them.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self._stack = folder, stack
        self.palp = stack.enter_context(own_palp())
        self.chrome = stack.enter_context(browser(folder))

    @cached_property
    def live(self) -> Viewing:
        """The rig, running."""
        run = self._stack.enter_context(emulated(*PATH))
        viewer = run.palp.start("view", "--no-browser", "--operate", "--graph", "rig")
        return Viewing(self.chrome, viewer, WIDTH)

    @cached_property
    def session(self) -> Path:
        """The folder of a simulated session; ``bag`` in it is its recording."""
        out, bag = self.folder / "session", self.folder / "bag"
        small = ("trials:=2", "training:=2", "policy:=markov", f"out:={out}", "--record", bag)
        done = self.palp.run("launch", SIM, "--compose", *small)
        if done.returncode:
            raise RuntimeError(done.stderr)
        return out

    def over(self, what: Path) -> Viewing:
        """Show a bag."""
        return Viewing(self.chrome, self.palp.start("view", what, "--no-browser"), WIDTH)

    def in_a_sweep(self) -> Viewing:
        """Show the recording late in the last sweep that was judged."""
        row = read_rows(self.session)[-1]
        viewing = self.over(self.session.parent / "bag")
        at_s = (row.start_ns + LATE * (row.end_ns - row.start_ns)) / 1e9
        with closing(PageSocket(PageServer(viewing.address))) as page:
            page.event(page.labelled("time in the bag"), "update:", at_s)
            page.until(lambda element: str(element.get("text", "")).startswith(f"{at_s:.3f} s, of "))
        return viewing


def graph(studio: Studio) -> Viewing:
    """The graph, with rates and latencies."""
    studio.live.go("/").wait_for_selector("[data-node]")
    studio.live.says("all is well")
    studio.live.until(
        "() => [...document.querySelectorAll('.wire text')].some(one => /Hz .*ms/.test(one.innerHTML))"
    )
    return studio.live


def node(studio: Studio) -> Viewing:
    """A node: its state, parameters, wires, log."""
    studio.live.go("/node/estimator")
    studio.live.says("/torque/block")
    studio.live.says(" Hz")
    return studio.live


def topic(studio: Studio) -> Viewing:
    """Torque, plotted while it is swept."""
    studio.live.go("/topic/torque/block")
    studio.live.plot("torque_n_m")
    wait(SWEPT_S)
    return studio.live


def swap(studio: Studio) -> Viewing:
    """The policy, after another has taken over."""
    studio.live.go("/node/policy")
    studio.live.swap(POLICY)
    studio.live.says(f" -> {POLICY} at ")
    studio.live.says(f"{POLICY}, process ")
    return studio.live


def bag(studio: Studio) -> Viewing:
    """A recording, somewhere in it."""
    viewing = studio.in_a_sweep()
    viewing.go("/topic/torque/block")
    viewing.plot("torque_n_m", frames=0)  # it stands where one is in it
    return viewing


def rig(studio: Studio) -> Viewing:
    """The rig's own page over a recording, in a sweep."""
    viewing = studio.in_a_sweep()
    viewing.go("/own")
    viewing.says("bands: mean and two standard deviations")
    viewing.until("() => Number(document.querySelector('.rig-chart').dataset.points) > 100")
    return viewing


SHOTS: dict[str, Shot] = {
    "graph": graph, "node": node, "topic": topic, "swap": swap,
    "bag": bag, "rig": rig,
}  # fmt: skip


def main() -> None:
    """Take them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "view", help="folder of the pictures")
    parser.add_argument("--only", nargs="*", choices=SHOTS, help="take these only")
    options = parser.parse_args()
    out = options.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    missing: list[str] = []
    with ExitStack() as stack:
        studio = Studio(Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="palp-view-"))), stack)
        for name in options.only or SHOTS:
            try:
                take(SHOTS[name](studio), out / f"{name}.png")
            except (AssertionError, RuntimeError, OSError) as error:
                missing.append(name)
                print(f"{name}: {str(error)[:500]}", flush=True)
    if missing:
        raise SystemExit(f"not taken: {', '.join(missing)}")


def take(viewing: Viewing, path: Path) -> None:
    """Take a picture of a page as far as it is filled, and say how large it is.

    Raises:
        RuntimeError: It is too large for the docs.
    """
    until(lambda: not viewing.page.evaluate("document.fonts.status === 'loading'"), "fonts")
    height = min(
        int(viewing.page.evaluate("document.querySelector('.nicegui-content').scrollHeight")) + 20, 1250
    )
    viewing.page.set_viewport_size({"width": WIDTH, "height": height})
    wait(0.5)  # until charts have their new size
    viewing.page.screenshot(path=path)
    with Image.open(path) as picture:  # no more colours than a page has: a fraction of the size
        small = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path}: {size / 1e3:.0f} kB")
    if size > LARGEST_BYTES:
        raise RuntimeError(f"{path} has {size} bytes; at most {LARGEST_BYTES}")


if __name__ == "__main__":
    main()
