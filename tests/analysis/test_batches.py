"""Many variants of a scenario in one call: each row is the run that `track` makes."""

import dataclasses
import io
import sys

import numpy as np
import pytest

from kneexo.analysis import track
from kneexo.analysis.batches import METRICS, BatchResult, batch
from kneexo.command_line.main import main
from kneexo.errors import ParameterError
from kneexo.parameters import Scenario
from kneexo.parameters.paths import changed
from kneexo.parameters.scenario_file import load_scenario

MASS, FREQUENCY, OFFSET = "plant.cylinder.mass_kg", "reference.frequency_hz", "initial_offset_m"
SHORT = changed(Scenario(), {FREQUENCY: 4.0, "reference.amplitude_deg": 0.5})
SHORT = changed(SHORT, {"simulation.duration_s": 0.5})


@pytest.fixture(scope="module")
def mixed():
    """Runs of which the second cannot start, and of which the last two are not allowed."""
    values = {MASS: [1.4, 2.5, 1.6, -1.0, 1.7], OFFSET: [0.0, 0.15, 0.001, 0.0, 1.0]}
    return batch(SHORT, values, combine="zip")


def assert_same(metrics, expected):
    """Assert that metrics agree but for the rounding of their sums, which a batch does not log."""
    assert dataclasses.asdict(metrics) == pytest.approx(
        dataclasses.asdict(expected), rel=1e-11, nan_ok=True
    )


def test_a_grid_has_a_run_for_each_combination():
    result = batch(SHORT, {MASS: [1.4, 2.0], FREQUENCY: np.array([4.0, 5.0, 6.0])})
    expected = [{MASS: m, FREQUENCY: f} for m in (1.4, 2.0) for f in (4.0, 5.0, 6.0)]
    assert [row.values for row in result.rows] == expected
    for row in (result.rows[1], result.rows[-1]):
        assert row.scenario == changed(SHORT, row.values)
        assert_same(row.metrics, track(row.scenario).metrics)
        assert row.error == ""
    assert len({row.metrics.max_error_deg for row in result.rows}) == 6
    assert result.failures == ()
    assert all(type(row.values[FREQUENCY]) is float for row in result.rows)


