"""The page with protection: a fault that is thrown there, and the same fault in kneexo."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from web_cases import check_words, typed

from kneexo.analysis import track
from kneexo.page.playground import playground_page
from kneexo.page.thrown_faults import RESET, THROWN_FAULTS
from kneexo.parameters import Scenario
from kneexo.parameters.device.safety_states import REASONS, SAFE_STATES, STATES, TRANSITIONS
from kneexo.parameters.scenario_file import load_scenario

pytestmark = pytest.mark.slow

DURATION_S = 12.0
START_S = 2.5
LATE_S = 1.01 * Scenario.preset("protected").controller.sample_time_s
COLUMNS = {
    "angle": "knee_angle_rad",
    "command": "motor_speed_command_rad_s",
    "pressure": "load_pressure_pa",
}


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    scenario = Scenario.preset("protected").changed({"simulation.duration_s": DURATION_S})
    file = tmp_path_factory.mktemp("protected") / "faults.html"
    file.write_text(playground_page([scenario], ["protected"]), encoding="utf-8")
    return file


class _Page:
    """The page in Chromium, opened with a link."""

    def __init__(self, browser, file, link="", **options):
        self.browser, self.file, self.evaluate = browser, file, browser.evaluate
        browser.open(file, **{"width": 1440, "height": 900} | options)
        self.count = 0
        self.go(link)

    def go(self, link):
        """Open the page with the values of a link."""
        self.browser.requests = []
        self.count += 1  # an address that differs in its fragment alone would load nothing
        self.browser.load(url=f"{self.file.as_uri()}?{self.count}#{link}")
        self.wait()

    def wait(self, index=0):
        self.browser.wait_for(f"Page.results[{index}].fresh")
        self.evaluate("new Promise(requestAnimationFrame).then(() => 0)")

    def run(self, index=0):
        """Time, columns and metrics of the shown run."""
        return self.evaluate(
            f"""(({{ time, columns, metrics, end }}) => ({{ time: Array.from(time), metrics, end,
            columns: Object.fromEntries(Object.entries(columns).map(([n, c]) => [n, Array.from(c)]))
            }}))(Page.results[{index}].run)"""
        )

    def yaml(self, index=0):
        return self.evaluate(f"Setups.yamlOf(Page.data, Page.state.setups[{index}])")

    def text(self, name):
        return self.evaluate(f"document.getElementById({json.dumps(name)}).textContent")

    def card(self, name):
        """Number and words of a card."""
        return self.evaluate(
            f"""[".value .number", ".word"].map((part) =>
            document.querySelector(`[data-number={name}] ${{part}}`).textContent)"""
        )


def in_kneexo(page, folder, index=0):
    """The run that ``kneexo simulate`` makes of the YAML of the page."""
    file = folder / "page.yaml"
    file.write_text(page.yaml(index), encoding="utf-8")
    return load_scenario(file), track(load_scenario(file), all_signals=True)


def check_run(shown, result):
    """Compare the curves; returns whether all states of the protection are equal too.

    WebAssembly and machine code round the functions of their libraries differently. A detector
    whose level crosses its threshold at a sample can act a sample later there. Then the curves are
    compared until that sample.
    """
    run = result.run
    np.testing.assert_array_equal(shown["time"], run.time_s)
    same = run.time_s.size
    for name in STATE_COLUMNS if result.scenario.protection else {}:
        there, here = np.array(shown["columns"][name]), run[STATE_COLUMNS[name]]
        changes, expected = (np.flatnonzero(np.diff(values)) for values in (there, here))
        np.testing.assert_array_equal(there[changes + 1], here[expected + 1], err_msg=name)
        assert np.abs(changes - expected).max(initial=0) <= 1, name
        same = min([same, *np.flatnonzero(there != here)])
    for name, column in COLUMNS.items():
        size = np.abs(run[column]).max()
        there, here = shown["columns"][name][:same], run[column][:same]
        np.testing.assert_allclose(there, here, rtol=0, atol=1e-6 * size)
    return same == run.time_s.size


STATE_COLUMNS = {"state": "safety_state", "reason": "safety_reason"}


@pytest.mark.parametrize("late", [1, 2])
def test_a_state_may_change_a_sample_late_but_no_more(late):
    state, moved = (np.repeat([0, 1], [count, 100 - count]) for count in (50, 50 + late))
    names = ["time_s", *COLUMNS.values(), *STATE_COLUMNS.values()]
    run = np.rec.fromarrays([state for _ in names], names=names)
    shown = {"time": state, "columns": dict.fromkeys([*COLUMNS, *STATE_COLUMNS], moved)}
    result = SimpleNamespace(run=run, scenario=SimpleNamespace(protection=True))
    if late == 1:
        assert not check_run(shown, result)
    else:
        with pytest.raises(AssertionError, match="state"):
            check_run(shown, result)


CASES = [
    *(f"a.fault={name}" for name in THROWN_FAULTS if name != RESET),
    "a.fault=encoder_jump&a.fault.encoder_jump.size=0.5&a.fault.duration_s=0.3",
    "a.fault=command_frozen&a.controller=pid&a.fault.duration_s=0.1",
    "a.fault=motor_weak&a.fault.motor_weak.size=0.5&a.fault.start_s=4",
    # At 8 V a relative change of 1e-15 of the mass moves the knee by 4e-5 rad.
    "a.fault=supply_sag&a.fault.supply_sag.size=16&a.protection=off",
    "a.fault=encoder_frozen&a.protection=off&a.fault.duration_s=0.2",
    "a.fault=emergency_stop&a.fault.duration_s=1&a.fault.reset_s=10.4&a.protection.following_deg=2",
    "a.fault=piston_leak&a.plant.cylinder.leakage_m3_per_s_pa=1e-12&a.plant.pump.gear_ratio=4",
    "a.protection.speed_rpm=30",
]
"""Links: each fault, other sizes and times, without protection, a reset, and a false alarm."""


@pytest.mark.slow(gate=7)
@pytest.mark.parametrize("link", CASES)
def test_a_fault_does_on_the_page_what_it_does_in_kneexo(browser, page_file, tmp_path, link):
    if "start_s" not in link and "fault=" in link:
        link += f"&a.fault.start_s={START_S}"
    page = _Page(browser, page_file, link)
    assert page.text("notice") == ""
    scenario, result = in_kneexo(page, tmp_path)
    assert [fault.place == "reset" for fault in scenario.faults].count(False) == ("fault=" in link)
    assert (scenario.protection is None) == ("protection=off" in link)
    shown, run = page.run(), result.run
    equal = check_run(shown, result)
    if scenario.protection is None:
        assert page.card("detected")[1] == "no protection"
        return
    stop = shown["metrics"]["protection"]["stop"]
    samples = np.flatnonzero(run["safety_reason"])
    if not samples.size:
        assert stop is None
        return
    stop_s = run.time_s[samples[0] - 1]
    assert abs(stop["time_s"] - stop_s) <= LATE_S
    reason = REASONS[int(run["safety_reason"][samples[0]])]
    assert (result.verdict.stop.time_s, result.verdict.stop.reason) == (stop_s, reason)
    # A motor that stops a sample late changes the peaks by less than a percent.
    rel = 1e-6 if equal else 1e-2
    check_peaks(shown["metrics"]["protection"], result.verdict.stop, run, rel)
    number, words = page.card("detected")
    time_s = float(f"{stop['time_s']:.5g}")
    assert words.endswith(f"by {reason} at {time_s:.10g} s")
    if scenario.faults:
        after_ms = 1e3 * (stop["time_s"] - scenario.faults[0].start_s)
        assert float(number) == pytest.approx(after_ms, rel=1e-3, abs=1e-6)
    else:
        assert words.startswith("false alarm")
    states = np.array(shown["columns"]["state"])
    changes = np.flatnonzero(np.diff(states))
    rows = page.evaluate("[...document.querySelectorAll('#safety li')].map((li) => li.textContent)")
    names = list(STATES)
    assert [row.split(" (")[0] for row in rows] == [
        f"{round(run.time_s[k], 4):.10g} s {names[int(states[k + 1])]}" for k in changes
    ]


def check_peaks(metrics, stop, run, rel):
    """Error, turn and torque until the motor is safe."""
    part = slice(*np.searchsorted(run.time_s, [stop.fault_s - 1e-9, stop.safe_s + LATE_S]))
    error = np.abs(run["knee_reference_rad"] - run["knee_angle_rad"])[part]
    expected = error.max(), np.radians(stop.turn_deg), stop.torque_n_m
    for name, value in zip(("largest_error_rad", "turn_rad", "torque_n_m"), expected, strict=True):
        assert metrics[name] == pytest.approx(value, rel=rel), name
    safe_s = None if np.isnan(stop.safe_s) else stop.safe_s
    assert metrics["safe_time_s"] == pytest.approx(safe_s, rel=0.0, abs=LATE_S)


def test_further_curves_are_chosen_and_are_those_of_kneexo(browser, page_file, tmp_path):
    link = "a.simulation.duration_s=3&curves=angle+kneeTorque+cap+rodSide+current+gone"
    page = _Page(browser, page_file, link)
    shown = """[...document.querySelectorAll("#plots .plot")].filter((one) => !one.hidden)
      .map((one) => one.dataset.plot)"""
    names = ["angle", "kneeTorque", "cap", "rodSide", "current"]
    assert page.evaluate(shown) == names
    assert page.text("notice").startswith("One value of the link does not fit")
    _, result = in_kneexo(page, tmp_path)
    run = result.run
    torque = -run["rod_force_n"] * run["moment_arm_m"]
    expected = {"kneeTorque": torque, "cap": 1e-5 * run["cap_pressure_pa"]}
    expected |= {"rodSide": 1e-5 * run["rod_side_pressure_pa"], "current": run["motor_current_a"]}
    plots = "Page.parts.plots.plots.find(({ name }) => name === '%s')"
    for name, column in expected.items():
        curve = page.evaluate(f"Array.from({plots % name}.data[1])")
        np.testing.assert_allclose(curve, column, rtol=0, atol=1e-6 * np.abs(column).max())
    full, cylinder = result.scenario.plant.full_order, result.scenario.plant.cylinder
    limits = [1e-5 * full.relief_pressure_pa, 1e-5 * cylinder.pressure_rating_pa]
    assert page.evaluate(f"{plots % 'cap'}.data.slice(3, 5).map((line) => line[0])") == limits
    page.evaluate("document.querySelector('#choose-curves [value=cap]').click()")
    browser.wait_for("location.hash.includes('curves=angle+kneeTorque+rodSide+current')")
    assert page.evaluate(shown) == ["angle", "kneeTorque", "rodSide", "current"]
    offered = """[...document.querySelectorAll("#choose-curves label")]
      .filter((one) => !one.hidden).map((one) => one.firstChild.value)"""
    assert "torque" not in page.evaluate(offered)  # no wearer
    assert "winding" not in page.evaluate(offered)  # no temperatures


def test_the_diagram_is_the_table_and_the_present_state_is_lit(browser, page_file):
    page = _Page(browser, page_file, "a.fault=emergency_stop")
    edges = page.evaluate(
        "[...Page.parts.safety.edges].map(([key, edge]) => [key, edge.querySelector('text')"
        ".textContent.split(/, ?/).map((word) => word.trim())])"
    )
    drawn = {(*key.split(), event) for key, events in edges for event in events}
    kept = [row for row in TRANSITIONS if row.release is not False and row.state != "stopped"]
    assert drawn == {(row.state, row.next_state, row.event) for row in kept}
    lit = "[...document.querySelectorAll('#safety .state.lit text')].map((e) => e.textContent)"
    stop = page.run()["metrics"]["protection"]
    assert page.card("safe")[1] == SAFE_STATES["dynamic_brake"]
    log = page.evaluate("[...document.querySelectorAll('#safety li')].map((e) => e.textContent)")
    events = [line.split(" (")[1].rstrip(")") for line in log]
    assert events == ["healthy", "emergency", "standstill"]
    for time_s, state in (
        (0.05, "starting"),
        (1.0, "operating"),
        (stop["stop"]["time_s"] + 0.01, "stopping"),
        (stop["safe_time_s"] + 0.01, "released"),
    ):
        page.evaluate(f"(Page.parts.stage.pause(), Page.parts.stage.seek({time_s}), 0)")
        page.browser.wait_for(f"{lit}.join() === '{state}'")
        now = page.evaluate("document.querySelector('#safety .now').textContent")
        meaning = STATES[state].split("; the windings")[0]
        assert now.removeprefix(f"{state} – {meaning}") in ("", "; the windings are shorted")
        assert ("shorted" in now) == (state == "released")
    assert "bypass" not in page.text("safety")  # the safe state is the dynamic brake
    bold = "[...document.querySelectorAll('#safety .event.lit')].map((e) => e.textContent)"
    assert page.evaluate(bold) == ["standstill"]
    browser.require_health()


def test_the_address_keeps_the_fault_and_wrong_values_are_one_line_each(browser, page_file):
    page = _Page(browser, page_file)
    cards = "[...document.querySelectorAll('.card')].filter((c) => !c.hidden)"
    assert not page.evaluate(f"{cards}.some((c) => c.dataset.number === 'detected')")
    page.evaluate("document.getElementById('fault-encoder_jump').click()")
    page.wait()
    page.evaluate("(Page.parts.stage.pause(), Page.parts.stage.seek(4), 0)")
    page.browser.wait_for("Page.parts.plots.time === 4")
    page.evaluate("document.getElementById('throw-now').click()")
    page.wait()
    page.browser.wait_for("location.hash.includes('a.fault.start_s=4')")
    link = page.evaluate("location.hash.slice(1)")
    assert "a.fault=encoder_jump" in link
    before = page.yaml()
    page.go(link)
    assert page.yaml() == before
    assert page.text("notice") == ""
    late = "Choose an earlier time, or extend the run. The curves show the previous run."
    page.evaluate(typed("fault.start_s", 20))
    assert page.text("notice") == f"The fault begins at 20 s, but the run lasts 12 s. {late}"
    page.evaluate(typed("fault.start_s", 4))
    page.evaluate(typed("fault.duration_s", 9))
    assert page.text("notice") == f"The fault ends at 13 s, but the run lasts 12 s. {late}"
    page.evaluate(typed("fault.duration_s", 0))
    page.evaluate(typed("fault.reset_s", 30))
    assert page.text("notice") == f"The reset is pressed at 30 s, but the run lasts 12 s. {late}"
    page.evaluate(typed("fault.reset_s", 0))
    page.evaluate(typed("fault.start_s", 20))
    stale = "document.body.classList.contains('stale')"
    assert page.evaluate(stale)
    before = page.evaluate("[Page.parts.stage.duration, Page.parts.legs, Page.parts.drawn.length]")
    page.evaluate("document.getElementById('compare').click()")
    page.evaluate("new Promise(requestAnimationFrame).then(() => 0)")
    reason = f"The fault begins at 20 s, but the run lasts 12 s. {late}"
    assert page.text("notice") == f"Set-up A: {reason} Set-up B: {reason}"
    after = page.evaluate("[Page.parts.stage.duration, Page.parts.legs, Page.parts.drawn.length]")
    assert after == before  # nothing new can be drawn
    page.evaluate("document.getElementById('compare').click()")
    page.evaluate(typed("fault.start_s", 4))
    page.wait()
    assert not page.evaluate(stale)
    page.evaluate("document.getElementById('fault-emergency_stop').click()")
    off, stop = (
        f"((i) => [i.disabled, i.nextSibling.title])(document.getElementById('{name}'))"
        for name in ("protection-off", "fault-emergency_stop")
    )
    words = "The emergency stop acts through the protection. %s first."
    assert page.evaluate(off) == [True, words % "Choose another fault"]
    assert page.evaluate(stop) == [False, ""]
    page.evaluate("document.getElementById('fault-none').click()")
    page.evaluate("document.getElementById('protection-off').click()")
    assert page.evaluate(stop) == [True, words % "Turn the protection on"]
    gear = "a.plant.pump.gear_ratio=5"
    for link, fault in (
        (f"a.fault=meteorite&{gear}", "none"),
        (f"a.fault=encoder_frozen&a.fault.start_s=40&{gear}", "encoder_frozen"),
        (f"a.fault=emergency_stop&a.protection=off&{gear}", "none"),
    ):
        page.go(link)
        assert "One value of the link does not fit this page" in page.text("notice")
        assert page.evaluate("Page.state.setups[0].fault") == fault
        values = page.evaluate("Setups.valuesOf(Page.data, Page.state.setups[0])")
        assert values["plant.pump.gear_ratio"] == 5.0
        assert values.get("fault.start_s", 3.0) == 3.0
    browser.require_health()


SHOWN_CARDS = "[...document.querySelectorAll('.card')].filter((c) => !c.hidden)"


def test_a_and_b_show_a_fault_with_and_without_protection(browser, page_file, tmp_path):
    link = (
        "a.fault=encoder_frozen&b.fault=encoder_frozen&b.protection=off&b.controller=smc&compare=1"
    )
    for options in ({}, {"width": 390, "height": 844, "phone": True}):
        page = _Page(browser, page_file, link, **options)
        page.wait(1)
        for index in (0, 1):
            check_run(page.run(index), in_kneexo(page, tmp_path, index)[1])
        assert page.text("key").startswith("A: sliding modeB: sliding mode, no protection")
        # The unprotected knee shows its worst: the window has the largest error and torque of B.
        low, high = page.evaluate("Page.parts.plots.range")
        run = in_kneexo(page, tmp_path, 1)[1].run
        for values in (
            run["knee_reference_rad"] - run["knee_angle_rad"],
            run["rod_force_n"] * run["moment_arm_m"],
        ):
            since = run.time_s >= START_S
            assert low < run.time_s[since][np.abs(values[since]).argmax()] <= high
        cards = page.evaluate(f"{SHOWN_CARDS}.map((c) => c.dataset.number)")
        assert cards == [
            *("detected", "safe", "fault-error", "fault-torque", "pressure", "saturated", "linear")
        ]
        # A number of the loop without the fault has no mark.
        kind = "document.querySelector('[data-number=linear] .word').dataset.kind"
        assert page.evaluate(kind) == "plain"
        lines = [in_kneexo(page, tmp_path, index)[1].verdict.lines[0] for index in (0, 1)]
        check_words(page.text("sentence"), "A: {}B: {}".format(*lines))
        share = in_kneexo(page, tmp_path, 1)[1].verdict.saturated_share
        number = page.evaluate(
            "document.querySelectorAll('[data-number=saturated] .number')[1].textContent"
        )
        assert float(number) == pytest.approx(100.0 * share, rel=5e-3)
        browser.require_health()
        browser.require_width()


def test_margins_and_bandwidth_are_those_without_protection(browser, page_file):
    page = _Page(browser, page_file)
    found = []
    for link in ("", "a.fault=command_weak&a.fault.start_s=0.5&a.protection.speed_rpm=30"):
        page.go(link)
        browser.wait_for("Page.results[0].linear && Page.results[0].sweep")
        found.append(
            page.evaluate(
                "[Page.results[0].linear.phase_margin_deg, Page.results[0].sweep.minus_3_db_hz]"
            )
        )
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_a_scenario_with_a_fault_of_the_page_opens_with_it(browser, page_file, tmp_path):
    page = _Page(browser, page_file, "a.fault=encoder_jump&a.fault.reset_s=9&a.protection=off")
    page.evaluate("document.getElementById('protection-on').click()")
    page.wait()
    scenario, _ = in_kneexo(page, tmp_path)
    file = tmp_path / "again.html"
    file.write_text(playground_page([scenario], ["again"]), encoding="utf-8")
    again = _Page(browser, file)
    (tmp_path / "again.yaml").write_text(again.yaml(), encoding="utf-8")
    assert load_scenario(tmp_path / "again.yaml") == scenario


@pytest.mark.slow(gate=0)
def test_a_scenario_without_protection_stands_beside_one_with_it(browser, tmp_path):
    """The switch of the fault belongs to the scenario that has protection."""
    scenarios = [
        Scenario.preset(name).changed({"simulation.duration_s": 4.0})
        for name in ("leg", "protected")
    ]
    file = tmp_path / "two.html"
    file.write_text(playground_page(scenarios, ["leg", "protected"]), encoding="utf-8")
    page = _Page(browser, file, "b.fault=command_weak&b.fault.start_s=1")
    page.wait(1)
    check_run(page.run(1), in_kneexo(page, tmp_path, 1)[1])
    fault = "Boolean(document.getElementById('fault-none'))"
    assert not page.evaluate(fault)
    page.evaluate("document.getElementById('set-up-b').click()")
    assert page.evaluate(fault)
    page.evaluate("document.getElementById('scenario-0').click()")
    page.wait(1)
    assert not page.evaluate(fault)
    assert page.evaluate("document.getElementById('safety').hidden")
    assert "faults" not in page.yaml(1)
    page.evaluate("document.getElementById('scenario-1').click()")
    page.wait(1)
    assert page.evaluate("Page.state.setups[1].fault") == "none"
    assert not page.evaluate("document.getElementById('safety').hidden")
    browser.require_health()
