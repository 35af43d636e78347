"""Measures how long a user of `kneexo play` waits in Chromium, and whether the numbers are right.

    python benchmarks/playground.py [--repeats N] [--presets paper bench leg wearer protected]

For each preset the program makes a page, opens it, and moves the slider of the gear by events of a
real mouse, with the leg still and playing. A wait lasts from the event of the mouse to the picture
with the new values. The program prints, in ms,

- the time from the start of the navigation to the first curves, and the size of the page in MB,
- median and 90th percentile of the wait for the first curve of the part in view,
- median of the wait for the numbers of the whole run,
- the longest time without a new curve while the slider moves 60 times a second,
- median and 90th percentile of the wait from a push by the key P to the curve of the pushed leg,
- the times from a move of the slider to the margins and to the −3 dB frequency. Both start when the
  slider has rested for 350 ms. A page with a wearer has neither.

Then it prints the largest relative difference between the page and kneexo with the YAML of the
page: numbers of the run, margins, and the −3 dB frequency in Hz.

Chromium draws without a GPU. The run of a preset has its default duration, 30 s.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import statistics
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from kneexo.analysis import large_signal_bandwidth_hz, linearize_loop, track
from kneexo.page.playground import playground_page
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import load_scenario
from kneexo.systems.knee_reference import run_middle_deg

PRESETS = ("paper", "bench", "leg", "wearer", "protected")
SLIDER = "q-plant.pump.gear_ratio"

OPENING = """
(function watch() {
  if (typeof Page !== "undefined" && Page.parts.drawn) window.opened_ms = performance.now();
  else requestAnimationFrame(watch);
})();
"""

TOOLS = """
globalThis.waits = [];  // for each move of the slider: start, and the times of the pictures
let moved = 0;
for (const kind of ["pointermove", "pointerdown"]) {
  addEventListener(kind, ({ timeStamp }) => { moved = timeStamp; }, true);
}
addEventListener("keydown", ({ timeStamp }) => waits.push({ start: timeStamp }), true);
addEventListener("input", () => waits.push({ start: moved }), true);
const afterPicture = (action) => {  // the page draws in a frame, and the message follows this frame
  const { port1, port2 } = new MessageChannel();
  port1.onmessage = () => action(performance.now());
  port2.postMessage(null);
};
const { board, plots } = Page.parts;
const note = (wait, name) => afterPicture((now) => { if (wait) wait[name] ??= now - wait.start; });
const showPlots = plots.show.bind(plots);
plots.show = (...more) => {
  note(waits.at(-1), "curve");
  afterPicture((now) => { if (globalThis.pictures) pictures.push(now); });
  showPlots(...more);
};
const showBoard = board.show.bind(board);
board.show = (results, ...more) => {
  if (results[0].fresh) note(waits.at(-1), "numbers");
  showBoard(results, ...more);
};
"""


def new_browser(folder: Path) -> Any:
    """The browser of the tests, with its profile in a folder."""
    file = Path(__file__).parents[1] / "tests" / "conftest.py"
    sys.path.append(str(file.parent / "shared"))
    spec = importlib.util.spec_from_file_location("conftest", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module._Browser(folder / "profile")


class Mouse:
    """A mouse that holds the thumb of a slider."""

    def __init__(self, browser: Any) -> None:
        self.browser = browser
        script = f"""(() => {{ const slider = document.getElementById("{SLIDER}");
          slider.scrollIntoView({{ block: "center" }});
          const box = slider.getBoundingClientRect();
          const thumb = 8;  // half its width
          const at = slider.value / slider.max;
          const x = box.left + thumb + at * (box.width - 2 * thumb);
          return [x, box.top + box.height / 2]; }})()"""
        self.x, self.y = browser.evaluate(script)
        self.send("mouseMoved", self.x)
        self.send("mousePressed", self.x, button="left", buttons=1, clickCount=1)

    def send(self, kind: str, x: float, **more: Any) -> None:
        """Send one event."""
        self.browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=self.y, **more)

    def move(self, distance: float) -> None:
        """Move the thumb to a distance in pixels from its start."""
        self.send("mouseMoved", self.x + distance, button="left", buttons=1)

    def release(self) -> None:
        """Let the thumb go."""
        self.send("mouseReleased", self.x, button="left", clickCount=1)


def waits(browser: Any, repeats: int) -> dict[str, float]:
    """The waits after single moves of the slider, and the longest gap while it moves on."""
    browser.evaluate("waits.length = 0")
    mouse = Mouse(browser)
    for step in range(repeats):
        mouse.move(-4.0 * (1 + step % 6))
        browser.wait_for(f"waits.length === {step + 1} && waits.at(-1).numbers")
        time.sleep(0.2 + 0.02 * (step % 7))  # another moment of the frames of the view
    times = browser.evaluate("waits")
    browser.evaluate("globalThis.pictures = [performance.now()]")
    start = time.monotonic()
    step = 0
    while time.monotonic() < start + 3.0:
        mouse.move(-30.0 * abs(math.sin(0.05 * step)))
        step += 1
        time.sleep(max(0.0, start + step / 60.0 - time.monotonic()))
    mouse.release()
    curves = browser.evaluate("pictures")
    browser.evaluate("globalThis.pictures = null")
    first = [wait["curve"] for wait in times]
    return {
        "curve": statistics.median(first),
        "curve p90": percentile_90(first),
        "numbers": statistics.median([wait["numbers"] for wait in times]),
        "gap": max(after - before for before, after in pairwise(curves)),
    }


def pushes(browser: Any, repeats: int) -> dict[str, float]:
    """The waits after pushes of the leg at several times."""
    browser.evaluate("document.getElementById('load-knee')?.click()")
    browser.wait_for("Page.results[0].fresh")
    browser.evaluate("(Page.parts.stage.pause(), waits.length = 0)")
    for step in range(repeats):
        browser.evaluate(f"Page.parts.stage.seek({3.0 + 22.0 * (0.618 * step % 1.0)})")
        time.sleep(0.3)
        browser.evaluate("document.querySelector('.whole canvas').focus()")
        browser.call("Input.dispatchKeyEvent", type="keyDown", key="p")
        browser.call("Input.dispatchKeyEvent", type="keyUp", key="p")
        browser.wait_for(f"waits.length === {step + 1} && waits.at(-1).numbers")
    first = browser.evaluate("waits.map(({ curve }) => curve)")
    return {"curve": statistics.median(first), "curve p90": percentile_90(first)}


def percentile_90(values: list[float]) -> float:
    """The 90th percentile."""
    return sorted(values)[math.ceil(0.9 * len(values)) - 1]


def analyses(browser: Any) -> dict[str, float]:
    """The times in ms from a move of the slider to the margins and to the −3 dB frequency."""
    script = f"""(async () => {{ const slider = document.getElementById("{SLIDER}");
      slider.value = Number(slider.value) + 1;
      slider.dispatchEvent(new Event("input"));
      const start = performance.now();
      const times = {{}};
      while (!times.sweep) {{
        for (const name of ["linear", "sweep"]) {{
          if (Page.results[0][name]) times[name] ??= performance.now() - start;
        }}
        await new Promise(requestAnimationFrame);
      }}
      return times; }})()"""
    return browser.evaluate(script)


def differences(browser: Any, folder: Path) -> dict[str, float]:
    """The largest differences between the page and kneexo, which runs the YAML of the page."""
    file = folder / "page.yaml"
    file.write_text(browser.evaluate("Setups.yamlOf(Page.data, Page.state.setups[0])"), "utf-8")
    scenario = load_scenario(file)
    result = track(scenario)
    numbers = browser.evaluate("Page.results[0].run.metrics")
    pairs = {
        "largest_error_rad": math.radians(result.metrics.max_error_deg),
        "peak_pressure_pa": 1e6 * result.metrics.peak_pressure_mpa,
        "saturated_share": result.metrics.saturated_share,
    }
    found = {"run": largest_difference(numbers, pairs)}
    linear, sweep = browser.evaluate("[Page.results[0].linear, Page.results[0].sweep]")
    if linear:
        loop = linearize_loop(scenario, knee_angle_deg=run_middle_deg(scenario))
        margins = loop.margins()
        names = ("gain_margin", "phase_margin_deg", "delay_margin_s")
        found["margins"] = largest_difference(linear, {n: getattr(margins, n) for n in names})
        found["-3 dB, Hz"] = abs(sweep["minus_3_db_hz"] - large_signal_bandwidth_hz(scenario))
    return found


def largest_difference(numbers: dict[str, float], expected: dict[str, float]) -> float:
    """The largest relative difference of numbers from the expected ones."""
    return max(abs(numbers[n] - value) / max(abs(value), 1e-9) for n, value in expected.items())


def measured(browser: Any, file: Path, repeats: int) -> dict[str, dict[str, float]]:
    """The numbers of a page: rows by name, numbers by the heads of the columns."""
    browser.open(file, width=1440, height=900)
    browser.wait_for(
        "window.opened_ms && (({ fresh, hasWearer, swept }) => hasWearer ? fresh : swept)"
        "(Page.results[0])"
    )
    page = {"MB": file.stat().st_size / 1e6, "opens": browser.evaluate("opened_ms")}
    found = {"page": page, "difference": differences(browser, file.parent)}
    browser.evaluate(f"(() => {{ {TOOLS} }})()")
    for name, action in (("still", "pause"), ("playing", "play")):
        browser.evaluate(f"Page.parts.stage.{action}()")
        found[name] = waits(browser, repeats)
    if not browser.evaluate("Page.results[0].hasWearer"):
        found["analyses"] = analyses(browser)
        found["push"] = pushes(browser, repeats)
    browser.require_health()
    return found


def main() -> None:
    """Print the numbers of each page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--presets", nargs="+", choices=PRESETS, default=PRESETS)
    parser.add_argument("--json", type=Path, help="write the numbers to this file too")
    options = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as directory:
        browser = new_browser(Path(directory))
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=OPENING)
        for name in options.presets:
            file = Path(directory) / "page.html"
            file.write_text(playground_page([Scenario.preset(name)], [name]), encoding="utf-8")
            found[name] = measured(browser, file, options.repeats)
            for row, numbers in found[name].items():
                texts = ", ".join(f"{head} {value:.3g}" for head, value in numbers.items())
                print(f"{name:10}{row:12}{texts}", flush=True)
        browser.close()
    load = os.getloadavg()[0]
    print(f"load of the machine over the last minute, with this program: {load:.1f}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
