"""Residuals and counters of the fault detectors against sequences that are computed by hand."""

import math

import numpy as np
import pytest

from diagramc.testing import check_leaf
from kneexo.parameters import PlantParameters, ProtectionParameters
from kneexo.parameters.device.safety_states import DETECTORS
from kneexo.systems import FaultDetectors
from kneexo.systems.fault_detectors import context_values

T = 0.002
SPAN = (1.0, 3.0)
QUIET = {
    "encoder_reading": [2.0],
    "rod_extension": [0.1],
    "bad": [0.0] * 6,
    "motor_speed": [0.0],
    "motor_speed_command": [0.0],
    "knee_angle": [0.5],
    "knee_reference": [0.5, 0.0, 0.0, 0.0],
    "measured_force": [0.0, 0.0],
}
COLUMN = {name: column for column, name in enumerate(DETECTORS)}


def detectors(follows=True, measures_force=True, **values):
    parameters = ProtectionParameters(**values)
    return FaultDetectors(parameters, PlantParameters(), SPAN, T, follows, measures_force)


def run(system, samples, **rows):
    """Outputs at each sample, before the update. ``rows`` has the sequence of an input port."""
    context = system.CreateDefaultContext()
    names = ("encoder_reading", "knee_angle", "rod_extension", "residuals", "detected")
    found = {name: [] for name in names}
    for sample in range(samples):
        for name, value in QUIET.items():
            if system.HasInputPort(name):
                row = np.atleast_1d(rows[name][sample]) if name in rows else value
                system.GetInputPort(name).FixValue(context, row)
        for name, values in found.items():
            values.append(system.GetOutputPort(name).Eval(context).copy())
        update = system.EvalUniquePeriodicDiscreteUpdate(context).get_vector(0).CopyToVector()
        context.SetDiscreteState(0, update)
    return {name: np.array(values) for name, values in found.items()}


def residual(name, samples, system=None, **rows):
    return run(system or detectors(), samples, **rows)["residuals"][:, COLUMN[name]]


def test_range_is_the_angle_beyond_the_readings_less_whole_turns():
    readings = np.array([2.0, 3.0, 3.5, 0.75, 3.0 + 2 * math.pi, 2.0 - 2 * math.pi])
    found = residual("range", 6, encoder_reading=readings)
    np.testing.assert_allclose(found, [0, 0, 0.5, 0.25, 0, 0], rtol=0, atol=1e-14)


FAR = (3.01 + 2 * math.pi, 0.99 - 2 * math.pi, 2.0 + 6 * math.pi, math.nan, math.inf)
BAD = [
    *(("encoder_reading", value, "range") for value in FAR),
    *(("bad", np.eye(6)[COLUMN[n]], n) for n in ("flow", "load_cell", "following")),
]


@pytest.mark.parametrize(("port", "value", "name"), BAD)
def test_a_bad_value_trips_one_detector_at_the_largest_thresholds(port, value, name):
    largest = {"range_deg": 360.0, "flow_mm": 1e4, "load_cell_n": 1e6, "following_deg": 360.0}
    found = run(detectors(**largest), 8, **{port: [QUIET[port], *6 * [value], QUIET[port]]})
    assert found["detected"][:, COLUMN[name]].tolist() == [0.0] * 6 + [1.0, 1.0]
    assert not np.delete(found["residuals"], COLUMN[name], axis=1).any()
    assert found["encoder_reading"].ravel().tolist() == [2.0] * 8


def test_without_a_range_only_a_reading_beyond_two_turns_is_implausible():
    system = FaultDetectors()
    parameters = system.parameters(system.CreateDefaultContext())
    assert (parameters.reading_min_rad, parameters.reading_max_rad) == (-math.pi, math.pi)
    readings = np.array([0.0, 3.1, -3.1, 9.4, -31.0])
    found = residual("range", 5, FaultDetectors(), encoder_reading=readings)
    assert found.tolist() == [0.0, 0.0, 0.0, 0.0, 2.0 * math.pi]


