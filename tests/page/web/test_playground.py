"""The page to play with in Chromium: from the slider to the number that a user reads."""

import base64
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from web_cases import check_words, solver_of, typed

from kneexo.analysis import large_signal_bandwidth_hz, linearize_loop, track
from kneexo.analysis.tracking.clauses import said
from kneexo.errors import KneexoError, SimulationError
from kneexo.page.playground import playground_page
from kneexo.parameters import PushParameters, Scenario, SineReference
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario
from kneexo.version import __version__

pytestmark = pytest.mark.slow

HOSTILE = "</script><img src=x onerror=alert(1)><b>&\"'"
"""A name that would act if the page took it for HTML."""

GEAR, FREQUENCY = "plant.pump.gear_ratio", "reference.frequency_hz"


def _file(folder, scenarios, names):
    file = folder / "my knee.html"
    try:
        file.write_text(playground_page(scenarios, names), encoding="utf-8")
    except KneexoError as error:
        if "ziglang" in str(error):
            pytest.skip("needs ziglang")
        raise
    return file


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    """The page of the paper's setup."""
    return _file(tmp_path_factory.mktemp("one"), [Scenario()], ["preset paper"])


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The page of two scenarios, one with a hostile name."""
    scenarios = [Scenario(), changed(Scenario(), {GEAR: 3.0})]
    return _file(tmp_path_factory.mktemp("two"), scenarios, ["paper", HOSTILE])


class _Page:
    """A page in Chromium, as a user sees it."""

    def __init__(self, browser, file, **options):
        self.browser = browser
        browser.open(file, **{"width": 1440, "height": 900} | options)
        self.evaluate = browser.evaluate
        self.wait()

    def wait(self, index=0):
        """Wait for all results of a set-up at its present values."""
        self.browser.wait_for(
            f"(({{fresh, linear, sweep}}) => fresh && linear && sweep)(Page.results[{index}])"
        )
        self.evaluate("new Promise(requestAnimationFrame).then(() => 0)")

    def type(self, name, value, index=0):
        """Write a number into the field of a quantity, and wait for the results."""
        self.evaluate(typed(name, value))
        if self.evaluate(f'document.getElementById("q-{name}-value").ariaInvalid') != "true":
            self.wait(index)

    def click(self, name, index=0):
        self.evaluate(f"document.getElementById({json.dumps(name)}).click()")
        self.wait(index)

    def number(self, name, index=0):
        """The number that a card of the results shows, and the words below."""
        card = f'document.querySelectorAll("[data-number={name}] .%s")[{index}].textContent'
        text = self.evaluate(
            f'document.querySelectorAll("[data-number={name}] .value .number")[{index}].textContent'
        )
        return text, self.evaluate(card % "word")

    def text(self, name):
        return self.evaluate(f"document.getElementById({json.dumps(name)}).textContent")

    def curve(self, plot, column=1):
        """A line of a plot, as it is drawn."""
        plots = f"Page.parts.plots.plots.find(({{name}}) => name === '{plot}')"
        script = f"Array.from({plots}.data.at({column}))"
        return np.array(self.evaluate(script), dtype=float)

    def yaml(self, index=0):
        return self.evaluate(f"Setups.yamlOf(Page.data, Page.state.setups[{index}])")


def _steps(scenario, page):
    """The scenario with the method of the page."""
    table = page.evaluate(
        """(() => { const model = Setups.modelOf(Page.data, Page.state.setups[0]);
        return Page.data.modules[model.loop.module].table; })()"""
    )
    return changed(scenario, {f"simulation.{k}": v for k, v in solver_of(table).items()})


def _same(text, value):
    """A number with three digits is that value."""
    return float(text.replace("−", "-")) == pytest.approx(value, rel=6e-3)


def test_the_page_is_small_silent_and_fits(browser, single):
    assert single.stat().st_size <= 2e6
    for options in ({}, *({"width": width, "height": 844, "phone": True} for width in (390, 320))):
        _Page(browser, single, **options)
        browser.require_health()
        browser.require_width()


def test_a_phone_shows_numbers_beside_the_moving_slider(browser, single):
    page = _Page(browser, single, width=390, height=844, phone=True)
    page.evaluate(f"document.getElementById('q-{GEAR}').scrollIntoView({{block: 'end'}})")
    page.type("controller.lambda_per_s", 8.0)
    boxes = f"""["brief", "q-{GEAR}"].map((name) => {{
      const box = document.getElementById(name).getBoundingClientRect();
      return [box.top, box.bottom]; }})"""
    brief, slider = page.evaluate(boxes)
    assert 0.0 <= brief[0] < brief[1] <= slider[0] < slider[1] < 845.0  # a scroll has whole px
    error, margin = (page.number(name)[0] for name in ("error", "phase"))
    words = page.text("brief")
    assert words.startswith(f"Largest error {error}deg")
    assert f"Phase margin {margin}deg" in words
    browser.require_width()


SEEN = """(() => { const { activeElement: at } = document;
  if (at === document.body) return null;
  document.getElementById("hint").style.pointerEvents = "auto"; // counts as a cover
  const shown = at.matches(".switch input") ? at.nextElementSibling : at;
  const { left, top, width, height } = shown.getBoundingClientRect();
  const hit = document.elementFromPoint(left + width / 2, top + height / 2);
  return [at.id || at.className || at.tagName, shown.contains(hit)]; })()"""
"""Name of the element with the focus, and whether its middle is in sight; null without focus."""


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (720, 450), (390, 844)])
def test_no_focus_is_hidden(browser, single, width, height):
    page = _Page(browser, single, width=width, height=height)
    page.evaluate("for (const more of document.querySelectorAll('details')) more.open = true")
    tab = {"key": "Tab", "code": "Tab", "windowsVirtualKeyCode": 9}
    for modifiers in (0, 8):  # Shift
        seen = []
        while len(seen) < 300:
            browser.call("Input.dispatchKeyEvent", type="keyDown", modifiers=modifiers, **tab)
            if (focus := page.evaluate(SEEN)) is None:
                break
            seen.append(focus)
        assert len(seen) > 60
        assert [name for name, is_seen in seen if not is_seen] == []
        page.evaluate("document.activeElement.blur()")
    box = page.evaluate(
        f"""(() => {{ const slider = document.getElementById("q-{GEAR}");
        slider.scrollIntoView({{ block: "end" }});
        return slider.getBoundingClientRect().toJSON(); }})()"""
    )
    mouse = {"button": "left", "clickCount": 1, "x": box["x"] + 3, "y": box["bottom"] - 3}
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, **mouse)
    assert page.evaluate(f"Page.state.setups[0].values['{GEAR}']") == 1


def test_a_swipe_scrolls_and_a_drag_sets_a_slider_by_one_entry(browser, single):
    page = _Page(browser, single, width=390, height=844, phone=True)
    slider = f"document.getElementById('q-{GEAR}')"
    for across in (0, 60):
        page.evaluate(f"{slider}.scrollIntoView({{block: 'center'}})")
        before = page.evaluate("scrollY")
        box = page.evaluate(f"{slider}.getBoundingClientRect().toJSON()")
        x, y = box["x"] + 100, box["y"] + box["height"] / 2
        for step in range(11):
            if step == 5 and across:  # a rest within a drag
                page.evaluate("new Promise((resolve) => setTimeout(resolve, 700)).then(() => 0)")
            up = 0 if across else 20 * step
            at = [{"x": x + across * step / 10, "y": y - up}]
            kind = "touchMove" if step else "touchStart"
            browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=at)
        browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        page.evaluate("new Promise((resolve) => setTimeout(resolve, 700)).then(() => 0)")
        assert page.evaluate(f"{GEAR!r} in Page.state.setups[0].values") is bool(across)
        assert (page.evaluate("scrollY") > before + 50) is not bool(across)
        assert (page.evaluate("history.state?.step") or 0) == bool(across)


def test_a_phone_shows_the_curves_then_the_sliders(browser, single):
    page = _Page(browser, single, width=390, height=844, phone=True)
    tops = """["curves", "panel", "leg", "numbers", "bode"].map((name) =>
      document.getElementById(name).getBoundingClientRect().top)"""
    assert page.evaluate(tops) == sorted(page.evaluate(tops))
    first = "document.querySelector('#panel input[type=range]').getBoundingClientRect().bottom"
    assert page.evaluate(first) < 844
    assert page.evaluate("document.getElementById('curves').offsetHeight") <= 844 / 3


def test_plots_grow_with_a_large_window(browser, single):
    heights = []
    for width, height in ((1440, 900), (2560, 1440)):
        page = _Page(browser, single, width=width, height=height)
        heights.append(page.evaluate("document.querySelector('#plots canvas').clientHeight"))
        edges = """["header h1", "#numbers", "header .actions", "#panel"].map((name) =>
          document.querySelector(name).getBoundingClientRect()).map(({ left, right }, k) =>
          (k < 2 ? left : right))"""
        title, numbers, actions, panel = page.evaluate(edges)
        assert [title, actions] == pytest.approx([numbers, panel], abs=0.5)
    assert heights[1] - 24 == 1.6 * (heights[0] - 24) == 240  # the labels of time have 24


def test_the_sweep_stays_when_a_push_changes_and_starts_anew_with_the_loop(browser, single):
    page = _Page(browser, single)
    page.click("load-knee")
    browser.wait_for("Page.results[0].swept")
    page.evaluate(
        "(({ bode }) => { Page.cleared = 0; const clear = bode.clear.bind(bode);"
        "bode.clear = (...more) => { Page.cleared += 1; clear(...more); }; })(Page.parts)"
    )
    points = page.evaluate("Page.parts.bode.points[0].length")
    page.type("push.torque_n_m", 3)
    assert page.evaluate("[Page.cleared, Page.parts.bode.points[0].length]") == [0, points]
    page.type(GEAR, 5)
    assert page.evaluate("Page.cleared") == 1


def test_long_names_fit_a_phone(browser, two):
    _Page(browser, two, width=390, height=844, phone=True).wait(1)
    browser.require_width()


def test_pressures_of_the_page_have_one_unit(browser, single):
    words = _Page(browser, single).text("stage")
    assert "load pressure −35.0 bar" in words
    assert not re.search(r"Pa\b", words)


def test_the_result_of_a_step_is_its_settling_time(browser, single):
    page = _Page(browser, single)
    page.click("reference-step")
    scenario = changed(Scenario(), {"reference": {"kind": "step"}})
    result = track(_steps(scenario, page))
    step, cycle = result.step, result.verdict.limit_cycle
    for name, value in (
        ("settling", step.settling_time_s),
        ("rise", step.rise_time_s),
        ("overshoot", step.overshoot_percent),
        ("final-error", float(f"{step.final_error_deg:.2g}")),
        ("cycle", float(f"{cycle.amplitude_deg:.2g}")),
    ):
        assert _same(page.number(name)[0].removeprefix("±"), value), name
    assert page.number("cycle")[1].startswith(f"hunts every {cycle.period_s:.3g} s")
    assert page.evaluate('document.querySelector("[data-number=error]").hidden')
    low, high = page.evaluate("Page.parts.plots.range")
    assert low < scenario.reference.time_s
    assert high == pytest.approx(scenario.reference.time_s + 3.0 * step.settling_time_s)
    page.click("reference-ramp")
    assert page.evaluate("Page.parts.plots.range") == [0.0, 30.0]
    page.click("reference-step")
    page.type("reference.time_s", 9.9)
    page.type("simulation.duration_s", 10)
    assert page.number("settling")[1] == "does not settle"


def test_the_numbers_on_the_page_are_those_of_kneexo(browser, single):
    page = _Page(browser, single)
    for values in ({}, {FREQUENCY: 0.3}):
        for name, value in values.items():
            page.type(name, value)
        scenario = changed(Scenario(), values)
        result = track(_steps(scenario, page))
        metrics = result.metrics
        margins = linearize_loop(scenario, knee_angle_deg=40.0).margins()
        assert _same(page.number("error")[0], metrics.max_error_deg)
        assert _same(page.number("saturated")[0], 100.0 * metrics.saturated_share)
        assert _same(page.number("phase")[0], margins.phase_margin_deg)
        assert _same(page.number("gain")[0], margins.gain_margin)
        assert _same(page.number("delay")[0], 1e3 * margins.delay_margin_s)
        samples = math.floor(margins.delay_margin_s / scenario.controller.sample_time_s)
        assert page.number("delay")[1] == f"{samples} samples"
        assert page.number("gain")[1] == f"{20.0 * math.log10(margins.gain_margin):.2g} dB"
        # The paper's knee has no weight: its pressure is far below a hundredth of the rating.
        assert page.evaluate('document.querySelector("[data-number=pressure]").hidden')
    assert "saturated most of the time" in page.number("saturated")[1]
    assert "does not follow" in page.number("error")[1]
    bandwidth_hz = large_signal_bandwidth_hz(Scenario())
    assert _same(page.number("bandwidth")[0], bandwidth_hz)
    assert page.number("bandwidth")[1] == "−3 dB, below the sine's 0.3 Hz"
    bandwidth = said("bandwidth", bandwidth_hz=bandwidth_hz)
    check_words(page.text("sentence"), f"{result.verdict.lines[0]} {bandwidth}.")


def test_a_push_is_that_of_kneexo_and_must_end_within_the_run(browser, single, tmp_path):
    page = _Page(browser, single)
    page.click("load-knee")
    assert page.evaluate('document.querySelector("[data-number=recovery]").hidden')
    page.type("push.torque_n_m", 60)
    page.type("push.start_s", 12.5)
    file = tmp_path / "push.yaml"
    file.write_text(page.yaml(), encoding="utf-8")
    scenario = load_scenario(file)
    assert scenario.push == PushParameters(torque_n_m=60.0, start_s=12.5)
    push = track(scenario).push
    assert _same(page.number("deviation")[0], push.largest_deviation_deg)
    assert _same(page.number("recovery")[0], push.recovery_time_s)
    before = page.curve("angle")
    page.evaluate(typed("push.start_s", 29.9))
    assert page.text("notice").startswith("The push ends at 30.1 s, but the run lasts 30 s.")
    np.testing.assert_array_equal(page.curve("angle"), before)
    page.type("push.duration_s", -1)
    row = page.evaluate("document.getElementById('q-push.duration_s').parentElement.textContent")
    assert "must be 0.01 … 5 s" in row
    page.type("push.start_s", 20)
    assert page.evaluate("document.getElementById('notice').hidden") is True
    beyond = "a.load=knee&a.push.torque_n_m=9&a.push.start_s=29.9"
    values = f"Setups.stateOf(Page.data, {json.dumps(beyond)}).setups[0].values"
    assert page.evaluate(values) == {}


def test_pinned_runs_stay_beside_the_present_one_and_are_in_the_link(browser, single):
    page = _Page(browser, single)
    before, number = page.curve("angle"), float(page.number("error")[0])
    page.evaluate("document.getElementById('pin').click()")
    page.type("controller.lambda_per_s", 8.0)
    np.testing.assert_array_equal(page.curve("angle", -4), before)
    assert np.abs(page.curve("angle") - before).max() > 0.01
    now = float(page.number("error")[0])
    line = "[data-number=error] .pinned"
    text = page.evaluate(f"document.querySelector('{line}').textContent")
    change = re.fullmatch(r"pinned ([\d.]+) \(([+−][\d.]+)\)", text)
    assert float(change[1]) == number
    assert float(change[2].replace("−", "-")) == pytest.approx(now - number, rel=6e-3)
    second = page.curve("angle")
    page.evaluate("document.getElementById('pin').click()")
    page.type(GEAR, 3.0)
    lines = "[...document.querySelectorAll('#pins li')].map((item) => item.firstChild.textContent)"
    gear = "gear ratio 6 (now 3)"
    rate = "λ, slope of the sliding surface 20 (now 8) 1/s"
    assert page.evaluate(lines) == [f"pinned: {gear}, {rate}", f"pinned: {gear}"]
    fragment = page.evaluate("Setups.linkOf(Page.data, Page.state)")
    assert fragment.startswith(f"a.{GEAR}=3&a.controller.lambda_per_s=8&")
    assert "&pins=0+1&p1.controller.lambda_per_s=8&" in fragment
    for url in ("about:blank", f"{single.resolve().as_uri()}#{fragment}"):
        browser.load(url=url)
    page.wait()
    browser.wait_for("[...Page.parts.pinned.values()].filter(({ sweep }) => sweep).length === 2")
    page.evaluate("new Promise(requestAnimationFrame).then(() => 0)")
    assert page.text("notice") == ""
    np.testing.assert_array_equal(page.curve("angle", -4), before)
    np.testing.assert_array_equal(page.curve("angle", -3), second)
    page.evaluate("document.querySelector('#pins button').click()")
    browser.wait_for("document.querySelectorAll('#pins li').length === 1")
    assert np.isnan(page.curve("angle", -4)).all()
    notices = []
    for value in (4.0, 5.0, 7.0, 8.0):
        page.evaluate("document.getElementById('pin').click()")
        page.evaluate("new Promise(requestAnimationFrame).then(() => 0)")
        notices.append(page.text("notice"))
        page.type(GEAR, value)
    assert page.evaluate("Page.state.pins.map(({ slot }) => slot)") == [0, 2, 3, 1]
    assert len(page.evaluate(lines)) == 4
    assert notices[:3] == ["", "", ""]
    assert notices[3].startswith(f"The oldest pinned run ({gear.replace('now 3', 'now 7')}")


def test_two_cursors_measure_times_and_values(browser, single):
    page = _Page(browser, single)
    page.evaluate("document.getElementById('measure').click()")

    def read():
        words = page.text("cursor-distance")
        curve = page.evaluate(
            "document.querySelector('[data-plot=angle] .plot-values').textContent"
        )
        return words, curve

    for number, text in ((1, "2,5"), (2, "5"), (1, "x")):
        page.evaluate(
            f"""(() => {{ const box = document.getElementById("cursor-{number}");
            box.value = "{text}"; box.dispatchEvent(new Event("change")); }})()"""
        )
    assert page.evaluate("document.getElementById('cursor-1').value") == "2.5"
    page.evaluate("document.getElementById('pin').click()")
    page.type(GEAR, 5.0)
    heights = "[...document.querySelectorAll('#plots figcaption')].map((one) => one.offsetHeight)"
    assert max(page.evaluate(heights)) < 30  # captions stay on one line
    assert re.search(r"^A Δ [+−][\d.]+Δ [+−][\d.]+$", read()[1])
    page.type(GEAR, 6.0)
    page.evaluate("document.querySelector('#pins button').click()")
    browser.wait_for("!document.querySelector('#pins li')")
    page.evaluate("new Promise(requestAnimationFrame).then(() => 0)")
    first, second = page.curve("angle")[[1250, 2500]]
    words, curve = read()
    assert words == "Δt = 2.5 s, 1/Δt = 0.4 Hz"
    assert curve == f"{first:.2f} → {second:.2f}, Δ +{second - first:.2f}"
    x, y = page.evaluate(
        """(({ chart }) => { const box = chart.over.getBoundingClientRect();
        return [box.left + chart.valToPos(7.5, "x"), box.top + 20]; })(Page.parts.plots.plots[0])"""
    )
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)
    distance = float(read()[0].split()[2])
    assert distance == pytest.approx(5.0, abs=0.05)
    page.evaluate("document.getElementById('measure').click()")
    assert page.evaluate("document.getElementById('cursors').hidden")
    assert page.evaluate("Page.parts.plots.cursors") is None


def test_a_slider_changes_the_curves_that_are_drawn(browser, single):
    page = _Page(browser, single)
    page.evaluate(
        f"""(() => {{ const slider = document.getElementById("q-{GEAR}");
        slider.value = 450; slider.dispatchEvent(new Event("input")); }})()"""
    )
    page.wait()
    gear = page.evaluate(f"Page.state.setups[0].values['{GEAR}']")
    assert float(page.evaluate(f"document.getElementById('q-{GEAR}-value').value")) == gear > 10.0
    result = track(_steps(changed(Scenario(), {GEAR: gear}), page))
    angle = np.degrees(result["knee_angle_rad"])
    np.testing.assert_allclose(page.curve("angle"), angle, atol=1e-7)
    np.testing.assert_allclose(page.curve("error"), result.error_deg, atol=1e-7)
    rpm = result["motor_speed_command_rad_s"] * 30.0 / math.pi
    np.testing.assert_allclose(page.curve("command"), rpm, atol=1e-5)
    limit = np.full(rpm.size, 5000.0)
    np.testing.assert_allclose(page.curve("command", 3), limit, rtol=1e-12)
    np.testing.assert_allclose(page.curve("command", 4), -limit, rtol=1e-12)
    bar = 1e-5 * result["load_pressure_pa"]
    np.testing.assert_allclose(page.curve("pressure"), bar, atol=1e-6 * np.abs(bar).max())
    reference = np.degrees(result["knee_reference_rad"])
    np.testing.assert_allclose(page.curve("angle", 3), reference, atol=1e-10)


def test_samples_and_the_numbers_of_a_design_are_in_the_yaml(browser, tmp_path):
    walk = {"kind": "gait", "frequency_hz": 0.3, "cycles": 2}
    design = {"plant.pump.lag_s": 0.02, "controller.lambda_per_s": 15.0, "reference": walk}
    scenario = changed(Scenario(), design)
    page = _Page(browser, _file(tmp_path, [scenario], ["walk"]))
    page.type(GEAR, 5.0)
    file = tmp_path / "page.yaml"
    file.write_text(page.yaml(), encoding="utf-8")
    written = load_scenario(file)
    expected = _steps(changed(scenario.with_duration(), {GEAR: 5.0}), page)
    assert written.model_copy(update={"simulation": expected.simulation}) == expected
    metrics = track(written).metrics
    error = page.evaluate("Page.results[0].run.metrics.largest_error_rad")
    assert math.degrees(error) == pytest.approx(metrics.max_error_deg, rel=1e-6)
    page.click("reference-sine")
    file.write_text(page.yaml(), encoding="utf-8")
    assert load_scenario(file).reference == SineReference()


@pytest.mark.slow(gate=1)
@pytest.mark.parametrize("reference", ["sine", "step", "ramp"])
def test_the_yaml_of_the_page_runs_as_the_page_does(browser, single, tmp_path, reference):
    page = _Page(browser, single)
    page.click("controller-pid")
    page.click("load-knee")
    page.click(f"reference-{reference}")
    values = {
        GEAR: 4.5,
        "plant.cylinder.bulk_modulus_pa": 9e8,
        "plant.pump.internal_leakage_m3_per_s_pa": 4e-13,
        "plant.load.segment_mass_kg": 2.25,
        "controller.proportional_per_s": 7.0,
    }
    for name, value in values.items():
        factor = page.evaluate(
            f"""Setups.quantitiesOf(Page.data, Page.state.setups[0])
            .find(({{name}}) => name === "{name}").shown_factor"""
        )
        page.type(name, value * factor)
    file = tmp_path / "page.yaml"
    file.write_text(page.yaml(), encoding="utf-8")
    scenario = load_scenario(file)
    kinds = {"controller": "pid", "plant.load": "knee", "reference": reference}
    expected = changed(changed(Scenario(), kinds), values)
    for name in values:
        parent, _, leaf = name.rpartition(".")
        holders = []
        for root in (scenario, expected):
            for part in parent.split("."):
                root = getattr(root, part)
            holders.append(getattr(root, leaf))
        assert holders[0] == pytest.approx(holders[1], rel=1e-12)
    metrics = track(scenario).metrics
    error = page.evaluate("Page.results[0].run.metrics.largest_error_rad")
    assert math.degrees(error) == pytest.approx(metrics.max_error_deg, rel=1e-6)


def test_the_saved_files_are_the_run_of_kneexo(browser, single, tmp_path):
    page = _Page(browser, single)
    page.type("controller.lambda_per_s", 12)
    browser.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))

    def saved(name, button):
        page.evaluate(f"document.getElementById('{button}').click()")
        browser.wait_for((tmp_path / name).is_file)
        return tmp_path / name

    page.evaluate("document.getElementById('copy-yaml').click()")
    run = track(load_scenario(saved("scenario.yaml", "save-text"))).run
    table = np.genfromtxt(saved("signals.csv", "save-csv"), delimiter=",", names=True)
    assert table.dtype.names[0] == "time_s"
    np.testing.assert_allclose(table["time_s"], run.time_s, rtol=0.0, atol=1e-9)
    assert len(table.dtype.names) == 5
    for name in table.dtype.names[1:]:
        size = np.abs(run[name]).max()
        np.testing.assert_allclose(table[name], run[name], rtol=0.0, atol=1e-8 * size)
    page.evaluate("document.getElementById('text-dialog').close()")
    picture = imread(saved("curves.png", "save-png"))[..., :3]
    width = page.evaluate("document.querySelector('#plots canvas').width")
    assert picture.shape[:2] == (96 + sum((150, 100, 110, 100)) + 24 + 2 * 24 + 48, width)
    is_ink = np.abs(picture - np.array([0x1F, 0x23, 0x28]) / 255.0).max(axis=2) < 0.1
    runs = np.diff(np.flatnonzero(np.diff(is_ink[12, :300].astype(int))))[:5]
    assert list(runs[:3]) == pytest.approx([6, 4, 6], abs=1)  # the reference is dashed
    assert "slope of the sliding surface 12 1/s" in page.evaluate("Page.changesOf(0)")
    assert (picture[-48:].min(axis=2) < 0.6).any(axis=1).sum() > 16  # two lines of text
    is_curve = np.abs(picture - np.array([0.0, 0x62, 0xA8]) / 255.0).max(axis=2) < 0.02
    tops = 24 + np.cumsum([0, 198, 124, 134])
    for top, height in zip(tops, (198, 124, 134, 148), strict=True):
        assert is_curve[top + 24 : top + height].sum() > 200  # each plot has its curve
    page.evaluate("document.getElementById('copy-link').click()")
    assert page.evaluate("document.getElementById('save-text').hidden")
    page.evaluate("document.getElementById('text-dialog').close()")
    page.click("compare", 1)
    accent = "getComputedStyle(document.querySelector('#panel input[type=range]')).accentColor"
    for letter, colour in (("A", "rgb(0, 98, 168)"), ("B", "rgb(184, 72, 10)")):
        page.click(f"set-up-{letter.lower()}", 1)
        saved(f"signals_{letter}.csv", "save-csv")
        page.evaluate("document.getElementById('copy-yaml').click()")
        saved(f"scenario_{letter}.yaml", "save-text")
        page.evaluate("document.getElementById('text-dialog').close()")
        assert page.evaluate(accent) == colour


def test_a_link_carries_the_values(browser, single, tmp_path):
    page = _Page(browser, single)
    page.click("controller-pid")
    page.type(GEAR, 3.5)
    fragment = page.evaluate("Setups.linkOf(Page.data, Page.state)")
    assert fragment == f"a.controller=pid&a.{GEAR}=3.5&kneexo={__version__}"
    for url in ("about:blank", f"{single.resolve().as_uri()}#{fragment}"):
        browser.load(url=url)
    page.wait()
    state = page.evaluate("JSON.parse(JSON.stringify(Page.state.setups[0]))")
    assert (state["controller"], state["values"]) == ("pid", {GEAR: 3.5})
    assert page.evaluate(f"document.getElementById('q-{GEAR}-value').value") == "3.5"


def test_the_address_follows_the_values_and_undo_and_reload_restore_them(browser, single):
    page = _Page(browser, single)
    gear = f"document.getElementById('q-{GEAR}-value')?.value"  # none while a page loads

    def arrive(value, step):
        browser.wait_for(f"{gear} === '{value}' && history.state?.step === {step}")

    for value in (3.5, 4.5):
        page.type(GEAR, value)
        browser.wait_for(f"location.hash.includes('{GEAR}={value}')")
    page.evaluate("document.getElementById('undo').click()")
    arrive(3.5, 1)
    page.wait()
    metrics = track(_steps(changed(Scenario(), {GEAR: 3.5}), page)).metrics
    assert _same(page.number("error")[0], metrics.max_error_deg)
    keys = {"key": "y", "code": "KeyY", "windowsVirtualKeyCode": 89, "modifiers": 2}
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, **keys)
    arrive(4.5, 2)
    assert page.evaluate("document.getElementById('redo').disabled")
    browser.load("Page.reload")
    arrive(4.5, 2)
    assert not page.evaluate("document.getElementById('undo').disabled")
    entries = browser.call("Page.getNavigationHistory")
    first = entries["entries"][entries["currentIndex"] - 2]  # as a user holds the Back button
    browser.call("Page.navigateToHistoryEntry", entryId=first["id"])
    browser.wait_for(f"{gear} === '6' && location.hash === ''")
    assert page.evaluate("document.getElementById('undo').disabled")
    assert page.evaluate("Page.state.setups[0].values") == {}


def test_a_link_of_another_version_is_said_and_its_values_kept_where_they_fit(browser, single):
    fragment = f"a.{GEAR}=3.5&a.plant.gone=1&a.{FREQUENCY}=1000&kneexo=0.0.1"
    for url in ("about:blank", f"{single.resolve().as_uri()}#{fragment}"):
        browser.load(url=url)
    browser.wait_for("Page.results[0].fresh")
    words = f"The link is of kneexo 0.0.1, and this page of {__version__}. 2 values of the link do"
    assert browser.evaluate("document.getElementById('notice').textContent").startswith(words)
    assert browser.evaluate("Page.state.setups[0].values") == {GEAR: 3.5}
    browser.evaluate(typed(GEAR, 4))
    assert browser.evaluate("document.getElementById('notice').hidden")


@pytest.mark.parametrize(
    "fragment",
    [
        f"a.{GEAR}=1e999",
        f"a.{GEAR}=0.5",
        f"a.{GEAR}=21",
        f"a.{GEAR}=NaN",
        f"a.{GEAR}=3;alert(1)",
        f"a.{GEAR}=0x3",
        f"a.{GEAR}=",
        "a.__proto__=1&a.constructor=2&__proto__.x=3",
        "a.controller=__proto__&a.load=toString&a.reference=constructor",
        "a.scenario=7&b.scenario=-1",
        "compare=__proto__",
        "%E0%A4%A&a=<script>alert(1)</script>",
        "a.plant.unknown=3&x=y",
        "a.reference.amplitude_deg=44&a.reference.mean_deg=85",
    ],
)
def test_a_hostile_link_has_no_effect(browser, single, fragment):
    browser.open(single, 1440, 900)
    states = browser.evaluate(
        f"""JSON.stringify([Setups.stateOf(Page.data, "#"), Setups.stateOf(Page.data,
        {json.dumps("#" + fragment)})])"""
    )
    plain, hostile = json.loads(states)
    assert hostile == plain
    assert browser.evaluate("({}).x") is None


def test_names_of_users_are_text(browser, two):
    page = _Page(browser, two)
    page.wait(1)
    browser.require_health()
    assert HOSTILE in page.text("scenario-name")
    assert page.evaluate("document.querySelectorAll('main b, main img, header b').length") == 0
    assert HOSTILE in page.evaluate("document.querySelector('#stage').textContent")


def test_two_set_ups_stand_beside_each_other(browser, two):
    page = _Page(browser, two)
    page.wait(1)
    assert page.evaluate("document.querySelectorAll('.stage-leg').length") == 2
    steps = _steps(Scenario(), page).simulation
    for index, gear in enumerate((6.0, 3.0)):
        scenario = changed(Scenario(), {GEAR: gear}).model_copy(update={"simulation": steps})
        result = track(scenario)
        angle = np.degrees(result["knee_angle_rad"])
        np.testing.assert_allclose(page.curve("angle", index + 1), angle, atol=1e-7)
        assert _same(page.number("error", index)[0], result.metrics.max_error_deg)
    note = page.evaluate(f"document.getElementById('q-{GEAR}').parentElement.textContent")
    assert "B has 3" in note
    page.type(FREQUENCY, 0.2)
    page.evaluate("document.getElementById('copy-a-b').click()")
    page.wait(1)
    first, second = json.loads(page.evaluate("JSON.stringify(Page.state.setups)"))
    assert first == second
    assert first["values"] == {FREQUENCY: 0.2}
    page.click("compare")
    assert (
        page.evaluate("getComputedStyle(document.querySelectorAll('.value.of-b')[0]).display")
        == "none"
    )
    assert np.isnan(page.curve("angle", 2)).all()


def test_the_other_controller_is_compared_in_the_present_task(browser, single):
    page = _Page(browser, single)
    page.click("load-knee")
    page.type(GEAR, 5)
    page.click("compare")
    page.wait(1)
    first, second = json.loads(page.evaluate("JSON.stringify(Page.state.setups)"))
    assert second == first | {"controller": "pid"}
    assert first["values"] == {GEAR: 5}
    page.click("compare")
    page.type(GEAR, 7)
    page.click("compare")
    page.wait(1)
    assert page.evaluate("Page.state.setups[1].values") == {GEAR: 5}  # as the user left it


def test_a_choice_of_scenarios_leaves_one_stage_in_three_dimensions(browser, two):
    page = _Page(browser, two, motion=True)
    page.wait(1)
    drawing = page.evaluate("Page.parts.stage._drawing.constructor.name")
    for turn in range(20):  # a browser has 16 WebGL contexts
        page.evaluate(f"document.getElementById('scenario-{(turn + 1) % 2}').click()")
    page.wait()
    page.evaluate("new Promise((resolve) => setTimeout(resolve, 500)).then(() => 0)")
    assert page.evaluate("document.querySelectorAll('#stage > .stage').length") == 1
    assert page.evaluate("Page.parts.stage._drawing.constructor.name") == drawing
    assert page.evaluate("Page.parts.stage.playing")
    page.evaluate("Page.parts.stage.pause()")
    page.click("compare")
    assert not page.evaluate("Page.parts.stage.playing")
    browser.require_health()


def test_a_value_out_of_range_is_refused_with_its_range(browser, single):
    page = _Page(browser, single)
    for text in ("25", "gear", "1e999", ""):
        page.type(GEAR, text)
        row = page.evaluate(f"document.getElementById('q-{GEAR}').parentElement.textContent")
        assert "must be 1 … 20" in row
        assert page.evaluate("Page.state.setups[0].values") == {}
    page.type(GEAR, "3,5")
    assert page.evaluate("Page.state.setups[0].values") == {GEAR: 3.5}


def test_a_reference_beyond_the_range_of_motion_is_a_sentence(browser, single):
    page = _Page(browser, single)
    page.evaluate(typed("reference.amplitude_deg", 44))
    assert "would reach −4°, but the knee moves only from 0° to 90°" in page.text("notice")
    assert page.evaluate("document.getElementById('notice').hidden") is False
    page.type("reference.amplitude_deg", "40")
    assert page.evaluate("document.getElementById('notice').hidden") is True


def test_a_run_that_fails_shows_its_curve_to_the_end_and_the_reason(browser, single):
    page = _Page(browser, single)
    values = {
        FREQUENCY: 0.27,
        GEAR: 1.9,
        "controller.lambda_per_s": 9.0,
        "controller.eta_m_s3": 4500.0,
    }
    for name, value in values.items():
        page.type(name, value)
    with pytest.raises(SimulationError):
        track(_steps(changed(Scenario(), values), page))
    end_s = page.evaluate("Page.results[0].run.end.time_s")
    assert 0.0 < end_s < 30.0
    assert page.text("notice").startswith(
        f"The run ended at {end_s:.3g} s: the knee or the cylinder"
    )
    assert page.evaluate("document.getElementById('notice').hidden") is False
    angle = page.curve("angle")
    assert np.isfinite(angle).sum() == angle.size == round(end_s / 0.002) + 1
    low, high = page.evaluate("Page.parts.plots.range")
    assert (low, high) == (0.0, 30.0)
    assert page.number("error")[1] == "the run ended early"


def test_the_sweep_draws_its_points_and_the_bandwidth(browser, single):
    page = _Page(browser, single)
    browser.wait_for("Page.results[0].swept")
    grid, gain = page.evaluate("Page.parts.bode.plots[0].chart.data.slice(0, 2)")
    phase = page.evaluate("Page.parts.bode.plots[1].chart.data[1]")
    points = page.evaluate("Page.parts.bode.points[0]")
    assert len(points) >= 17
    drawn = {hz: pair for hz, *pair in zip(grid, gain, phase, strict=True)}
    for point in points:
        decibels = 20.0 * math.log10(point["gain"])
        assert drawn[point["frequency_hz"]] == pytest.approx([decibels, point["phase_deg"]])
    assert points[0]["saturated_share"] == 0.0
    assert points[-1]["saturated_share"] > 0.5
    hz = large_signal_bandwidth_hz(Scenario())
    assert page.evaluate("Page.parts.bode.minus3db[0]") == pytest.approx(hz, rel=1e-3)
    known = [i for i, value in enumerate(gain) if value is not None]
    at = np.interp(hz, np.array(grid)[known], np.array(gain, dtype=float)[known])
    assert at == pytest.approx(-3.0103, abs=0.05)


def test_phases_continue_and_low_gains_stay_in_sight(browser, single):
    page = _Page(browser, single)
    browser.wait_for("Page.results[0].swept")
    falls = -144.0 * np.arange(1, 5)  # from point to point
    measured = (falls + 180.0) % 360.0 - 180.0
    points = [
        {"frequency_hz": k + 1, "gain": 10.0 ** -(k + 1), "phase_deg": measured[k]}
        for k in (1, 3, 0, 2)
    ]
    page.evaluate(
        f"""(() => {{ const {{ bode }} = Page.parts; bode.clear(0);
        {json.dumps(points)}.forEach((point) => bode.add(0, point)); }})()"""
    )
    plots = "Page.parts.bode.plots"
    grid, gain = page.evaluate(f"{plots}[0].chart.data.slice(0, 2)")
    phase = page.evaluate(f"{plots}[1].chart.data[1]")
    at = [grid.index(frequency) for frequency in (1, 2, 3, 4)]
    np.testing.assert_allclose([phase[k] for k in at], falls, atol=1e-9)
    np.testing.assert_allclose([gain[k] for k in at], [-20, -40, -60, -80], atol=1e-9)
    browser.wait_for(f"{plots}[1].chart.scales.y.min <= {falls[-1]}")
    browser.wait_for(f"{plots}[0].chart.scales.y.min <= -80")


def test_nothing_is_drawn_before_the_first_run(browser, single):
    script = "window.Worker = class { addEventListener() {} postMessage() {} }"
    browser.open(single, 1440, 900, script=script)
    browser.wait_for("Page.parts.bode?.plots.length === 2")
    values = """[...Page.parts.plots.plots, ...Page.parts.bode.plots]
      .flatMap(({ chart }) => chart.data.slice(1).flatMap((column) => [...column]))
      .filter((value) => value !== null)"""
    assert browser.evaluate(values) == []
    assert browser.evaluate("document.querySelectorAll('.card:not([hidden])').length") == 0
    waiting = """[document.querySelector("#stage output").textContent,
      getComputedStyle(document.getElementById("plots"), "::before").content,
      ...[...document.querySelectorAll("#plots canvas")].map((e) => e.checkVisibility(
        { visibilityProperty: true }))]"""
    assert set(browser.evaluate(waiting)) == {"computing …", '"computing …"', False}
    assert browser.evaluate("document.querySelector('[data-plot=torque]').hidden")
    for name in ("zoom-in", "zoom-all", "measure", "save-csv"):
        browser.evaluate(f"document.getElementById('{name}').click()")
    browser.require_health()


def test_numbers_of_an_unfinished_run_are_marked(browser, single):
    page = _Page(browser, single)
    before = page.number("error")[0]
    unfinished = """((part_s) => { const [result] = Page.results;
      const largest_error_rad = 0.5 * result.run.metrics.largest_error_rad;
      const metrics = { ...result.run.metrics, largest_error_rad };
      Page.results[0] = { ...result, fresh: false,
        run: { ...result.run, metrics, unfinished: true, part_s } };
      Page.draw(); })"""
    marked = (
        "[...document.querySelectorAll('.value.part')].map((e) => e.parentElement.dataset.number)"
    )
    frame = "new Promise(requestAnimationFrame).then(() => 0)"
    assert page.evaluate(marked) == []
    page.evaluate(f"{unfinished}(3.25)")
    page.evaluate(frame)
    assert page.evaluate(marked) == ["error", "saturated"]
    number, word = page.number("error")
    assert float(number) == pytest.approx(0.5 * float(before), rel=0.01)
    assert word == "first 3.3 s of 30 s"
    assert page.number("phase")[1] == "large"
    for button in ("save-csv", "pin"):
        assert page.evaluate(f"document.getElementById('{button}').disabled")
    page.evaluate(f"{unfinished}(null)")
    page.evaluate(frame)
    assert page.number("error")[1] == "computing"
    page.click("compare")
    page.wait(1)
    page.evaluate("Page.state.compare = false, null")  # B has a line when the first part of A comes
    page.evaluate(f"{unfinished}(3.25)")
    page.evaluate(frame)
    assert page.evaluate("document.querySelectorAll('.value.of-b:not([hidden])').length") == 0
    page.type(GEAR, 6)
    assert page.evaluate(marked) == []
    assert page.number("error") == (before, page.number("error")[1])
    assert not page.evaluate("document.getElementById('save-csv').disabled")


def test_the_first_part_of_a_run_sets_no_zoom_for_the_whole(browser, single):
    page = _Page(browser, single)
    page.click("reference-step")
    zoom = page.evaluate("Page.parts.plots.range")
    assert zoom[1] < 10.0
    show = """((run) => { const first = run.time.findIndex((time) => time > 0.2);
      const part = { ...run, unfinished: true, time: run.time.slice(0, first), metrics: {},
        columns: Object.fromEntries(
          Object.entries(run.columns).map(([name, column]) => [name, column.slice(0, first)])) };
      Page.parts.plots.kind = "";  // as after another reference
      Page.parts.plots.show([part]);
      const range = [...Page.parts.plots.range];
      Page.parts.plots.show([run]);
      return [range, Page.parts.plots.range]; })(Page.results[0].run)"""
    assert page.evaluate(show) == [[0, 30], zoom]


def test_the_newest_of_many_values_is_shown(browser, single):
    page = _Page(browser, single)
    page.evaluate(
        f"""(() => {{ const slider = document.getElementById("q-{GEAR}");
        for (let at = 150; at <= 400; at += 5) {{
          slider.value = at; slider.dispatchEvent(new Event("input")); }} }})()"""
    )
    page.wait()
    gear = page.evaluate(f"Page.state.setups[0].values['{GEAR}']")
    error = page.evaluate("Page.results[0].run.metrics.largest_error_rad")
    result = track(_steps(changed(Scenario(), {GEAR: gear}), page))
    assert math.degrees(error) == pytest.approx(result.metrics.max_error_deg, rel=1e-6)


def test_the_keyboard_reaches_and_moves_the_sliders(browser, single):
    page = _Page(browser, single)
    page.evaluate(f"document.getElementById('q-{FREQUENCY}-value').focus()")
    before = page.evaluate(f"document.getElementById('q-{FREQUENCY}').value")

    def press(key, **more):
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, **more)

    press("Tab", windowsVirtualKeyCode=9, modifiers=8)
    assert page.evaluate("document.activeElement.id") == f"q-{FREQUENCY}"
    press("ArrowRight", windowsVirtualKeyCode=39)
    browser.wait_for(f"document.getElementById('q-{FREQUENCY}').value === '{int(before) + 1}'")
    page.wait()
    assert FREQUENCY in page.evaluate("Page.state.setups[0].values")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"


def test_a_page_without_webgl_and_with_blocked_storage_works(browser, single):
    script = """for (const name of ["localStorage", "sessionStorage", "indexedDB"]) {
      const get = () => { throw new DOMException("no", "SecurityError"); };
      Object.defineProperty(window, name, { get });
    }
    HTMLCanvasElement.prototype.getContext = (original => function (kind, ...more) {
      return kind.startsWith("webgl") ? null : original.call(this, kind, ...more);
    })(HTMLCanvasElement.prototype.getContext);"""
    page = _Page(browser, single, script=script)
    assert _same(page.number("bandwidth")[0], 0.224)
    lines = page.evaluate("[...document.querySelectorAll('.stage-note')].map((e) => e.textContent)")
    assert lines == ["This browser has no WebGL, so the view shows the leg from the side only."]
    browser.require_health()


@pytest.mark.parametrize(
    ("missing", "why"), [("Worker", "Worker is not"), ("WebAssembly", "It has no WebAssembly.")]
)
def test_a_page_that_cannot_run_says_so_and_shows_no_half(browser, single, missing, why):
    browser.open(single, script=f"delete window.{missing}")
    notice = browser.evaluate("notice.textContent")
    assert notice.startswith(f"This browser cannot run the simulation. {why}")
    for name, shown in (("#notice", True), ("main", False), (".actions", False), ("h1", True)):
        script = f"document.querySelector('{name}').checkVisibility()"
        assert browser.evaluate(script) is shown, name


@pytest.mark.parametrize("motion", [False, True])
def test_reduced_motion_starts_no_animation(browser, single, motion):
    page = _Page(browser, single, motion=motion)
    assert page.evaluate("Page.parts.stage.playing") is motion


def test_a_dark_screen_has_a_dark_page_and_light_paper(browser, single):
    page = _Page(browser, single)
    light_blue, dark_blue = [0x00, 0x62, 0xA8], [0x6D, 0xB5, 0xF5]

    def is_drawn(colour):
        """Whether the first plot has a curve of that colour."""
        script = """((colour) => {
          const [{ chart: { ctx } }] = Page.parts.plots.plots;
          const { data } = ctx.getImageData(0, 0, ctx.canvas.width, ctx.canvas.height);
          let count = 0;
          for (let k = 0; k < data.length; k += 4) {
            const near = (part, c) => Math.abs(data[k + c] - part) < 3;
            count += data[k + 3] > 250 && colour.every(near);
          }
          return count > 100; })"""
        page.evaluate("new Promise(requestAnimationFrame).then(() => 0)")
        return page.evaluate(f"{script}({colour})")

    def ground():
        return page.evaluate("getComputedStyle(document.body).backgroundColor")

    assert ground() == "rgb(245, 246, 248)"
    assert is_drawn(light_blue)
    browser.emulate(scheme="dark")
    browser.wait_for("matchMedia('(prefers-color-scheme: dark)').matches")
    assert ground() == "rgb(20, 23, 27)"
    box = "getComputedStyle(document.querySelector('.stage-box')).backgroundImage"
    assert "rgb(141, 153, 166)" in page.evaluate(box)
    assert is_drawn(dark_blue)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert is_drawn(light_blue)
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert is_drawn(dark_blue)


def test_paper_has_values_numbers_and_curves(browser, single):
    page = _Page(browser, single)
    page.type(GEAR, 4.5)
    pages = base64.b64decode(browser.call("Page.printToPDF")["data"])
    assert pages.startswith(b"%PDF")
    rows = page.evaluate(
        "[...document.querySelectorAll('#values tr')].map(({textContent}) => textContent)"
    )
    assert "gear ratio4.5" in rows
    assert "controllersliding mode" in rows
    browser.emulate(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    shown = """[...document.querySelectorAll(
      "#panel, #values, #plots .plot:not([hidden]) canvas, #numbers, .stage-legend, #pin")]
    .map(element => element.checkVisibility())"""
    assert page.evaluate(shown) == [True, False, True, True, True, True, False, True, True]
    wide = """[...document.querySelectorAll("#plots .plot:not([hidden]) canvas")].map((e) =>
      e.clientWidth - document.getElementById("plots").clientWidth)"""
    assert np.abs(page.evaluate(wide)).max() <= 1
    caption = page.evaluate("document.querySelector('#values caption').textContent")
    assert re.match(rf"Values of this page: kneexo {__version__}, \d{{4}}-\d\d-\d\d", caption)
    assert caption.endswith(f"#a.{GEAR}=4.5&kneexo={__version__}")


AXE = Path(__file__).with_name("vendor") / "axe.min.js"


@pytest.mark.parametrize(("phone", "scheme"), [(False, ""), (True, ""), (False, "dark")])
def test_axe_finds_nothing(browser, two, phone, scheme):
    size = {"width": 390, "height": 844, "phone": True} if phone else {}
    page = _Page(browser, two, scheme=scheme, **size)
    page.wait()
    page.wait(1)
    browser.call("Runtime.evaluate", expression=AXE.read_text(encoding="utf-8"))
    script = """axe.run({runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]})
    .then(({violations, passes}) => [passes.length, violations.map(({id, nodes}) =>
      [id, ...nodes.map(({target}) => target.join(" "))])])"""
    passes, violations = page.evaluate(script)
    assert passes > 15
    assert violations == []
