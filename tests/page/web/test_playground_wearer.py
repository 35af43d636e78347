"""The page to play with for a wearer, from the slider to the number that a user reads."""

import json

import numpy as np
import pytest
from web_cases import typed

from kneexo.analysis import interaction_metrics, track
from kneexo.page.playground import playground_page
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import load_scenario

pytestmark = pytest.mark.slow

CARDS = {
    "rms-torque": "rms_torque_n_m",
    "peak-torque": "peak_torque_n_m",
    "power-from-wearer": "power_from_wearer_w",
    "power-to-wearer": "power_to_wearer_w",
}
STIFFNESS = "wearer.cuff.stiffness_n_m_per_rad"
READ = """(() => Object.fromEntries([...document.querySelectorAll(".card")]
  .filter((card) => !card.hidden)
  .map((card) => [card.dataset.number, [...card.querySelectorAll(".value:not([hidden]) .number")]
    .map((cell) => Number(cell.textContent.replace("−", "-")))])))()"""
WAIT = """new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))
  .then(() => 0)"""


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    # With a stiffer cuff `simulate` refuses the step of the page, 33 µs, for moments of the run.
    scenario = Scenario.preset("wearer").changed(
        {"reference.frequency_hz": 0.8, "simulation.duration_s": 4.0, STIFFNESS: 600.0}
    )
    file = tmp_path_factory.mktemp("worn") / "wearer.html"
    file.write_text(playground_page([scenario], ["worn"]), encoding="utf-8")
    return file


def wait(browser, index):
    browser.wait_for(f"Page.results[{index}].fresh")
    browser.evaluate(WAIT)


def opened(browser, file, *size, **options):
    browser.open(file, *(size or (1440, 900)), **options)
    wait(browser, 0)
    return browser


def run_of(browser, index, folder):
    """The run of kneexo with the YAML of a set-up."""
    file = folder / "page.yaml"
    text = browser.evaluate(f"Setups.yamlOf(Page.data, Page.state.setups[{index}])")
    file.write_text(text, encoding="utf-8")
    return track(load_scenario(file)).run


def check_cards(browser, index, run):
    cards, expected = browser.evaluate(READ), interaction_metrics(run, period_s=1.25)
    for name, metric in CARDS.items():
        assert cards[name][index] == pytest.approx(getattr(expected, metric), rel=6e-3), name


def test_the_cards_and_the_curve_are_the_torque_of_kneexo(browser, page_file, tmp_path):
    opened(browser, page_file)
    before = browser.evaluate(READ)
    assert set(before) == {*CARDS, "saturated", "pressure"}  # margins are those of position control
    check_cards(browser, 0, run_of(browser, 0, tmp_path))
    browser.evaluate(typed(STIFFNESS, 400))
    wait(browser, 0)
    run = run_of(browser, 0, tmp_path)
    check_cards(browser, 0, run)
    assert browser.evaluate(READ)["rms-torque"] != before["rms-torque"]
    for plot, column, factor, place in (
        ("torque", "interaction_torque_n_m", 1.0, 1),
        ("angle", "wearer_angle_rad", 180.0 / np.pi, 4),
    ):
        plots = f"Page.parts.plots.plots.find(({{ name }}) => name === '{plot}')"
        drawn = np.array(browser.evaluate(f"Array.from({plots}.data[{place}])"))
        expected = factor * run[column]
        np.testing.assert_allclose(drawn, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    words = browser.evaluate("document.querySelector('[data-number=rms-torque] .word').textContent")
    assert words == "of the wearer, 2 periods after the first"
    for name, hidden in (("bode", True), ("wearer-note", False)):
        assert browser.evaluate(f"document.getElementById('{name}').hidden") is hidden
    browser.require_health()
    browser.require_width()


def test_zero_torque_and_impedance_stand_beside_each_other(browser, page_file, tmp_path):
    opened(browser, page_file, 390, 844, phone=True)
    browser.evaluate("document.getElementById('compare').click()")
    wait(browser, 1)
    names = "[...document.querySelectorAll('.stage-leg .name')].map((e) => e.textContent).join()"
    browser.wait_for(
        f"{names} === 'A: zero torque,B: impedance'"
    )  # the stage rests before it draws
    for index in (0, 1):
        check_cards(browser, index, run_of(browser, index, tmp_path))
    assert browser.evaluate("document.querySelector('.stage-legend .wearer').checkVisibility()")
    choose = """(() => { const box = document.getElementById("choose-plot"); box.value = "torque";
      box.dispatchEvent(new Event("change"));
      return document.querySelector('[data-plot="torque"]').checkVisibility(); })()"""
    assert browser.evaluate(choose)
    browser.require_health()
    browser.require_width()


def test_a_choice_that_is_not_on_the_page_is_grey(browser, page_file, tmp_path):
    text, missing = page_file.read_text(encoding="utf-8"), {"needs Zig & more": [["pid", "knee"]]}
    assert text.count('"missing":{}') == 1
    file = tmp_path / "missing.html"
    file.write_text(text.replace('"missing":{}', f'"missing":{json.dumps(missing)}'), "utf-8")
    opened(browser, file)
    choice = "document.getElementById('controller-pid')"
    grey = (
        f"[{choice}.disabled, {choice}.nextElementSibling.title, panel.textContent.includes('Zig')]"
    )
    assert browser.evaluate(grey) == [True, "not on this page", False]