def test_rate_is_the_change_since_the_last_plausible_reading_and_a_wrap_is_no_jump():
    count = 2 * math.pi / 4096
    wrapped = 2.0 + 2 * count - 2 * math.pi
    readings = np.array([2.0, 2.0 + count, wrapped, 2.5, 2.5, 2.0 + 4 * count])
    found = residual("rate", 6, encoder_reading=readings)
    jump = (0.5 - 2 * count) / T
    expected = [0, count / T, count / T, jump, jump / 2, 2 / 3 * count / T]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_an_outlier_does_not_reach_the_law():
    readings = np.array([2.0, 2.001, 2.5, math.nan, 2.002, 9.0, 2.003])
    angles = np.where(readings < 2.1, 0.1 * readings, math.nan)  # the linkage cannot close
    rows = {"encoder_reading": readings, "knee_angle": angles, "rod_extension": 2.0 * angles}
    found = run(detectors(), 7, **rows)
    expected = np.array([2.0, 2.001, 2.001, 2.001, 2.002, 2.002, 2.003])
    np.testing.assert_array_equal(found["encoder_reading"][:, 0], expected)
    np.testing.assert_array_equal(found["knee_angle"][:, 0], 0.1 * expected)
    np.testing.assert_array_equal(found["rod_extension"][:, 0], 2.0 * (0.1 * expected))
    assert np.isfinite(found["residuals"]).all()


def test_zero_comes_before_the_first_plausible_reading_and_a_start_without_one_is_a_fault():
    """The first plausible reading has no rate, however far it is from zero."""
    angles = [0.3, math.nan, 0.4, 0.4]
    found = run(detectors(), 4, encoder_reading=[0.5, math.nan, 1.1, 1.1], knee_angle=angles)
    assert found["encoder_reading"][:, 0].tolist() == [0.0, 0.0, 1.1, 1.1]
    assert found["knee_angle"][:, 0].tolist() == [0.0, 0.0, 0.4, 0.4]
    system = detectors()
    for reading, expected in ((0.5, 5.0), (2.0, 0.0)):
        context = system.CreateDefaultContext()
        system.GetInputPort("encoder_reading").FixValue(context, [reading])
        system.ExecuteInitializationEvents(context)
        state = context.get_discrete_state(0).CopyToVector().tolist()
        assert state == [0.0] * 6 + [expected] + [0.0] * 5
    assert not found["residuals"][:, COLUMN["rate"]].any()


def test_flow_is_the_travel_on_which_encoder_and_motor_disagree():
    """A rod that stands while the motor turns: the closed form of the sum, (1 − qⁿ) v T/(1 − q)."""
    speed, n = 100.0, 50
    plant = PlantParameters()
    area = plant.cylinder.mean_area_m2
    v = plant.pump.displacement_m3_per_rad * speed / plant.pump.gear_ratio / area
    found = residual("flow", n + 1, motor_speed=np.full(n + 1, speed))
    q = 1.0 - T / ProtectionParameters().flow_s
    np.testing.assert_allclose(found, v * T * (1 - q ** np.arange(n + 1)) / (1 - q), rtol=1e-9)
    moving = residual(
        "flow", n, motor_speed=np.full(n, speed), rod_extension=0.1 + v * T * np.arange(n)
    )
    assert moving[1:].max() <= v * T * (1 + 1e-9)  # only that of the first sample


def test_the_leakage_that_holds_a_load_is_no_disagreement():
    """A rod under 2.8 MPa stands while the motor turns with 252 rpm (leakage of the pump)."""
    plant = PlantParameters()
    area = plant.cylinder.mean_area_m2
    flow = plant.pump.leakage_m3_per_s_pa * 2.8e6
    speed = flow * plant.pump.gear_ratio / plant.pump.displacement_m3_per_rad
    assert speed * 60 / (2 * math.pi) == pytest.approx(252.0, rel=1e-3)
    rows = {
        "motor_speed": np.full(200, speed),
        "measured_force": np.tile([2.8e6 * area, 0], (200, 1)),
    }
    assert residual("flow", 200, **rows).max() < 1e-12
    blind = residual("flow", 200, detectors(measures_force=False), motor_speed=np.full(200, speed))
    v, flow_s = flow / area, ProtectionParameters().flow_s
    assert blind[-1] == pytest.approx(v * flow_s * (1 - (1 - T / flow_s) ** 199), rel=1e-9)


