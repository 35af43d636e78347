"""Pushes by mouse, touch and key at the time of the leg, and the same pushes in kneexo."""

import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.page.playground import playground_page
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import load_scenario

pytestmark = pytest.mark.slow

COLUMNS = {
    "angle": "knee_angle_rad",
    "command": "motor_speed_command_rad_s",
    "pressure": "load_pressure_pa",
}
POINTS = """(() => {
  const { stage } = Page.parts;
  const box = document.querySelector(".whole canvas").getBoundingClientRect();
  const { angle } = stage.legs[0].at(stage.time);
  const [x, z, turn] = stage.legs[0].pose("shank", angle);
  const ratio = document.querySelector(".whole canvas").width / box.width;
  return [0, 0.3].map((swing) => stage._places[0](
    x + 0.25 * Math.cos(turn - swing), z + 0.25 * Math.sin(turn - swing)))
    .map(([a, b]) => [box.left + a / ratio, box.top + b / ratio]);
})()"""
"""Points in the window: on the middle of the shank, and 0.3 rad further in flexion."""
FRAMES = "new Promise((d) => requestAnimationFrame(() => requestAnimationFrame(d))).then(() => 0)"


class _Hand:
    """The events of a mouse or of a finger."""

    def __init__(self, browser, touch):
        self.browser, self.touch = browser, touch

    def send(self, kind, point):
        x, y = point
        if self.touch:
            name = {"Pressed": "touchStart", "Moved": "touchMove", "Released": "touchEnd"}[kind]
            points = [] if kind == "Released" else [{"x": x, "y": y}]
            self.browser.call("Input.dispatchTouchEvent", type=name, touchPoints=points)
            return
        button = {"button": "left", "buttons": 1, "clickCount": 1}
        self.browser.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **button)


def drag(browser, touch=False, escape=False, offset=(0.0, 0.0)):
    """Drag from the shank, or beside it."""
    browser.evaluate("document.querySelector('.whole canvas').scrollIntoView({block: 'center'})")
    browser.evaluate(FRAMES)
    hand = _Hand(browser, touch)
    start, end = (np.add(point, offset).tolist() for point in browser.evaluate(POINTS))
    hand.send("Pressed", start)
    hand.send("Moved", end)
    browser.evaluate(FRAMES)
    if escape:
        key(browser, "Escape")
    hand.send("Released", end)


def key(browser, name):
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=name)


def settle(browser):
    browser.wait_for("Page.results[0].fresh && Page.results[0].run.metrics.push")
    browser.evaluate(FRAMES)


@pytest.mark.parametrize("preset", ["paper", "leg", "protected"])
def test_pushes_at_the_time_of_the_leg_are_those_of_kneexo(browser, tmp_path, preset):
    scenario = Scenario.preset(preset).changed(
        {"simulation.duration_s": 8.0, "plant.load.kind": "knee"}
    )
    file = tmp_path / "push.html"
    file.write_text(playground_page([scenario], [preset]), encoding="utf-8")
    for times, gesture in ((5.0011, "touch"), (3.0, "mouse"), (6.0, "key")):
        browser.open(file, width=1440, height=900, phone=gesture == "touch")
        browser.wait_for("Page.results[0].fresh && Page.parts.stage.duration > 7")
        browser.evaluate(f"(Page.parts.stage.pause(), Page.parts.stage.seek({times}), 0)")
        browser.evaluate(FRAMES)
        if gesture == "key":
            browser.evaluate("document.querySelector('.whole canvas').focus()")
            key(browser, "p")
        else:
            drag(browser, gesture == "touch")
        settle(browser)
        shown = browser.evaluate(
            """(({ time, columns, metrics, free }) => ({ time: Array.from(time), metrics,
            columns: Object.fromEntries(Object.entries(columns).map(([n, c]) => [n, Array.from(c)]))
            }))(Page.results[0].run)"""
        )
        text = browser.evaluate("Setups.yamlOf(Page.data, Page.state.setups[0])")
        (tmp_path / "page.yaml").write_text(text, encoding="utf-8")
        written = load_scenario(tmp_path / "page.yaml")
        period = written.controller.sample_time_s
        assert written.push.start_s == pytest.approx(round(times / period) * period, abs=1e-9)
        expected = 15.0 if gesture == "key" else 150.0 * 0.3 / (0.5 * np.pi)
        assert written.push.torque_n_m == pytest.approx(expected, abs=0 if gesture == "key" else 3)
        result = track(written)
        for name, column in COLUMNS.items():
            size = np.abs(result.run[column]).max()
            np.testing.assert_allclose(
                shown["columns"][name], result.run[column], rtol=0, atol=1e-6 * size
            )
        largest = np.degrees(shown["metrics"]["push"]["largest_deviation_rad"])
        assert largest == pytest.approx(result.push.largest_deviation_deg, rel=1e-6)
        low, high = browser.evaluate("Page.parts.plots.range")
        assert low < written.push.start_s < written.push.end_s < high < 8.0
        ghost = browser.evaluate("Array.from(Page.parts.plots.plots[0].data.at(-6))")
        pushed = browser.evaluate("Array.from(Page.parts.plots.plots[0].data[1])")
        assert np.abs(np.subtract(ghost, pushed)).max() == pytest.approx(largest)
        browser.require_health()


def test_escape_takes_a_push_back_and_a_drag_elsewhere_turns(browser, tmp_path):
    file = tmp_path / "push.html"
    scenario = Scenario.preset("leg").changed({"simulation.duration_s": 4.0})
    file.write_text(playground_page([scenario], ["leg"]), encoding="utf-8")
    browser.open(file, width=1440, height=900)
    browser.wait_for("Page.results[0].fresh")
    torque = "Page.state.setups[0].values['push.torque_n_m'] ?? 0"
    azimuth = browser.evaluate("Page.parts.stage.orbit.azimuth")
    drag(browser, escape=True)
    assert browser.evaluate(torque) == 0
    assert browser.evaluate("Page.parts.stage.orbit.azimuth") == azimuth
    drag(browser, offset=(0.0, -120.0))
    assert browser.evaluate(torque) == 0
    assert browser.evaluate("Page.parts.stage.orbit.azimuth") != azimuth
    browser.evaluate("document.getElementById('load-none')?.click()")
    browser.wait_for("Page.results[0].fresh")
    browser.require_health()
