import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from kneexo.parameters import LINKAGES, Scenario
from kneexo.view.legs import Leg, leg_of_scenario
from kneexo.view.page import FRAMES_PER_S, MOST_FRAMES, MOST_LEGS, shown_s, view_page

SHORT = {"simulation": {"duration_s": 0.5}}


def scenario_of(**fields):
    return Scenario.model_validate(SHORT | fields)


def data_of(page, name):
    text = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page)[1]
    return json.loads(text)


def runs_of(page):
    return [
        {name: np.frombuffer(base64.b64decode(text), dtype="<f4") for name, text in run.items()}
        for run in data_of(page, "runs")
    ]


def a_leg(name, time, link=LINKAGES["G1"]):
    angle, reference = 0.7 + 0.4 * np.sin(time), 0.6 + 0.5 * np.cos(time)
    return Leg(name, link, time, angle, reference, 1e6 * np.sin(time), 2e6)


def test_a_page_tells_its_runs_in_safe_html():
    page = view_page([a_leg("</script><b>mine</b>", np.linspace(0.0, 1.0, 11))])
    assert "<title>kneexo: &lt;/script&gt;&lt;b&gt;mine" in page
    assert "<b>mine" not in page
    (leg,) = data_of(page, "legs")
    assert leg["name"] == "</script><b>mine</b>"
    assert leg["rating_pa"] == 2e6
    assert len(page) < 1e6


def test_a_page_holds_recorded_samples_as_they_are():
    time = np.linspace(0.0, 2.0, 1001)
    leg = a_leg("mine", time)
    (run,) = runs_of(view_page([leg]))
    np.testing.assert_array_equal(run["time"], time[::5].astype(np.float32))
    np.testing.assert_array_equal(run["angle"], leg.knee_angle_rad[::5].astype(np.float32))
    np.testing.assert_array_equal(run["reference"], leg.reference_rad[::5].astype(np.float32))
    np.testing.assert_array_equal(run["pressure"], leg.pressure_pa[::5].astype(np.float32))


def test_few_or_uneven_samples_are_all_there_and_the_last_one_always():
    for time in (np.array([0.0]), np.array([0.3, 0.5, 1.7]), np.linspace(0.0, 0.0172, 87)):
        (run,) = runs_of(view_page([a_leg("mine", time)]))
        assert run["time"][-1] == np.float32(time[-1])
        if len(time) < 5:
            np.testing.assert_array_equal(run["time"], time.astype(np.float32))


def test_angles_beyond_the_range_of_motion_are_in_the_tables():
    time = np.linspace(0.0, 1.0, 11)
    leg = Leg("x", LINKAGES["G1"], time, -0.03 + 0.0 * time, 1.6 + 0.0 * time, time)
    (data,) = data_of(view_page([leg]), "legs")
    assert data["low_rad"] == -0.03
    assert data["high_rad"] == 1.6


def test_a_page_holds_the_angle_and_the_torque_of_a_wearer():
    time = np.linspace(0.0, 1.0, 101)
    angle = 1.0 - time
    leg = Leg("x", LINKAGES["G1"], time, angle, angle, time, 2e6, angle - 0.05, 30.0 * time)
    page = view_page([leg])
    (run,), (data,) = runs_of(page), data_of(page, "legs")
    np.testing.assert_array_equal(run["wearer"], leg.wearer_rad.astype(np.float32))
    np.testing.assert_array_equal(run["torque"], leg.torque_n_m.astype(np.float32))
    assert data["low_rad"] == -0.05
    far = Leg("x", LINKAGES["G1"], time, angle, angle, time, 2e6, angle - 3.0, time)
    (data,) = data_of(view_page([far]), "legs")
    assert data["low_rad"] == -0.1  # where the linkage still has a pose
    assert "torque" not in runs_of(view_page([a_leg("free", time)]))[0]


def test_a_leg_has_the_rating_of_its_scenario():
    scenario = scenario_of(plant={"cylinder": {"pressure_rating_pa": 5e6}})
    leg, failure = leg_of_scenario("mine", scenario)
    assert (leg.pressure_rating_pa, failure) == (5e6, "")


@pytest.mark.slow
def test_a_page_tells_where_it_ends_and_stays_small():
    time = np.linspace(0.0, 2000.0, 200_001)
    legs = [a_leg("a", time), a_leg("b", time)]
    assert shown_s(legs[:1]) == 2000.0
    assert shown_s(legs) == MOST_FRAMES / FRAMES_PER_S / 2 == 1500.0
    page = view_page(legs)
    assert "the first 1500 of 2000 s" in page
    assert [run["time"][-1] for run in runs_of(page)] == [1500.0, 1500.0]
    assert 6e6 < len(page) < 8e6
    assert "the first" not in view_page([a_leg("c", time[:101])])
    worn = replace(a_leg("w", 2.0 * time), wearer_rad=np.sin(time), torque_n_m=np.cos(time))
    assert shown_s([worn]) == 2000.0
    assert len(view_page([worn])) < 8e6
    assert len(view_page([a_leg("x", time[:10])] * MOST_LEGS)) < 2e6


# -------------------------------------------------------------------------------- browser


@pytest.mark.slow
@pytest.mark.parametrize(("size", "phone"), [((800, 600), False), ((390, 800), True)])
def test_a_page_plays_by_itself(size, phone, browser, tmp_path):
    leg, _ = leg_of_scenario("mine", scenario_of(simulation={"duration_s": 10.0}))
    page = tmp_path / "knee.html"
    page.write_text(view_page([leg, leg]), encoding="utf-8")
    browser.open(page, *size, phone=phone, motion=True)
    pictures = browser.views_of_playing()
    for picture in pictures:  # legs on white ground
        below = picture[picture.shape[0] // 4 :]  # the caption
        assert 0.005 < (below.min(axis=2) < 0.9).mean() < 0.5
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 0.1).sum() > 300
    browser.require_health()
    browser.require_width()
    assert browser.evaluate("document.title") == "kneexo: mine, mine"


@pytest.mark.slow
def test_faults_of_a_page_are_heard(browser, tmp_path):
    page = tmp_path / "page.html"
    for fault in (
        "<script>throw new Error('x')</script>",
        "<script>console.error('x')</script>",
        "<script>nothing()</script>",
        "<img src='missing.png'>",
        "<iframe srcdoc='<script>nothing()</script>'></iframe>",
    ):
        page.write_text(f"<!DOCTYPE html>{fault}")
        browser.open(page)
        with pytest.raises(AssertionError):
            browser.require_health()
    page.write_text("<!DOCTYPE html><p style='width: 900px'>wide</p>")
    browser.open(page, 390, 800, phone=True)
    browser.require_health()
    with pytest.raises(AssertionError):
        browser.require_width()