def test_speed_is_a_low_pass_of_command_minus_speed():
    n = 30
    found = residual(
        "speed", n, motor_speed_command=np.full(n, -80.0), motor_speed=np.full(n, 20.0)
    )
    q = 1.0 - T / ProtectionParameters().speed_s
    np.testing.assert_allclose(found, 100.0 * (1 - q ** np.arange(n)), rtol=1e-12)


def test_following_and_load_cell_are_absolute_values():
    rows = {
        "knee_angle": [0.5, 0.7, 0.4],
        "measured_force": [[-30.0, 0.0], [20.0, 0.0], [5.0, 0.0]],
    }
    found = run(detectors(), 3, **rows)["residuals"]
    np.testing.assert_allclose(found[:, COLUMN["following"]], [0.0, 0.2, 0.1], atol=1e-15)
    np.testing.assert_array_equal(found[:, COLUMN["load_cell"]], [30.0, 20.0, 5.0])


@pytest.mark.parametrize("name", ["following", "load_cell"])
def test_a_loop_without_the_signal_has_no_residual(name):
    system = detectors(follows=name != "following", measures_force=name != "load_cell")
    port = {"following": "knee_reference", "load_cell": "measured_force"}[name]
    assert not system.HasInputPort(port)
    assert run(system, 3)["residuals"][:, COLUMN[name]].tolist() == [0.0, 0.0, 0.0]


def test_a_detector_trips_after_n_more_samples_above_than_below():
    angles = 0.5 + np.array([1, 1, 0, 1, 1, 0, 0, 1, 1, 0], dtype=float)
    found = run(detectors(trip_s=3 * T, following_deg=10.0), 10, knee_angle=angles)
    # Counters after the samples: 1 2 1 2 3 2 1 2 3 2. A record shows them one sample later.
    detected = found["detected"][:, COLUMN["following"]]
    np.testing.assert_array_equal(detected, [0, 0, 0, 0, 0, 1, 0, 0, 0, 1])
    others = np.delete(found["detected"], COLUMN["following"], axis=1)
    assert not others.any()


def test_the_thresholds_are_those_of_the_parameters_in_si_units():
    values = context_values(ProtectionParameters(), PlantParameters(), SPAN, T)
    p = ProtectionParameters()
    expected = [
        math.radians(p.range_deg),
        math.radians(p.rate_deg_s),
        1e-3 * p.flow_mm,
        p.load_cell_n,
        p.speed_rpm * 2 * math.pi / 60,
        math.radians(p.following_deg),
    ]
    assert list(values.values())[:6] == pytest.approx(expected, rel=1e-14)
    assert values["trip_samples"] == 5.0


def test_scalars_dependencies_and_parameters():
    system = detectors()
    inputs = {
        "encoder_reading": [(1.9, 2.1)],
        "rod_extension": [(0.09, 0.11)],
        "bad": [(-0.2, -0.1)] * 6,
        "motor_speed": [(10.0, 20.0)],
        "motor_speed_command": [(30.0, 40.0)],
        "knee_angle": [(0.5, 0.51)],
        "knee_reference": [(0.4, 0.41), (0, 1), (0, 1), (0, 1)],
        "measured_force": [(10.0, 20.0), (0.0, 0.002)],
    }
    state = [
        (0.9, 1.1),
        (1.8, 1.85),
        (0.5, 0.6),
        (0.05, 0.08),
        (1e-3, 2e-3),
        (5.0, 6.0),
        *[(1.6, 2.4)] * 6,
    ]
    check_leaf(system, inputs | {"discrete_state": state})
