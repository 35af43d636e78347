"""The actuator's load in a measured stride, against statics by hand and the model's own valves."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from kneexo.analysis import stride_load
from kneexo.analysis.walking.stride import smallest_piston_factor
from kneexo.errors import ParameterError
from kneexo.parameters import (
    G1,
    G4,
    CylinderParameters,
    FullCylinderParameters,
    KneeParameters,
    PlantParameters,
    Scenario,
)
from kneexo.parameters.task.gait import gait_knee_moment
from kneexo.studies.hardware import with_piston
from kneexo.systems import FullCylinder
from kneexo.systems.full_cylinder import makeup_flow

CAP = math.pi / 4.0 * 0.020**2  # A_1 and A_2 in m², Lee et al. 2020, Table 3
ROD_SIDE = math.pi / 4.0 * (0.020**2 - 0.010**2)
PUMP_FLOW = 5000.0 / 60.0 / 6.0 * 0.8e-6  # m³/s, Tables 2 and 3
LOAD = stride_load()


def at(load, event):
    return {
        field.name: values[load.events()[event]]
        for field in dataclasses.fields(load)
        if np.ndim(values := getattr(load, field.name))
    }


# Each row was computed from the data and the linkage without kneexo. Half a unit of the last digit.
@pytest.mark.parametrize(
    ("event", "angle", "moment", "force", "reduced", "cap", "rod_side", "speed_mm_s"),
    [
        ("rod pushes most", 20.8, -64.6, 773, 2.81, 2.61, 0.20, 9),
        ("rod pulls most", 2.0, 32.8, -757, -2.75, 0.20, 3.48, 58),
        ("most flexion moment", 3.7, 34.0, -706, -2.57, 0.20, 3.26, 130),
        ("fastest rod", 35.5, 7.0, -72, -0.26, 0.20, 0.57, 700),
    ],
)
def test_extremes_of_the_stride(event, angle, moment, force, reduced, cap, rod_side, speed_mm_s):
    row = at(LOAD, event)
    assert row["knee_angle_deg"] == pytest.approx(angle, abs=0.05)
    assert row["knee_moment_n_m"] == pytest.approx(moment, abs=0.05)
    assert row["rod_force_n"] == pytest.approx(force, abs=0.6)
    pressures = [row[f"{name}_pressure_pa"] for name in ("load", "cap", "rod_side")]
    assert pressures == pytest.approx([1e6 * p for p in (reduced, cap, rod_side)], abs=0.006e6)
    assert row["rod_speed_m_s"] == pytest.approx(1e-3 * speed_mm_s, abs=0.6e-3)


def test_most_extension_moment_power_and_share_within_the_speed_of_the_pump():
    assert at(LOAD, "most extension moment")["knee_moment_n_m"] == -65.2298  # as in the file
    assert LOAD.knee_power_w.min() == pytest.approx(-162.1, abs=0.1)
    assert LOAD.knee_power_w.max() == pytest.approx(77.0, abs=0.1)
    limit = PUMP_FLOW / (0.5 * (CAP + ROD_SIDE))
    assert LOAD.rod_speed_limit_m_s == pytest.approx(limit, rel=1e-9)
    # 175 of 1350 samples. The sample nearest to the limit is 1.5e-4 of it away, and the moment arm
    # has an error of 1e-10.
    assert LOAD.share_within_speed == pytest.approx(175 / 1350)


def test_half_the_moment_takes_half_the_force():
    half = stride_load(share=0.5)
    assert half.rod_force_n == pytest.approx(0.5 * LOAD.rod_force_n, rel=1e-12)
    assert half.knee_power_w == pytest.approx(0.5 * LOAD.knee_power_w, rel=1e-12)
    assert half.cap_pressure_pa.max() == pytest.approx(1.38e6, abs=0.005e6)
    assert half.rod_side_pressure_pa.max() == pytest.approx(1.87e6, abs=0.005e6)
    assert np.array_equal(half.rod_speed_m_s, LOAD.rod_speed_m_s)


def test_the_rod_does_the_work_of_the_knee():
    # Trapezoids of the moment over the angle share no derivative with force and speed.
    angle = np.radians(LOAD.knee_angle_deg)
    power = LOAD.rod_force_n * LOAD.rod_speed_m_s
    assert power == pytest.approx(LOAD.knee_power_w, rel=1e-12, abs=1e-12)
    stride = slice(0, 1147)
    work = np.trapezoid(power[stride], LOAD.time_s[stride])
    assert work == pytest.approx(
        np.trapezoid(LOAD.knee_moment_n_m[stride], angle[stride]), abs=0.01
    )
    assert work == pytest.approx(-22.4, abs=0.1)


def test_the_pressures_hold_the_force_and_the_smaller_one_is_the_reservoirs():
    cap, rod_side = LOAD.cap_pressure_pa, LOAD.rod_side_pressure_pa
    assert cap * CAP - rod_side * ROD_SIDE == pytest.approx(LOAD.rod_force_n, rel=1e-9, abs=1e-6)
    assert np.array_equal(np.minimum(cap, rod_side), np.full(1350, 0.2e6))
    assert LOAD.load_pressure_pa == pytest.approx(
        LOAD.rod_force_n / (0.5 * (CAP + ROD_SIDE)), rel=1e-12
    )


@pytest.mark.parametrize("speed", [0.32, -0.32])
def test_the_model_has_the_pressure_of_a_rod_that_outruns_the_pump(tmp_path, speed):
    # At r = −dx/dθ of some 0.1 m the knee turns with a constant rate; the sample in the middle.
    time = np.linspace(0.0, 0.02, 21)
    angle = 45.0 - np.degrees(speed / 0.102) * (time - 0.01)
    load = stride_load(file=stride_file(tmp_path, zip(time, angle, 0.0 * time, strict=True)))
    actual = load.rod_speed_m_s[10]
    assert actual == pytest.approx(speed, rel=0.01)
    # The chamber's balance of flows: what grows, less the pump, comes through the open valve.
    area = CAP if speed > 0.0 else ROD_SIDE
    flow = makeup_flow(
        load.overrun_pressure_pa[10],
        3.5e6,
        reservoir=0.2e6,
        conductance=2e-10,
        pilot_band=0.02e6,
        band=0.02e6,
    )
    assert flow == pytest.approx(area * abs(actual) - PUMP_FLOW, rel=1e-9)
    # And in the system: at this pressure the chamber's rate is zero but for the leakage, none here.
    cylinder = FullCylinder(initial_extension_m=0.075)
    context = cylinder.CreateDefaultContext()
    low, high = 1e-6 * load.overrun_pressure_pa[10], 3.5
    pressures = [low, high] if speed > 0.0 else [high, low]
    context.SetContinuousState([0.075, actual, *pressures])
    cylinder.GetInputPort("load_flow").FixValue(context, math.copysign(PUMP_FLOW, actual))
    rates = cylinder.EvalTimeDerivatives(context).CopyToVector()[2:]
    growing, shrinking = rates if speed > 0.0 else rates[::-1]
    assert abs(growing) < 1e-6 * abs(shrinking)


def test_a_slow_rod_draws_no_oil():
    slow = np.abs(LOAD.rod_speed_m_s) < LOAD.rod_speed_limit_m_s * 0.87  # Ā/A_1 = 0.875
    assert slow.any()
    assert (LOAD.overrun_pressure_pa[slow] == 0.2e6).all()


def test_warnings_name_relief_and_vacuum_with_place():
    (vacuum,) = LOAD.warnings()
    assert vacuum.startswith("pressure of the cap would be -0.845 MPa at t = 1.269 s and 35.5 deg")
    assert f"{np.mean(LOAD.overrun_pressure_pa < -0.1e6):.1%} of the samples" in vacuum
    relief, _ = stride_load(Scenario(plant=PlantParameters(linkage=G4))).warnings()
    assert relief.startswith("pressure of the rod side is 3.68 MPa at t = 1.377 s and 1.97 deg")
    assert "above the relief pressure of 3.5 MPa" in relief
    tight = FullCylinderParameters(relief_pressure_pa=2.5e6, makeup_conductance_m3_per_s_pa=1e-8)
    cap, rod_side = stride_load(Scenario(plant=PlantParameters(full_order=tight))).warnings()
    assert "cap is 2.61 MPa" in cap
    assert "rod side is 3.48 MPa" in rod_side


@pytest.mark.parametrize(("linkage", "share", "factor"), [(G1, 1.0, 0.9936), (G4, 0.7, None)])
def test_the_smallest_piston_brings_a_stride_to_the_relief_pressure(linkage, share, factor):
    scenario = Scenario(plant=PlantParameters(linkage=linkage))
    smallest = smallest_piston_factor(scenario, share)
    load = stride_load(with_piston(scenario, smallest), share=share)
    largest = max(load.cap_pressure_pa.max(), load.rod_side_pressure_pa.max())
    assert largest == pytest.approx(3.5e6, rel=1e-12)
    if factor is not None:  # 757.2 N on A_2 = 235.62 mm², and 0.2 MPa on A_1/A_2 = 4/3 of it
        assert smallest == pytest.approx(757.2 / (235.619 * (3.5 - 0.8 / 3.0)), rel=1e-3)
        assert smallest == pytest.approx(factor, abs=1e-4)
    assert smallest_piston_factor(scenario, 0.0) == 0.0


def test_stance_can_decide_the_piston():
    thin = CylinderParameters(rod_diameter_m=2e-3)  # A_2 = 0.99 A_1
    scenario = Scenario(plant=PlantParameters(cylinder=thin))
    smallest = smallest_piston_factor(scenario)
    assert smallest == pytest.approx(773 / (CAP * (3.5e6 - 0.99 * 0.2e6)), rel=2e-3)
    load = stride_load(with_piston(scenario, smallest))
    assert load.cap_pressure_pa.max() == pytest.approx(3.5e6, rel=1e-12)


def test_a_reservoir_that_pushes_the_rod_out_is_refused():
    thick = CylinderParameters(rod_diameter_m=0.0195)  # A_1 is 20 times A_2
    with pytest.raises(
        ParameterError, match=r"relief_pressure_pa = 3\.5e\+06 Pa: must be > 4.* Pa"
    ):
        smallest_piston_factor(Scenario(plant=PlantParameters(cylinder=thick)))


def test_without_makeup_valves_there_is_no_oil_to_draw():
    blocked = FullCylinderParameters(makeup_conductance_m3_per_s_pa=0.0)
    load = stride_load(Scenario(plant=PlantParameters(full_order=blocked)))
    assert load.overrun_pressure_pa.min() == -math.inf
    assert load.overrun_pressure_pa.max() == 0.2e6


def test_a_file_is_read_in_its_units(tmp_path):
    time, angle, moment = gait_knee_moment()
    load = stride_load(file=stride_file(tmp_path, zip(time, angle, moment, strict=True)))
    assert np.array_equal(load.rod_force_n, LOAD.rod_force_n)
    assert np.array_equal(load.to_dataframe().index, time)


def stride_file(folder, rows):
    path = folder / "stride.csv"
    lines = ["time_s,knee_angle_deg,knee_moment_nm"]
    lines += [",".join(repr(float(value)) for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([(0, 10, 1)] * 4, "stride.csv:3: time_s = 0 s after 0 s: must increase"),
        ([(0, 10, 1), (1, 11, 1)], "stride.csv: has 2 rows; must have at least 4"),
        ([(n, 10, 1e3 * (n + 1)) for n in range(4)], "knee_moment_nm = 2000 N·m is out of range"),
        ([(n, 95 - n, 1) for n in range(4)], "reference = 92 … 95 deg leaves the range of motion"),
        ([(0, 10, "x")], "knee_moment_nm: 'x'; must be a finite number"),
    ],
)
def test_a_faulty_file_is_one_line(tmp_path, rows, message):
    path = tmp_path / "stride.csv"
    text = "\n".join(",".join(map(str, row)) for row in rows)
    path.write_text(f"time_s,knee_angle_deg,knee_moment_nm\n{text}\n", encoding="utf-8")
    with pytest.raises(ParameterError) as caught:
        stride_load(file=path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_a_share_is_a_share(share):
    with pytest.raises(ParameterError, match=r"share = .*: must be >= 0 and <= 1"):
        stride_load(share=share)


def test_the_stride_must_lie_in_the_range_of_motion():
    knee = KneeParameters(flexion_min_deg=5.0)
    with pytest.raises(ParameterError, match=r"1\.496 … 72\.23 deg leaves the range of motion 5"):
        stride_load(Scenario(plant=PlantParameters(knee=knee)))
