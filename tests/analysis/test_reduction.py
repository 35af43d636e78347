"""Full against reduced order: speeds, modes, bandwidth and the switching force."""

import json
import math

import numpy as np
import pytest
from matplotlib import pyplot as plt

from kneexo.analysis.checkpoint import Checkpoint
from kneexo.analysis.error_model import error_model
from kneexo.analysis.reduction import (
    OrderComparison,
    compare_orders,
    frequency_row,
    in_order,
    speed_row,
    switching_row,
    tracking_row,
)
from kneexo.errors import ParameterError
from kneexo.output import to_json
from kneexo.parameters import (
    UNCERTAIN_KNEE,
    KneeLoadParameters,
    OrderComparisonParameters,
    RampReference,
    Scenario,
)
from kneexo.scenario import changed

# Lee et al. 2020, Tables 2 and 3: bore 20 mm, rod 10 mm, 0.8 cm³/rev behind a gear of 6:1.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
MEAN_AREA = 0.5 * (AREA_1 + AREA_2)
FLOW = 0.8e-6 * 5000.0 / 60.0 / 6.0
TABLE_1 = (1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0)
DRAKE = {"simulation.integrator": "radau3"}
TIGHT = {"plant.pump.internal_leakage_m3_per_s_pa": 0.0}
SETTINGS = OrderComparisonParameters()


# --------------------------------------------------------------------------------- pieces


def test_in_order_changes_order_and_load_alone():
    full = in_order(UNCERTAIN_KNEE, "full", 60.0)
    assert full.plant.full_order is not None
    assert full.plant.load == KneeLoadParameters(disturbance_n=60.0)
    assert in_order(full, "reduced", -60.0) == UNCERTAIN_KNEE
    own = changed(Scenario(), {"plant.full_order": {"coulomb_friction_n": 5.0}})
    assert in_order(own, "full").plant.full_order.coulomb_friction_n == 5.0
    # Without a load there is none but the disturbance.
    assert in_order(Scenario(), "full", 7.0).plant.load == KneeLoadParameters(
        segment_mass_kg=0.0, disturbance_n=7.0
    )


@pytest.mark.parametrize("flexing", [True, False], ids=["in", "out"])
@pytest.mark.parametrize(
    ("order", "force", "area", "printed"),
    [
        ("full", 60.0, AREA_1, 35.4),
        ("full", -60.0, AREA_2, 47.2),
        ("reduced", 60.0, MEAN_AREA, 40.4),
    ],
)
def test_speed_at_the_limit_follows_the_loaded_chamber(order, force, area, printed, flexing):
    found = speed_row(changed(UNCERTAIN_KNEE, DRAKE | TIGHT), SETTINGS, (order, force, flexing))
    assert found["saturated_share"] == 1.0
    assert found["rod_speed_mm_s"] == pytest.approx(1e3 * FLOW / area, rel=1e-3)
    assert found["rod_speed_mm_s"] == pytest.approx(printed, abs=0.1)


@pytest.mark.parametrize("posture", [10.0, 40.0, 70.0])
def test_modes_are_those_of_one_chamber_with_its_make_up_valve_or_of_both(posture):
    reduced = frequency_row(UNCERTAIN_KNEE, ("reduced", 60.0, posture))
    assert reduced["mode_hz"] == pytest.approx(447.0, abs=0.5)
    assert reduced["mode_damping"] == pytest.approx(0.0059, abs=1e-4)
    full = frequency_row(UNCERTAIN_KNEE, ("full", 60.0, posture))
    x = 1e-3 * np.polyval(TABLE_1, posture)  # G1 follows it to 0.1 mm here
    stiffness = [
        1.72e9 * area**2 / volume
        for area, volume in (
            (AREA_1, 5e-6 + AREA_1 * x),
            (AREA_2, 5e-6 + AREA_2 * (0.150 - x)),
        )
    ]
    # The tied line relaxes through its valve, 2e-10 m³/(s·Pa).
    cubic = np.polymul([1.6, 0.05, stiffness[0]], [1.0, 2e-10 * stiffness[1] / AREA_2**2])
    cubic[2] += stiffness[1]
    roots = np.roots(cubic)
    mode = roots[np.argmax(roots.imag)]
    assert full["mode_hz"] == pytest.approx(abs(mode) / (2.0 * math.pi), rel=0.01)
    # What the pump's leakage adds is 0.006 in the reduced order.
    assert full["mode_damping"] == pytest.approx(-mode.real / abs(mode), abs=0.006)
    assert full["mode_damping"] > 6.0 * reduced["mode_damping"]


def test_margins_fall_with_the_rod_side_loaded_and_grow_with_the_cap_side():
    margins = {
        case: frequency_row(UNCERTAIN_KNEE, (*case, 40.0))["phase_margin_deg"]
        for case in (("reduced", 60.0), ("full", 60.0), ("full", -60.0))
    }
    low, middle, high = sorted(margins.values())
    assert margins["full", -60.0] == low
    assert margins["full", 60.0] == high
    assert (low, middle, high) == pytest.approx((51.1, 57.1, 61.5), abs=0.2)  # as measured


def test_no_linear_loop_is_said_in_words():
    signum = changed(UNCERTAIN_KNEE, {"controller.switching": "signum"})
    found = frequency_row(signum, ("full", 60.0, 40.0))
    assert "there is no linear" in found["failure"]
    assert math.isnan(found["phase_margin_deg"])
    assert found["mode_hz"] == pytest.approx(280.0, abs=1.0)  # the plant has its mode all the same


