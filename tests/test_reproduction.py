import dataclasses
import json

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo.analysis import (
    Run,
    fit_polynomials,
    linearize_loop,
    simulate,
    sinestream,
    track,
)
from kneexo.output import to_json
from kneexo.parameters import (
    EQ_27_DIFFERENCES,
    EQ_27_EXACT_STATES,
    FIG_12,
    FIG_13_SCALING,
    IDEAL_SMC,
    Scenario,
    SimulationParameters,
    SineReference,
    SinestreamParameters,
)
from kneexo.reproduction import (
    Reproduction,
    figures,
    growth_rate,
    report,
    results,
    rod_error_mm,
    speed_demand,
)


def shortened(scenario, seconds):
    settings = scenario.simulation.model_copy(update={"duration_s": seconds})
    return scenario.model_copy(update={"simulation": settings})


@pytest.fixture(scope="module")
def short():
    """A reproduction of very short runs: every path, no meaningful numbers."""
    sine = Scenario(reference=SineReference(amplitude_deg=2.0))
    response = sinestream(
        sine,
        SinestreamParameters(
            frequencies_hz=(8.0, 9.0, 10.0), trials=2, measured_cycles=1, transient_cycles=0
        ),
    )
    pressures = ("load_pressure", "motor_speed_command")
    return Reproduction(
        fit=fit_polynomials(),
        fig9=simulate(shortened(IDEAL_SMC, 1.01), signals=("rod_reference", "rod_extension")),
        fig12={name: track(shortened(case, 0.05)) for name, case in FIG_12.items()},
        fig13=response,
        scaling=dict.fromkeys(FIG_13_SCALING, response),
        eq27_exact={
            name: simulate(shortened(case, 0.05), signals=pressures)
            for name, case in EQ_27_EXACT_STATES.items()
        },
        eq27_differences={
            name: track(shortened(case, 0.05)) for name, case in EQ_27_DIFFERENCES.items()
        },
    )


def test_results_have_the_keys_that_others_read(short):
    numbers = json.loads(to_json(results(short)))
    expected = {
        "table1": {"x_at_10deg_mm", "x_at_70deg_mm", "linkage_rmse_mm", "linkage_max_mm"},
        "table1_g4": {"refit_p_sse_mm2", "refit_q_sse_deg2", "refit_p_rmse_mm", "refit_q_rmse_deg"},
        "fig9": {"error_after_1s_mm", "final_error_mm"},
        "fig12": {"smc", "pid", "pid_tuned"},
        "fig13": {
            "frequencies_hz",
            "gain",
            "phase_deg",
            "bandwidth_hz",
            "phase_at_bandwidth_deg",
            "trials",
        },
    }
    for key, names in expected.items():
        assert names <= set(numbers[key])
    for controller in numbers["fig12"].values():
        assert {
            "max_error_deg",
            "rms_error_deg",
            "mean_command_change_rpm",
            "saturated_share",
        } <= set(controller)
    assert numbers["table1"]["x_at_70deg_mm"] == pytest.approx(38.916, abs=1e-3)
    g4 = numbers["table1_g4"]
    assert g4["refit_p_rmse_mm"] == pytest.approx(0.0296, abs=1e-4)
    assert g4["refit_q_rmse_deg"] == pytest.approx(0.0796, abs=1e-4)
    assert numbers["table1"]["strokes_per_period_mm"] == pytest.approx(200.27, abs=0.01)
    # 89 mm (1 + λt) e^{−λt} at λ = 10 1/s and 1 s.
    assert numbers["fig9"]["error_after_1s_mm"] == pytest.approx(0.0444, abs=2e-4)


def test_the_scaling_is_relative_to_the_nominal_plant(short):
    known = {"nominal": 0.2, "gear_3": 0.4, "half_amplitude": 0.3}
    scaling = {name: dataclasses.replace(short.fig13, bandwidth_hz=f) for name, f in known.items()}
    numbers = results(dataclasses.replace(short, scaling=scaling))["scaling"]
    assert {name: case["ratio"] for name, case in numbers.items()} == pytest.approx(
        {"nominal": 1.0, "gear_3": 2.0, "half_amplitude": 1.5}
    )