def test_zip_takes_the_values_side_by_side(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(
        f"reference: {{frequency_hz: 4, amplitude_deg: 0.5}}\n"
        f"simulation: {{duration_s: {SHORT.simulation.duration_s}}}\n",
        encoding="utf-8",
    )
    encoder = "encoder.counts_per_revolution"
    counts = [np.int64(4096), 4096]  # the default: another number would be compiled anew
    result = batch(path, {MASS: (1.4, 2.0), encoder: counts}, combine="zip")
    assert [tuple(row.values.values()) for row in result.rows] == [(1.4, 4096), (2.0, 4096)]
    assert all(type(row.values[encoder]) is int for row in result.rows)
    for row in result.rows:
        assert_same(row.metrics, track(changed(SHORT, row.values)).metrics)


def proportional(rod_extension, rod_reference, gain=1e5):
    return gain * (rod_reference[0] - rod_extension)


def test_the_gains_of_a_law_can_change():
    gain = "controller.values.gain"
    result = batch(SHORT, {gain: [1e5, 1.2e5]}, law=proportional)
    for row in result.rows:
        alone = SHORT.with_law(proportional, values={"gain": row.values[gain]})
        assert_same(row.metrics, track(alone).metrics)
    assert result.rows[0].metrics != result.rows[1].metrics


def test_rows_of_an_array_are_values_of_a_tuple():
    scenario = SHORT.changed({"polynomial": {}})
    table_1 = np.array(scenario.polynomial.p_mm_deg)
    result = batch(scenario, {"polynomial.p_mm_deg": np.vstack([table_1, 1.001 * table_1])})
    assert_same(result.rows[0].metrics, track(scenario).metrics)
    assert result.rows[1].scenario.polynomial.p_mm_deg == pytest.approx(1.001 * table_1)
    assert result.rows[1].metrics != result.rows[0].metrics


def test_a_failed_run_has_its_reason_and_stops_no_other(mixed):
    assert [row.error == "" for row in mixed.rows] == [True, False, True, False, False]
    for row in (mixed.rows[0], mixed.rows[2]):
        assert_same(row.metrics, track(changed(SHORT, row.values)).metrics)
    left, light, away = mixed.failures
    assert left.error.startswith("the rod starts at 0.244634 m (initial offset 0.15 m), outside")
    assert left.scenario == changed(SHORT, left.values)
    assert light.error.startswith(f"{MASS} = -1 kg is out of range: must be")
    assert away.error.startswith(f"{OFFSET} = 1 m is out of range: must be")
    assert light.scenario is away.scenario is None
    assert all(row.metrics is None and "\n" not in row.error for row in mixed.failures)


def test_the_file_of_a_failed_row_repeats_its_run_from_any_folder(tmp_path, monkeypatch, capsys):
    """Positive gains drive the rod away from its reference, and the knee out of its range at 0°."""
    (tmp_path / "my laws.py").write_text(
        "def law(rod_extension, rod_reference, gain=1.0):\n"
        "    return gain * (rod_extension - rod_reference[0])\n"
    )
    monkeypatch.chdir(tmp_path)
    near_the_end = SHORT.changed({"reference.mean_deg": 2.0})
    gains = {"controller.values.gain": [-1e5, 1e5, 1e6]}
    result = batch(near_the_end, gains, law="my laws.py:law")
    assert [row.error[:4] for row in result.rows] == ["", "t = ", "t = "]
    assert len({row.error for row in result.failures}) == 2
    (tmp_path / "away").mkdir()
    for row in result.failures:
        row.write_failure("failure 1.yaml")
        assert load_scenario("failure 1.yaml") == row.scenario
        with monkeypatch.context() as patch:
            patch.chdir("away")
            assert main(["simulate", "../failure 1.yaml", "--out", "out"]) == 2
        *_, last = capsys.readouterr().err.splitlines()  # a slow machine also says that it compiles
        assert last == f"kneexo: ../failure 1.yaml: {row.error}"


def test_only_a_run_that_failed_with_a_law_that_has_a_name_becomes_a_file(mixed, tmp_path):
    path = tmp_path / "failure.yaml"
    with pytest.raises(ParameterError, match=r"^the run of this row has not failed$"):
        mixed.rows[0].write_failure(path)
    _, light, _ = mixed.failures
    refused = rf"^there is no run: the scenario refuses the values: {MASS} = -1 kg is out"
    with pytest.raises(ParameterError, match=refused):
        light.write_failure(path)

    def inner(rod_extension):
        return 1e5 * rod_extension

    (row,) = batch(SHORT, {OFFSET: [0.15]}, law=inner).rows
    with pytest.raises(ParameterError, match=r"inner: this name leads to no file with"):
        row.write_failure(path)
    assert not path.exists()


def test_a_frame_has_a_row_for_each_run_and_no_number_for_a_failed_run(mixed):
    frame = mixed.to_dataframe()
    assert list(frame) == [MASS, OFFSET, *METRICS, "error"]
    assert frame[MASS].tolist() == [1.4, 2.5, 1.6, -1.0, 1.7]
    assert frame["error"].tolist() == [row.error for row in mixed.rows]
    for name in METRICS:
        assert frame[name].isna().tolist() == [False, True, False, True, True]
        assert not any(isinstance(value, float) and value != value for value in frame[name])
        assert frame[name][2] == getattr(mixed.rows[2].metrics, name)
    failed = BatchResult(mixed.failures).to_dataframe()
    assert (failed.dtypes == frame.dtypes)[list(METRICS)].all()


def test_the_worst_runs_begin_with_the_largest_value(mixed):
    metric = "max_error_overall_deg"
    first, second = mixed.worst(metric, 2)
    assert first is mixed.worst(metric)
    assert {first.error, second.error} == {""}
    assert getattr(first.metrics, metric) > getattr(second.metrics, metric)
    assert mixed.worst(count=9) == mixed.worst("max_error_deg", 2)  # the other three runs fail


def test_a_summary_names_the_largest_error_and_the_first_failure(mixed):
    worst = mixed.worst()
    mass, offset = (f"{value:.6g}" for value in worst.values.values())
    assert str(mixed).splitlines() == [
        "5 runs, 3 failed",
        f"  largest max_error_deg {worst.metrics.max_error_deg:.4g} at",
        f"    {MASS} = {mass}",
        f"    {OFFSET} = {offset}",
        "  first failure at",
        f"    {MASS} = 2.5",
        f"    {OFFSET} = 0.15",
        f"    {mixed.rows[1].error}",
    ]
    assert str(BatchResult(mixed.rows[:1])).startswith("1 run, 0 failed\n")
    assert "largest" not in str(BatchResult(mixed.failures))


def test_the_plot_has_a_point_for_each_run_and_a_cross_for_each_failure(mixed):
    ax = mixed.plot()
    errors, failed = ax.lines
    assert list(errors.get_xdata()) == [1.0, 2.0, 3.0, 4.0, 5.0]
    largest = [np.nan if r.error else r.metrics.max_error_deg for r in mixed.rows]
    np.testing.assert_array_equal(errors.get_ydata(), largest)
    assert list(failed.get_xdata()) == [2.0, 4.0, 5.0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("run", "largest error (deg)")


def test_the_plot_is_over_the_only_value_that_changes():
    rows = batch(SHORT, {FREQUENCY: [1.0, 4.0]}).rows
    (errors,) = (ax := BatchResult(rows).plot()).lines
    assert list(errors.get_xdata()) == [1.0, 4.0]
    assert ax.get_xlabel() == FREQUENCY
    assert list(errors.get_ydata()) == [row.metrics.max_error_deg for row in rows]
    # The first run has less than two periods, so that its whole error counts.
    assert rows[0].metrics.max_error_deg == rows[0].metrics.max_error_overall_deg


@pytest.mark.parametrize(
    ("worst", "message"),
    [
        (lambda m: m.worst("max_error"), "^metric = 'max_error': .*; did you mean max_error_deg.*"),
        (lambda m: m.worst("x"), "^metric = 'x': must be one of .*, .*hydraulic_energy_j$"),
        (lambda m: m.worst(count=0), "^count = 0: must be a whole number >= 1"),
        (lambda m: m.worst(count=1.0), "^count = 1.0: must be a whole number >= 1"),
        (
            lambda m: BatchResult(m.failures).worst(),
            "^max_error_deg: all 3 runs fail; the first: the rod st",
        ),
    ],
)
def test_a_worst_run_that_there_is_not_is_one_line(mixed, worst, message):
    with pytest.raises(ParameterError, match=message):
        worst(mixed)


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ({MASS: []}, {}, rf"^{MASS}: must have at least one value, not an empty list$"),
        ({MASS: 1.5}, {}, rf"^{MASS} = 1.5: must be a list of values$"),
        ({"plant.linkage": "G1"}, {}, r"^plant.linkage = 'G1': must be a list of values$"),
        ({MASS: {"low": 1.0}}, {}, rf"^{MASS} = {{'low': 1.0}}: must be a list of values$"),
        ({}, {}, r"^values: must name at least one value to change$"),
        ({3: [1.0]}, {}, r"^values: the path 3 must be a text, as {'plant.cylinder.mass_kg': "),
        ([1.0], {}, r"^values: must map paths to lists, as .*, not be a list$"),
        ({"plant.cylinder.mas_kg": [1.0]}, {}, "mas_kg.*did you mean plant.cylinder.mass_kg"),
        ({"mass_kg": [1.0]}, {}, "mass_kg: unknown name; did you mean plant.cylinder.mass_kg"),
        (
            {MASS: [1.0, 2.0], FREQUENCY: [4.0]},
            {"combine": "zip"},
            rf"^combine = 'zip': needs lists of equal length, but {MASS} has 2, {FREQUENCY} has 1$",
        ),
        ({MASS: [1.0]}, {"combine": "x"}, r"^combine = 'x': must be 'grid' or 'zip'$"),
        ({MASS: [1.0]}, {"workers": 0}, r"^workers = 0: must be >= 1, or None for one for each"),
        (
            {MASS: np.ones(1001), FREQUENCY: np.ones(1000)},
            {},
            r"^values: give 1001000 runs, must be at most 1000000$",
        ),
    ],
)
def test_a_faulty_call_is_refused_before_the_first_run(values, options, message):
    with pytest.raises(ParameterError, match=message):
        batch(SHORT, values, **options)


@pytest.mark.parametrize("progress", [True, False])
def test_a_terminal_gets_a_bar(monkeypatch, progress):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    batch(SHORT, {MASS: [1.4]}, progress=progress)
    assert ("batch: 100%" in terminal.getvalue()) == progress


@pytest.mark.slow
def test_processes_change_no_row(mixed):
    values = {path: [row.values[path] for row in mixed.rows] for path in (MASS, OFFSET)}
    assert batch(SHORT, values, combine="zip", workers=2).rows == mixed.rows
