"""The pictures of the pages in docs/view.md and the README: of graphs that run, in Chromium.

Run: .venv/bin/python -m benchmarks.view_pictures [--out docs/view] [--only NAME ...]

Live pages show the emulated rig, with the times and rates of this machine; the result is of a short simulated
session.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.view_bench.running import ROOT, SIM, Launched, browser, emulated, until, wait
from tests.support.view.browser import Viewing

WIDTH, COLOURS = 1100, 64
LARGEST_BYTES = 150_000
PATH = ("from_m:=-0.02", "to_m:=0.03", "lift_mm:=5.0")
POLICY = "nodes.policy_uniform:Uniform"
SWEPT_S = 12.0
"""Of torque in the plot: two sweeps."""
TRAINED_S = 900.0
"""Training takes five minutes; a machine that others use too takes longer."""
SWEPT_POINTS = 500
Shot = Callable[["Studio"], Viewing]


class Studio:
    """The emulated rig, its viewer, and a browser.

    Args:
        run: The rig.
        chrome: Chromium.
    """

    def __init__(self, run: Launched, chrome: Any) -> None:
        self.run, self.chrome = run, chrome
        self.live = Viewing(
            chrome, run.palp.start("view", "--no-browser", "--operate", "--graph", "rig"), WIDTH
        )

    def over(self, what: Path) -> Viewing:
        """Show a bag or results."""
        return Viewing(self.chrome, self.run.palp.start("view", what, "--no-browser"), WIDTH)


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
    studio.live.says("classes of the workspace fit its wires")
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
    studio.live.says(f"-> {POLICY}")
    return studio.live


def record(studio: Studio) -> Viewing:
    """A recording that has ended, beside one under way."""
    page = studio.live.go("/record")
    for name in ("first", "second"):
        page.get_by_label("name; empty: graph and time").fill(name)
        page.get_by_role("button", name="record", exact=True).click()
        page.locator("[data-what=recordings] b", has_text=name).wait_for()
        studio.live.says("recording ")
        wait(SWEPT_S if name == "first" else 0.5)
        if name == "first":
            page.locator("[data-what=recordings]").get_by_role("button", name="stop", exact=True).click()
            studio.live.says("whole: nothing is missing")
    return studio.live


def bag(studio: Studio) -> Viewing:
    """A recording, somewhere in it."""
    viewing = studio.over(Path("first"))
    viewing.go("/topic/torque/block")
    viewing.page.locator(".q-slider").click()  # at its middle
    viewing.plot("torque_n_m", frames=0)  # it stands where one is in it
    return viewing


def result(studio: Studio) -> Viewing:
    """The files of a run that is over."""
    out = studio.run.folder / "session"
    done = studio.run.palp.run("launch", SIM, "--compose", "trials:=1", "training:=1", f"out:={out}")
    if done.returncode:
        raise RuntimeError(done.stderr)
    viewing = studio.over(out)
    viewing.says("report.html")
    return viewing


def rig(studio: Studio) -> Viewing:
    """The rig's own page, in a sweep of a trial: training is over then."""
    page = studio.live.go("/own")
    page.set_default_timeout(TRAINED_S * 1e3)
    studio.live.says("bands: mean and two standard deviations")
    studio.live.says("of this trial")
    studio.live.until("() => document.querySelector('[data-what=rig]').innerText.includes('sweeping')")
    studio.live.until(f"() => Number(document.querySelector('.rig-chart').dataset.points) > {SWEPT_POINTS}")
    return studio.live


SHOTS: dict[str, Shot] = {
    "graph": graph, "node": node, "topic": topic, "swap": swap,
    "record": record, "bag": bag, "result": result, "rig": rig,
}  # fmt: skip
"""In the order in which they are taken: a bag is shown that was recorded before."""


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
        run = stack.enter_context(emulated(*PATH, training=2))
        os.chdir(run.folder)  # bags are made where a viewer is started
        studio = Studio(run, stack.enter_context(browser(run.folder, beside=True)))
        for name in options.only or SHOTS:
            try:
                take(SHOTS[name](studio), out / f"{name}.png")
            except (AssertionError, RuntimeError, OSError) as error:
                missing.append(name)
                print(f"{name}: {str(error)[:500]}")
    if missing:
        raise SystemExit(f"not taken: {', '.join(missing)}")


def take(viewing: Viewing, path: Path) -> None:
    """Take a picture of a page as far as it is filled, and say how large it is.

    Raises:
        RuntimeError: It is too large for the docs.
    """
    until(lambda: not viewing.page.evaluate("document.fonts.status === 'loading'"), "fonts")
    height = min(
        int(viewing.page.evaluate("document.querySelector('.nicegui-content').scrollHeight")) + 20, 1000
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