def test_tracking_row_has_the_pressures_of_its_order():
    brief = changed(UNCERTAIN_KNEE, DRAKE | {"simulation.duration_s": 1.0})
    full, reduced = (tracking_row(brief, (order, 60.0)) for order in ("full", "reduced"))
    assert set(full["trace"]["pressures_mpa"]) == {"cap", "rod_side"}
    assert set(reduced["trace"]["pressures_mpa"]) == {"load_pressure"}
    # 60 N and the weight's −8…−9 N at 10…16 deg, on P_1 against the reservoir's 0.2 MPa.
    for force, value in ((51.6, full["cap_max_mpa"]), (50.0, full["cap_min_mpa"])):
        expected = 1e-6 * (force + 0.2e6 * AREA_2) / AREA_1
        assert value == pytest.approx(expected, rel=0.03)
    assert full["rod_side_max_mpa"] == pytest.approx(0.2, abs=0.02)
    assert full["relief_share"] == 0.0
    assert reduced["load_pressure_max_mpa"] == pytest.approx(51.6e-6 / MEAN_AREA, rel=0.03)


# ------------------------------------------------------------------------ the comparison


@pytest.fixture(scope="module")
def comparison(tmp_path_factory):
    settings = OrderComparisonParameters(postures_deg=(40.0,), switching_forces_n=(6.0, 16.0, 30.0))
    path = tmp_path_factory.mktemp("orders") / "checkpoint"
    found = compare_orders(UNCERTAIN_KNEE, settings, checkpoint=Checkpoint(path))
    return found, path


def rows(part, **labels):
    return [row for row in part if all(row[k] == v for k, v in labels.items())]


@pytest.mark.slow
def test_tracking_error_of_the_full_order_is_that_of_its_area(comparison):
    found, _ = comparison
    full = changed(Scenario(), {"plant.full_order": {}})
    # θ̇ of 30 deg at 0.1 Hz, times the lag of 28.6 ms, rms: 0.381 deg; leakage and encoder add.
    lag = abs(error_model(full, loaded_chamber="cap").error_m(1.0, 0.0))
    expected = 30.0 * 2.0 * math.pi * 0.1 * lag / math.sqrt(2.0)
    for row in rows(found.tracking, order="full"):
        assert row["rms_error_deg"] == pytest.approx(expected, rel=0.03)
    for row in rows(found.tracking, order="reduced"):
        assert row["rms_error_deg"] < 0.05


@pytest.mark.slow
def test_bandwidth_follows_the_loaded_chamber(comparison):
    found, _ = comparison
    by_case = {(r["order"], r["disturbance_n"]): r["bandwidth_hz"] for r in found.bandwidth}
    # Kinematic follower at Q/A_1, Q/Ā and Q/A_2: 0.196, 0.2247 and 0.262 Hz.
    assert by_case["full", 60.0] == pytest.approx(0.196, abs=0.003)
    assert by_case["full", -60.0] == pytest.approx(0.262, abs=0.003)
    assert by_case["full", 0.0] == pytest.approx(0.262, abs=0.003)  # the weight loads P_2
    for force in (0.0, 60.0, -60.0):
        assert by_case["reduced", force] == pytest.approx(0.2236, abs=0.002)


@pytest.mark.slow
def test_rod_oscillates_near_the_switching_force_in_retraction_alone(comparison):
    found, _ = comparison
    assert found.oscillating_n("in") == [16.0]
    assert found.oscillating_n("out") == []
    inside = rows(found.switching, direction="in", force_n=16.0)[0]
    outside = rows(found.switching, direction="in", force_n=6.0)[0]
    # Halving rk4's step changes the swing by less than 2 %.
    assert inside["velocity_swing_mm_s"] > 20.0 * outside["velocity_swing_mm_s"]
    assert inside["velocity_swing_mm_s"] == pytest.approx(99.0, rel=0.05)
    assert inside["max_error_deg"] < outside["max_error_deg"]


@pytest.mark.slow
def test_comparison_resumes_reports_and_draws(comparison):
    found, path = comparison
    assert isinstance(found, OrderComparison)
    text = found.report()
    assert "oscillates at 16…16 N when it retracts" in text
    assert "the paper measured 0.21 Hz" in text
    results = json.loads(to_json(found.results()))
    assert len(results["speeds"]) == 8
    assert not any("trace" in row for part in results.values() for row in part)
    again = compare_orders(found.scenario, found.settings, checkpoint=Checkpoint(path, resume=True))
    assert again.report() == text
    figures = found.figures()
    assert set(figures) == {"order_tracking", "order_switching", "order_frequency"}
    assert all(axis.get_ylabel() for figure in figures.values() for axis in figure.axes)
    plt.close("all")


def test_a_comparison_without_forces_has_dashes_in_its_report():
    settings = OrderComparisonParameters(disturbances_n=(0.0,), switching_forces_n=(0.0,))
    empty = OrderComparison((), (), (), (), (), UNCERTAIN_KNEE, settings)
    assert "Rod speed at the limit in mm/s: reduced –, full –." in empty.report()


# ------------------------------------------------------------------------------ bad input


def test_a_ramp_too_short_to_measure_is_refused():
    narrow = changed(UNCERTAIN_KNEE, {"reference.amplitude_deg": 0.1})
    with pytest.raises(ParameterError, match=r"\Aswitching_rate_deg_s = .* must take > 0\.5 s\Z"):
        switching_row(narrow, SETTINGS, (15.0, True))


def test_reference_must_be_a_sine():
    with pytest.raises(ParameterError, match="needs a sine that moves"):
        compare_orders(Scenario(reference=RampReference()))
