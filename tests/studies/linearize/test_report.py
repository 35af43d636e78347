"""The report of a linearized loop: from the numbers to the cells of its tables."""

import math
import re
from dataclasses import replace

import pytest

from kneexo.analysis import linearize_loop, linearize_plant
from kneexo.analysis.tracking.verdict import loop_lines
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.studies.linearize.report import report
from kneexo.studies.markdown import number


@pytest.fixture(scope="module")
def linear():
    scenario = Scenario()
    return linearize_plant(scenario.plant), linearize_loop(scenario)


def linear_text(plant, loop):
    return report(plant, loop, loop_lines(loop), ["Left out: nothing."])


def test_margins_are_listed_once_with_criterion_and_verdict(linear, rows_of):
    plant, loop = linear
    text, m = linear_text(plant, loop), loop.margins()
    rows = rows_of(text)
    decibels = 20.0 * math.log10(m.gain_margin)
    frequency = f"{m.gain_margin_frequency_hz:.3g}"
    more = [f"factor {m.gain_margin:.3g} ({decibels:.3g} dB)", frequency]
    assert rows["more gain"] == [*more, "at least factor 1.67", "sound"]
    assert rows["phase lag"][0] == f"{m.phase_margin_deg:.3g}°"
    assert rows["phase lag"][2:] == ["at least 28.1°", "sound"]  # 2 atan(1/4)
    assert rows["phase lead"][0] == f"{number(m.phase_lead_margin_deg)}°"
    assert rows["gain and phase together (disk margin)"][0] == number(m.disk_margin)
    delay = f"{1e3 * m.delay_margin_s:.3g} ms ({int(m.delay_margin_s / 0.002)} samples)"
    assert rows["delay"][0] == delay
    assert rows["delay"][2:] == ["at least 2 ms", "sound"]
    assert rows["less gain"] == ["any factor", "–", "at most factor 0.6", "sound"]
    assert text.count(f"{m.phase_margin_deg:.3g}°") == 1
    assert "Stable at 40°; all margins are sound." in text


def test_a_small_margin_is_named_first(linear, monkeypatch, rows_of):
    plant, loop = linear
    margins = replace(loop.margins(), phase_margin_deg=28.0, lower_gain_margin=0.61)
    monkeypatch.setattr(type(loop), "margins", lambda _: margins)
    text = linear_text(plant, loop)
    assert text.splitlines()[2] == "- Stable at 40°; too small: phase lag, less gain."
    assert rows_of(text)["less gain"][-1] == "too small"


def test_poles_are_pairs_with_a_verdict(linear, rows_of):
    plant, loop = linear
    rows = rows_of(linear_text(plant, loop))
    assert rows["0"] == ["0", "1", "integrates"]
    assert rows["-100"] == [f"{100 / (2 * math.pi):.3g}", "1", "decays"]  # the motor's 10 ms
    (pair,) = (name for name in rows if "±" in name)
    real, imaginary = map(float, re.fullmatch(r"(\S+) ± (\S+)j", pair).groups())
    assert float(rows[pair][0]) == pytest.approx(math.hypot(real, imaginary) / 6.2832, rel=0.01)
    assert rows[pair][2] == "decays"
    assert len([name for name in rows if name[-1:] in "0123456789j"]) == 3


def test_sentences_have_the_equilibrium_and_the_largest_eigenvalue():
    scenario = Scenario.preset("bench")
    plant = linearize_plant(scenario.plant, knee_angle_deg=30.0)
    loop = linearize_loop(scenario, knee_angle_deg=30.0)
    text, point = linear_text(plant, loop), plant.operating_point
    rpm, mpa = point.motor_speed_rad_s * 30.0 / math.pi, 1e-6 * point.load_pressure_pa
    assert (
        f"In equilibrium at 30° the motor turns at {rpm:.3g} rpm, the load pressure is "
        f"{mpa:.3g} MPa, and the rod force is {point.rod_force_n:.3g} N." in text
    )
    assert f"turns by {plant.velocity_gain:.3g} rad for each rad" in text
    assert f"The largest eigenvalue is {max(abs(loop.eigenvalues)):.6g}, and must" in text


def test_an_unstable_loop_has_no_margins():
    scenario = changed(Scenario(), {"controller.phi_m_s2": 0.1})
    loop = linearize_loop(scenario)
    assert not loop.stable
    text = linear_text(linearize_plant(scenario.plant), loop)
    assert "not stable, so there are no margins" in text
    assert "phase lag" not in text
    assert text.splitlines()[2].startswith("- Not stable at 40°")
