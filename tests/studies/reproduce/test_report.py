from functools import reduce

import pytest
from reproduce_cases import (
    METRICS,
)

from kneexo.parameters import RodPolynomialParameters
from kneexo.studies.paper import EQ_27_DIFFERENCES, EQ_27_EXACT_STATES, FIG_12
from kneexo.studies.reproduce.report import report
from kneexo.studies.reproduce.study import (
    speed_demand,
)

PAPER = {
    # where our number is: what Lee et al. 2020 print
    ("table1", "x_at_10deg_mm"): 139.05,
    ("table1", "x_at_70deg_mm"): 38.98,
    ("table1", "strokes_per_period_mm"): 200.14,
    ("table1", "linkage_max_mm"): None,
    ("table1", "refit_p_sse_mm2"): 0.1781,
    ("table1", "refit_q_sse_deg2"): 1.241,
    ("table1", "linkage_rmse_mm"): 0.03,
    ("table1", "refit_q_rmse_deg"): 0.0792,
    ("table1_g4", "refit_p_sse_mm2"): 0.1781,
    ("table1_g4", "refit_q_sse_deg2"): 1.241,
    ("table1_g4", "refit_p_rmse_mm"): 0.03,
    ("table1_g4", "refit_q_rmse_deg"): 0.0792,
    ("fig9", "error_after_1s_mm"): None,
    ("fig9", "final_error_mm"): 0.0,
    ("fig12", "smc", "max_error_deg"): 2.0,
    ("fig12", "pid", "max_error_deg"): 4.0,
    ("fig12", "pid_tuned", "max_error_deg"): None,
    ("fig12", "pid_feedforward", "max_error_deg"): None,
    ("fig13", "bandwidth_hz"): 0.21,
    ("fig13", "phase_at_bandwidth_deg"): None,
    ("scaling", "gear_3", "ratio"): None,
    ("scaling", "half_amplitude", "ratio"): None,
}


def test_the_report_has_each_number_of_the_paper_beside_ours(known, tables):
    numbers = known.results()
    comparison, *_ = tables(report(known))
    assert comparison[0][:5] == ["quantity", "unit", "paper", "kneexo", "difference"]
    for (path, paper), row in zip(PAPER.items(), comparison[1:], strict=True):
        ours = reduce(dict.__getitem__, path, numbers)
        unit, printed, shown, difference = row[1:5]
        suffix = {"mm": "_mm", "mm²": "_mm2", "deg": "_deg", "deg²": "_deg2", "Hz": "_hz"}
        assert path[-1].endswith(suffix.get(unit, "ratio")), row
        assert float(shown) == pytest.approx(ours, abs=0.51 * 10.0 ** -len(shown.split(".")[-1]))
        if paper is None:
            assert (printed, difference) == ("not printed", "")
        else:
            assert float(printed) == paper
            assert difference[0] in "+-"
            assert float(difference) == pytest.approx(ours - paper, rel=6e-3, abs=1e-12)


def test_the_other_tables_of_the_report_are_those_of_the_results(known, tables):
    _, quintics, controllers, exact, differences = tables(report(known))
    p, q = RodPolynomialParameters().p_mm_deg, RodPolynomialParameters().q_deg_mm
    for n, row in enumerate(quintics[1:]):
        assert (row[0], row[3]) == (f"p_{n + 1}", f"q_{n + 1}")
        shown = [float(row[column]) for column in (1, 2, 4, 5)]
        expected = [p[n], 1e-9 * (n + 1), q[n], 1e-8 * (n + 1)]
        assert shown == pytest.approx(expected, rel=6e-4)
    columns = ("max_error_deg", "rms_error_deg", "mean_command_change_rpm", "saturated_share")
    for n, (name, row) in enumerate(zip(FIG_12, controllers[1:], strict=True)):
        assert row[0] == name
        expected = [(n + 1) * METRICS[column] for column in (*columns, "peak_command_rpm")]
        assert [float(cell) for cell in row[1:]] == pytest.approx(expected, abs=5e-4)
    assert [float(row[1]) for row in exact[1:]] == pytest.approx([-0.5, 0.5], abs=0.025)
    assert [row[0] for row in exact[1:]] == list(EQ_27_EXACT_STATES)
    for name, factor, row in zip(EQ_27_DIFFERENCES, (10, 20), differences[1:], strict=True):
        assert row[0] == name
        expected = [factor * value for value in (0.11, 0.12, 15.0)]
        assert [float(cell) for cell in row[1:]] == pytest.approx(expected, abs=5e-3)


def test_the_words_about_the_speed_limit_have_its_numbers(known):
    text = report(known)
    peak_rpm, saturation_hz = speed_demand()
    for said in (f"{peak_rpm:.0f} rpm", f"{saturation_hz:.3f} Hz", "1700 rpm", "16.0 %"):
        assert said in text
