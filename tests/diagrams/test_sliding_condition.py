"""The sliding condition s·ds/dt ≤ −η|s| in runs of the closed loop: docs/sliding_condition.md.

Between two samples outside the boundary layer, the condition lets |s| fall by η times the interval.
"""

import math

import numpy as np
import pytest

from kneexo.errors import SimulationError
from kneexo.parameters import Scenario
from kneexo.simulation import simulate

PHI, ETA = 3.2, 1e3
IDEAL = Scenario().changed(
    {
        "plant.load": {"kind": "knee", "segment_mass_kg": 0.0},
        "plant.rod_map": "polynomial",
        "plant.ideal_motor": True,
        "encoder.quantized": False,
        "estimator": {"kind": "exact"},
        "controller.continuous": True,
        "controller.sample_time_s": 2e-4,
        "controller.load_rate_uncertainty_n_per_s": 2.5e3,
        "controller.command_limit_rad_s": 1e12,
        "simulation.duration_s": 10.0,
    }
)
"""The law as the paper assumes it: continuous, exact states, a motor without lag and limit."""

# Lee et al. 2020, Tables 2 and 3.
AREA_1, AREA_2 = math.pi / 4.0 * 0.020**2, math.pi / 4.0 * (0.020**2 - 0.010**2)
MEAN_AREA = 0.5 * (AREA_1 + AREA_2)
AREA_TERM = {"controller.area_uncertainty": AREA_1 / MEAN_AREA - 1.0}
# 1.4 and 1.8 kg times (Ā/A_i)(4V_i/V_t) at 10 and 70 deg, by hand: 139.05 and 38.92 mm of rod.
VOLUMES = [
    (AREA_1, 5e-6 + AREA_1 * 0.13905),
    (AREA_1, 5e-6 + AREA_1 * 0.038916),
    (AREA_2, 5e-6 + AREA_2 * (0.150 - 0.13905)),
    (AREA_2, 5e-6 + AREA_2 * (0.150 - 0.038916)),
]
MASS_FACTORS = [MEAN_AREA / area * 4.0 * volume / 41_233e-9 for area, volume in VOLUMES]
GAIN = AREA_TERM | {
    "controller.mass_min_kg": 1.4 * min(MASS_FACTORS),
    "controller.mass_max_kg": 1.8 * max(MASS_FACTORS),
}


def from_outside(duration_s, **values):
    """Times and s of a run that starts 10 mm beside the reference, outside the layer."""
    start = {
        "controller.eta_m_s3": ETA,
        "controller.sample_time_s": 2e-5,
        "initial_offset_m": -0.010,
        "plant.load.disturbance_n": 60.0,
        "simulation.duration_s": duration_s,
    }
    run = simulate(IDEAL.changed(start | values), signals=("sliding_variable",))
    return run.time_s, run["sliding_variable_m_s2"]


def rates(time_s, s):
    """The mean rates of |s| between each two neighbouring samples outside the layer."""
    outside = np.abs(s) > PHI
    both = outside[1:] & outside[:-1] & (s[1:] * s[:-1] > 0.0)
    return (np.diff(np.abs(s)) / np.diff(time_s))[both]


@pytest.mark.parametrize("mass_kg", [1.4, 1.8])
def test_reduced_order_keeps_the_promise_at_both_bounds_of_the_mass(mass_kg):
    time_s, s = from_outside(0.002, **{"plant.cylinder.mass_kg": mass_kg})
    assert rates(time_s, s).max() < -ETA
    inside = np.abs(s) <= PHI
    reached = np.argmax(inside)
    assert 0.0 < time_s[reached] <= (abs(s[0]) - PHI) / ETA + 2e-5
    assert inside[reached:].all()


@pytest.mark.parametrize(
    ("law", "attracts", "holds"),
    [({}, False, False), (AREA_TERM, True, False), (GAIN, True, True)],
    ids=["Eq. 27", "area", "area, gain"],
)
def test_full_order_needs_the_area_to_attract_and_the_gain_to_hold(law, attracts, holds):
    time_s, s = from_outside(0.006, **{"plant.full_order": {}}, **law)
    assert (rates(time_s, s).max() < 0.0) == attracts
    assert (rates(time_s, s).max() < -ETA) == holds
    inside = np.abs(s) <= PHI
    assert inside[np.argmax(inside) :].all() == attracts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("eta", "load_n", "law", "stays"),
    [
        # Closed forms: 33 100 m/s³ with P_1 loaded (the area term at the peak speed), 80 100 with
        # P_2 (below, the layer itself is unstable).
        (3.0e4, 60.0, {}, False),
        (3.6e4, 60.0, {}, True),
        (7e4, -60.0, {}, False),
        (9e4, -60.0, {}, True),
        (ETA, 60.0, AREA_TERM, True),
        (ETA, -60.0, AREA_TERM, True),
    ],
)
def test_the_paper_s_k_suffices_from_the_closed_forms_on(eta, load_n, law, stays):
    values = {"controller.eta_m_s3": eta, "plant.load.disturbance_n": load_n}
    scenario = IDEAL.changed({"plant.full_order": {}} | values | law)
    try:
        run = simulate(scenario, signals=("sliding_variable", "rod_extension", "rod_reference"))
    except SimulationError:
        assert not stays  # the knee leaves its range of motion
        return
    assert (np.abs(run["sliding_variable_m_s2"]).max() <= PHI) == stays
    if stays:
        error_m = run["rod_extension_m"] - run["rod_reference_m"]
        assert np.abs(error_m).max() <= PHI / 20.0**2