def test_the_report_is_a_table_with_every_number_of_the_paper(short):
    text = report(results(short))
    for printed in ("139.05", "38.98", "200.14", "0.1781", "1.241", "0.03", "0.0792", "0.21"):
        assert f"| {printed} |" in text
    assert "| -1.807e-09 |" in text  # q_1 of Table 1
    assert "4094 rpm" in text
    tables = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(tables) > 30


def test_the_figures_are_the_papers(short):
    drawn = figures(short)
    assert [name[:5] for name in drawn] == ["fig05", "fig09", "fig12", "fig13", "eq27_"]
    for figure in drawn.values():
        for ax in figure.axes:
            assert ax.get_ylabel()
        plt.close(figure)


def test_the_speed_limit_does_not_explain_the_error_at_a_tenth_of_a_hertz():
    peak, saturation = speed_demand()
    # By hand: 30° at 0.1 Hz, moment arm of Table 1, 274.889 mm², 0.8 cm³/rev, gear 6.
    p = np.array([1.571e-8, -4.164e-6, 0.0004789, -0.03192, -0.6195, 148.0])
    phase = np.linspace(0.0, 2.0 * np.pi, 4001)
    slope = np.polyval(np.polyder(p), 40.0 - 30.0 * np.cos(phase))  # mm/deg
    speed = np.abs(slope * 30.0 * 0.2 * np.pi * np.sin(phase)).max()  # mm/s
    assert peak == pytest.approx(speed * 274.889 / 800.0 * 6.0 * 60.0, rel=1e-5)
    assert peak == pytest.approx(4094.0, abs=1.0)
    assert saturation == pytest.approx(0.1221, abs=1e-4)


def test_growth_rate_of_a_growing_oscillation():
    time = np.arange(0.0, 3.0, 0.002)
    run = Run(
        time,
        {"load_pressure_pa": np.exp(1.2 * time) * np.sin(330.0 * time)},
        SimulationParameters(),
    )
    assert growth_rate(run) == pytest.approx(1.2, abs=0.02)


def test_the_start_of_fig_9_is_89_mm_off(short):
    assert rod_error_mm(short.fig9)[0] == pytest.approx(-89.0, abs=1e-6)


@pytest.mark.parametrize("name", list(EQ_27_EXACT_STATES))
def test_the_oscillation_at_2_ms_grows_as_the_eigenvalues_say(name):
    case = EQ_27_EXACT_STATES[name]
    eigenvalues = linearize_loop(case, 30.0).eigenvalues
    # The mode of the oil, 447 Hz, appears at 500 − 447 = 53 Hz.
    hertz = np.abs(np.angle(eigenvalues)) / (2.0 * np.pi * 0.002)
    mode = eigenvalues[np.argmin(np.abs(hertz - 53.0))]
    run = simulate(case, signals=("load_pressure", "motor_speed_command"))
    # The fit's blocks of 0.15 s hold eight periods.
    assert growth_rate(run) == pytest.approx(np.log(abs(mode)) / 0.002, abs=0.02)
    assert (growth_rate(run) > 0.0) == (name == "13000")


@pytest.mark.parametrize("name", list(EQ_27_DIFFERENCES))
def test_differences_of_the_encoder_make_degrees_of_error(name):
    assert 5.0 < track(EQ_27_DIFFERENCES[name]).metrics.max_error_deg < 26.0


def test_the_tuned_pids_stay_within_the_chattering_of_the_sliding_mode():
    smc = track(FIG_12["smc"]).metrics
    assert smc.max_error_deg <= 0.30
    for name in ("pid_tuned", "pid_feedforward"):
        pid = track(FIG_12[name]).metrics
        assert pid.mean_command_change_rpm <= smc.mean_command_change_rpm
        assert pid.max_error_deg < 0.1
