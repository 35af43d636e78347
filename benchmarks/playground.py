"""Measures how long a user of `kneexo play` waits in Chromium, and how smoothly the leg moves.

    python benchmarks/playground.py [--repeats N]

For each scenario the program makes a page, opens it, and moves the slider of the gear. It prints

- the size of the page in MB,
- the time in ms from the start of the navigation to the first curves,
- the median and the longest time in ms from a move of the slider to the frame with the new curves,
- the times in ms from a move of the slider to the margins, and to the end of the sweep. Both start
  when the slider has rested for 350 ms. A page with a wearer has neither,
- the frames in a second while the slider moves ten times a second.

Chromium draws without a GPU. The run of a scenario has its default duration, 30 s.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import statistics
import tempfile
from pathlib import Path
from typing import Any

from kneexo.parameters import Scenario
from kneexo.parameters.presets import with_preset
from kneexo.view.playground import playground_page

OPENING = """
(function watch() {
  if (typeof Page !== "undefined" && Page.parts.drawn) window.opened_ms = performance.now();
  else requestAnimationFrame(watch);
})();
"""

TOOLS = """
globalThis.frame = () => new Promise(requestAnimationFrame);
globalThis.rest = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
globalThis.move = (step) => {
  const slider = document.getElementById("q-plant.pump.gear_ratio");
  slider.value = Number(slider.max) * (0.5 + 0.02 * (step % 7));
  slider.dispatchEvent(new Event("input"));
};
globalThis.timeOf = async (step, isDone) => {
  const before = Page.parts.drawn[0];
  const start = performance.now();
  move(step);
  while (!isDone(before)) await frame();
  return performance.now() - start;
};
globalThis.framesWhileMoving = async (duration_ms) => {
  const start = performance.now();
  let frames = 0;
  let next = start;
  while (performance.now() < start + duration_ms) {
    if (performance.now() >= next) {
      move(frames);
      next += 100;
    }
    await frame();
    frames++;
  }
  return (1000 * frames) / (performance.now() - start);
};
"""


def scenarios() -> dict[str, Scenario]:
    """The scenarios by name."""
    plants = {"paper": {}, "leg": with_preset("leg", {})}
    return {
        f"{name}, {kind}": Scenario.model_validate(values | {"controller": {"kind": kind}})
        for name, values in plants.items()
        for kind in ("smc", "pid")
    } | {"wearer": Scenario.preset("wearer")}


def new_browser(folder: Path) -> Any:
    """The browser of the tests, with its profile in a folder."""
    file = Path(__file__).parents[1] / "tests" / "conftest.py"
    spec = importlib.util.spec_from_file_location("conftest", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module._Browser(folder / "profile")


def measured(browser: Any, file: Path, repeats: int) -> dict[str, float]:
    """The numbers of a page, by the heads of the columns."""
    browser.open(file, width=1440, height=900)
    browser.wait_for(
        "window.opened_ms && (Page.results[0].hasWearer || Page.results[0].sweep)", 300.0
    )
    browser.evaluate(f"(() => {{ {TOOLS} }})()")
    times = []
    for step in range(repeats):
        times.append(browser.evaluate(f"timeOf({step}, (last) => Page.parts.drawn[0] !== last)"))
        browser.evaluate("rest(50)")
    row = {
        "MB": file.stat().st_size / 1e6,
        "opens": browser.evaluate("opened_ms"),
        "curves": statistics.median(times),
        "longest": max(times),
        "frames/s": browser.evaluate("framesWhileMoving(3000)"),
    }
    for name in () if browser.evaluate("Page.results[0].hasWearer") else ("linear", "sweep"):
        browser.wait_for("Page.results[0].fresh && Page.results[0].sweep", 300.0)
        row[name] = browser.evaluate(f"timeOf({repeats + len(row)}, () => Page.results[0].{name})")
    browser.require_health()
    return row


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--json", type=Path, help="write the numbers to this file too")
    options = parser.parse_args()
    rows = {}
    with tempfile.TemporaryDirectory() as directory:
        browser = new_browser(Path(directory))
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=OPENING)
        for name, scenario in scenarios().items():
            file = Path(directory) / "page.html"
            file.write_text(playground_page([scenario], [name]), encoding="utf-8")
            rows[name] = measured(browser, file, options.repeats)
            if len(rows) == 1:
                print(f"{'':12}" + "".join(f"{head:>10}" for head in rows[name]))
            numbers = "".join(f"{value:10.3g}" for value in rows[name].values())
            print(f"{name:12}{numbers}", flush=True)
        browser.close()
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
