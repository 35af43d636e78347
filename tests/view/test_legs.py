import numpy as np
import pytest

from kneexo.command_line.main import main
from kneexo.errors import ScenarioError, SimulationError
from kneexo.parameters import Scenario
from kneexo.parameters.scenario_file import load_scenario
from kneexo.simulation import simulate
from kneexo.view.legs import leg_of_results, leg_of_scenario


def scenario_of(**fields):
    return Scenario.model_validate({"simulation": {"duration_s": 0.5}} | fields)


def test_a_leg_has_the_signals_of_its_run():
    scenario = scenario_of()
    leg, failure = leg_of_scenario("mine", scenario)
    run = simulate(scenario)
    assert (leg.name, failure) == ("mine", "")
    np.testing.assert_array_equal(leg.time_s, run.time_s)
    np.testing.assert_array_equal(leg.knee_angle_rad, run["knee_angle_rad"])
    np.testing.assert_array_equal(leg.reference_rad, run["knee_reference_rad"])
    np.testing.assert_array_equal(leg.pressure_pa, run["load_pressure_pa"])


WORN = {"plant": {"load": "knee"}, "wearer": "leg"}


def test_a_leg_with_a_wearer_has_his_angle_and_his_torque():
    scenario = scenario_of(**WORN)
    leg, _ = leg_of_scenario("worn", scenario)
    run = simulate(scenario)
    np.testing.assert_array_equal(leg.wearer_rad, run["wearer_angle_rad"])
    np.testing.assert_array_equal(leg.torque_n_m, run["interaction_torque_n_m"])
    assert leg_of_scenario("free", scenario_of())[0].wearer_rad is None


def test_results_with_a_wearer_need_his_columns(tmp_path):
    head = "time_s,knee_angle_rad,knee_reference_rad,load_pressure_pa"
    signals, scenario = tmp_path / "signals.csv", scenario_of(**WORN)
    signals.write_text(f"{head}\n0,1,1,3\n")
    with pytest.raises(ScenarioError, match="has no column 'wearer_angle_rad'"):
        leg_of_results("worn", tmp_path, scenario)
    head += ",wearer_angle_rad,interaction_torque_n_m\n"
    signals.write_text(f"{head}0,1,1,3,1.25,-40\n")
    leg = leg_of_results("worn", tmp_path, scenario)
    assert (leg.wearer_rad, leg.torque_n_m) == (1.25, -40.0)
    for row, match in (
        ("0,1,1,3,7,0", "wearer_angle_rad = 7 rad is out of range"),
        ("0,1,1,3,1,1e38", r"interaction_torque_n_m = 1e\+38 N·m is out of range"),
    ):
        signals.write_text(f"{head}{row}\n")
        with pytest.raises(ScenarioError, match=match):
            leg_of_results("worn", tmp_path, scenario)


FAILING = scenario_of(
    controller={
        "kind": "pid",
        "proportional_per_s": 0.0,
        "integral_per_s2": 0.0,
        "velocity_feedforward": 2.0,
    },
    reference={"kind": "sine", "mean_deg": 45.0, "amplitude_deg": 44.0, "frequency_hz": 0.1},
    simulation={"duration_s": 8.0},
)


def test_a_run_that_fails_is_shown_up_to_there():
    with pytest.raises(SimulationError) as error:
        simulate(FAILING)
    leg, failure = leg_of_scenario("failing", FAILING)
    assert failure == str(error.value)
    failure_s = float(failure.partition("t = ")[2].partition(" ")[0])
    assert failure_s - 0.005 < leg.time_s[-1] < failure_s
    assert np.isfinite(leg.knee_angle_rad).all()


def test_results_of_simulate_are_a_leg(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("kneexo.command_line.output.save_figure", lambda *_: None)
    scenario = tmp_path / "g3.yaml"
    scenario.write_text("plant: {linkage: G3}\nsimulation: {duration_s: 0.5}\n")
    out = tmp_path / "run"
    assert main(["simulate", str(scenario), "--out", str(out)]) == 0
    written = load_scenario(out / "scenario.yaml")
    read = leg_of_results("mine", out, written)
    run, _ = leg_of_scenario("run", scenario_of(plant={"linkage": "G3"}))
    assert read.name == "mine"
    assert read.linkage == run.linkage
    for column in ("time_s", "knee_angle_rad", "reference_rad", "pressure_pa"):
        expected = getattr(run, column)
        np.testing.assert_allclose(getattr(read, column), expected, rtol=1e-9, atol=1e-12)
    signals = out / "signals.csv"
    head = "time_s,knee_angle_rad,knee_reference_rad,load_pressure_pa\n"
    for text, match in (
        (
            "time_s,knee_angle_rad\n0,1\n",
            "signals.csv: has no column 'knee_reference_rad'; it has knee_angle_rad, time_s$",
        ),
        (f"{head}0,1,1,x\n", "signals.csv:2: load_pressure_pa: 'x'; must be a finite number"),
        (head, "has no rows"),
        (f"{head}0,1,1,nan\n", "signals.csv:2: load_pressure_pa: 'nan'; must be a finite number"),
        (
            f"{head}-1,1,1,3\n0,1,1,3\n",
            "signals.csv:2: time_s = -1 s is out of range: must be >= 0",
        ),
        (f"{head}0,1,1,3\n1,1,1,3\n1,1,1,3\n", "signals.csv:4: time_s = 1 s after 1 s: must incre"),
        (f"{head}0,1e308,1,3\n", r"signals.csv:2: knee_angle_rad = 1e\+308 rad is out of range"),
        (f"{head}0,1,1,3\n1,1,-1e308,3\n", r"signals.csv:3: knee_reference_rad = -1e\+308 rad is"),
        (f"{head}0,1,1,1e308\n", r"signals.csv:2: load_pressure_pa = 1e\+308 Pa is out of range"),
    ):
        signals.write_text(text)
        with pytest.raises(ScenarioError, match=match):
            leg_of_results("mine", out, written)
    signals.unlink()
    with pytest.raises(ScenarioError, match="cannot be read"):
        leg_of_results("mine", out, written)
