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
POINTS = """((leg) => {
  const { stage } = Page.parts;
  const canvas = document.querySelectorAll(".whole canvas")[leg];
  const box = canvas.getBoundingClientRect();
  const { angle } = stage.legs[leg].at(stage.time);
  const [x, z, turn] = stage.legs[leg].pose("shank", angle);
  const ratio = canvas.width / box.width;
  return [0, 0.3].map((swing) => stage._places[leg](
    x + 0.25 * Math.cos(turn - swing), z + 0.25 * Math.sin(turn - swing)))
    .map(([a, b]) => [box.left + a / ratio, box.top + b / ratio]);
})"""
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


def drag(browser, touch=False, escape=False, offset=(0.0, 0.0), leg=0):
    """Drag from the shank, or beside it."""
    browser.evaluate("document.querySelector('.whole canvas').scrollIntoView({block: 'center'})")
    browser.evaluate(FRAMES)
    hand = _Hand(browser, touch)
    start, end = (np.add(point, offset).tolist() for point in browser.evaluate(f"{POINTS}({leg})"))
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


@pytest.mark.slow(gate=1)
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


SHADE = """((time) => {
  const { ctx, bbox } = Page.parts.plots.shown[1].chart;
  const x = Page.parts.plots.shown[1].chart.valToPos(time, "x", true);
  const [red, green] = ctx.getImageData(Math.round(x), bbox.top + bbox.height - 4, 1, 1).data;
  return red - green;
})"""
"""How red the ground of the curves is at a time."""
PLAYED = """(async () => {
  const { stage } = Page.parts;
  const times = [];
  stage.speed = 4;
  stage.play();
  for (let ends = 0; ends < 2; ends += times.at(-1) < times.at(-2)) {
    await new Promise((done) => stage.element.addEventListener("stagetime", done, { once: true }));
    times.push(stage.time);
  }
  stage.pause();
  return times;
})()"""
HEADS = """Page.parts.plots.shown.map(({ head, chart }) =>
  head.hidden ? null : chart.posToVal(head.offsetLeft + 1, "x"))"""


def test_a_flat_leg_repeats_the_part_in_view_and_each_set_up_is_pushed(browser, tmp_path):
    file = tmp_path / "push.html"
    scenario = Scenario.preset("leg").changed({"simulation.duration_s": 8.0})
    file.write_text(playground_page([scenario], ["leg"]), encoding="utf-8")
    no_webgl = "HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype"
    no_webgl += ".getContext, { apply: (f, on, [kind, ...more]) => kind.startsWith('webgl')"
    no_webgl += " ? null : Reflect.apply(f, on, [kind, ...more]) })"
    browser.open(file, width=1440, height=900, script=no_webgl)
    browser.wait_for("Page.results[0].fresh && Page.parts.stage.duration > 7")
    played = "[Page.parts.stage.part, Page.parts.stage.speed]"
    assert browser.evaluate(played) == [None, 1]
    browser.evaluate("(Page.parts.stage.seek(3), 0)")
    drag(browser)
    settle(browser)
    low, high = browser.evaluate("Page.parts.plots.range")
    assert browser.evaluate(played) == [[low, high], 0.25]
    assert browser.evaluate("document.getElementById('key').innerText").endswith("without the push")
    assert browser.evaluate(f"{SHADE}(3.1)") > 5 > abs(browser.evaluate(f"{SHADE}(2.97)"))
    times = browser.evaluate(PLAYED)
    assert low <= min(times)
    assert max(times) <= high
    browser.evaluate("(Page.parts.stage.seek(3.05), 0)")
    browser.wait_for("Page.parts.plots.time === 3.05")
    x, y = browser.evaluate("""(({ left, top, width }) => [left + 0.9 * width, top + 9])(
        document.querySelector(".u-over").getBoundingClientRect())""")
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    hovered = f"t = {low + 0.9 * (high - low):.2f} s"
    browser.wait_for(f"document.getElementById('cursor-time').textContent === '{hovered}'")
    assert browser.evaluate(HEADS) == pytest.approx([3.05] * 4, abs=0.01)
    browser.evaluate("document.getElementById('zoom-all').click()")
    browser.evaluate(FRAMES)
    assert browser.evaluate(played) == [None, 1]
    assert browser.evaluate(HEADS) == pytest.approx([3.05] * 4, abs=0.05)
    pushes = """Page.state.setups.map(({ values }) =>
      ["torque_n_m", "start_s"].map((name) => values[`push.${name}`]))"""
    first = browser.evaluate(pushes)[0]
    browser.evaluate("document.getElementById('compare').click()")
    browser.wait_for("Page.results[1].fresh && Page.parts.stage.legs[1].run")
    browser.evaluate("(Page.parts.stage.seek(5), 0)")
    browser.evaluate(FRAMES)
    drag(browser, leg=1)
    browser.wait_for("Page.results[1].fresh")
    assert browser.evaluate(pushes) == [first, [pytest.approx(first[0], abs=6), 5]]
    browser.evaluate("document.getElementById('set-up-a').click()")
    browser.evaluate("(Page.parts.stage.seek(6), 0)")
    browser.evaluate("""[...document.querySelectorAll(".stage-bar button")]
      .find((button) => button.textContent === "Push here").click()""")
    assert browser.evaluate(pushes)[0] == [first[0], 6]
    assert browser.evaluate(pushes)[1][1] == 5
    browser.require_health()
