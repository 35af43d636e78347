"""Results as text, as tables for notebooks, and as data frames; parameters as short text."""

from __future__ import annotations

import base64
import inspect
import io
import re
import sys
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.image import imread

import kneexo.analysis
from kneexo.analysis import FrequencyResponse, linearize_loop, linearize_plant, track
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.analysis.mechanism.polynomial_fit import fit_polynomials
from kneexo.analysis.walking.walking import walking_demand
from kneexo.common.plotting import axes_or_new
from kneexo.common.result import Result, data_frame, short
from kneexo.errors import PackageError
from kneexo.parameters import (
    G2,
    UNCERTAINTY,
    CylinderParameters,
    LinkageParameters,
    PlantParameters,
    SampledReference,
    Scenario,
    SimulationParameters,
    SineReference,
)

SHORT = Scenario(
    reference=SineReference(frequency_hz=1.0, amplitude_deg=2.0),
    simulation=SimulationParameters(duration_s=1.2),
)


@pytest.fixture(scope="module")
def tracked():
    return track(SHORT)


@dataclass(frozen=True, repr=False)
class Example(Result):
    gain: float
    values: np.ndarray
    by_name: dict[str, int]
    many: tuple[int, ...]


VALUES = np.array([[0.0, 4.0, np.nan], [-1.5, 1.0, 2.0]])
EXAMPLE = Example(1.0 / 3.0, VALUES, dict.fromkeys("abcd", 1), tuple(range(100)))


def test_repr_names_each_field_in_a_few_words():
    assert repr(EXAMPLE) == (
        "Example(gain=0.333333, values=array(2, 3) -1.5 … 4, by_name={a, b, c, … 4 names}, "
        "many=100 × int)"
    )


def test_notebooks_get_a_table_with_a_row_a_field():
    html = EXAMPLE._repr_html_()
    assert html.count("<tr>") == 4
    assert "left'>gain</th><td>0.333333</td>" in html
    escaped = Example(0.0, np.zeros(1), {"<b>": 1}, ())
    assert "<b>" not in escaped._repr_html_()
    assert "<img" not in html


def test_the_table_has_a_row_for_each_array_of_a_dictionary(tracked):
    html = tracked.run._repr_html_()
    for name, values in tracked.run.columns.items():
        row = f">{name}</th><td>array({values.size},) {values.min():.4g} … {values.max():.4g}</td>"
        assert row in html


@pytest.mark.parametrize("values", [np.ones(2) * 1j, np.array(["a"]), np.zeros(0), [np.nan]])
def test_arrays_without_real_numbers_have_no_range(values):
    values = np.asarray(values)
    assert short(values) == f"array{values.shape}"


class Drawn(Result):
    def __str__(self):
        return "gain < 2\nphase"

    def plot(self, ax=None):
        ax = axes_or_new(ax, 2, 1, caption='a "line"')
        ax[0].plot([0.0, 1.0])
        return ax


def test_notebooks_get_text_and_picture():
    before = plt.get_fignums()
    html = Drawn()._repr_html_()
    assert ">gain &lt; 2\nphase</pre>" in html
    alt, data = re.search(r'<img alt="(.*?)" src="data:image/png;base64,(.*?)">', html).groups()
    assert alt == "a &quot;line&quot;"
    picture = imread(io.BytesIO(base64.b64decode(data)))
    assert np.ptp(picture[..., :3]) > 0.5
    assert plt.get_fignums() == before  # none is left that a notebook would show again


@pytest.mark.parametrize(("count", "shown"), [(3, "{a, b, c}"), (4, "{a, b, c, … 4 names}")])
def test_the_first_three_names_of_a_mapping_are_shown(count, shown):
    assert short(dict.fromkeys("abcd"[:count], 0.0)) == shown


def test_results_of_a_run_are_short(tracked):
    assert len(repr(tracked.run)) < 200
    assert len(repr(tracked)) < 400
    assert "max_error_deg=" in repr(tracked.metrics)
    assert short(tracked) == "TrackingResult(…)"


FUNCTIONS = dict(inspect.getmembers(kneexo.analysis, inspect.isfunction))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_signature_prints_a_whole_scenario(name):
    assert len(str(inspect.signature(FUNCTIONS[name]))) < 700


# ------------------------------------------------------------------------- data frames


def test_a_run_becomes_a_frame_over_time_with_units(tracked):
    for result in (tracked.run, tracked):
        frame = result.to_dataframe()
        assert frame.index.name == "time_s"
        assert {"knee_angle_rad", "load_pressure_pa"} <= set(frame)
        np.testing.assert_array_equal(frame.index, tracked.run.time_s)
        np.testing.assert_array_equal(frame["knee_angle_rad"], tracked.run["knee_angle_rad"])
    np.testing.assert_array_equal(frame["error_deg"], tracked.error_deg)


def test_a_frequency_response_becomes_a_frame():
    response = np.array([[1.0, 0.5j], [1.0, 0.7j]])
    result = FrequencyResponse(
        np.array([1.0, 2.0]), response, 1.5, 45.0, (), Scenario(), SinestreamSettings()
    )
    frame = result.to_dataframe()
    assert frame.index.name == "frequency_hz"
    assert list(frame.index) == [1.0, 2.0]
    assert list(frame["gain"]) == pytest.approx([1.0, 0.6])
    assert list(frame["gain_2"]) == pytest.approx([1.0, 0.7])
    assert list(frame["phase_1_deg"]) == pytest.approx(list(frame["phase_deg"]))


@pytest.mark.parametrize("make", [fit_polynomials, lambda: walking_demand(Scenario())])
def test_columns_end_in_their_unit(make):
    frame = make().to_dataframe()
    assert all(column.dtype == float for _, column in frame.items())
    units = ("_deg", "_mm", "_percent", "_s", "_m_s2", "_n", "_pa", "_m3_s", "_rad_s2", "_w")
    names = [frame.index.name, *frame]
    assert [name for name in names if not name.endswith((*units, "_rad_s"))] == []


def test_a_missing_pandas_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(PackageError, match=r"^to_dataframe needs pandas: pip install pandas$"):
        data_frame({"a": [1]})


# ------------------------------------------------------------------------- state spaces


def test_state_spaces_have_names():
    plant = linearize_plant(outputs=("knee_angle", "load_pressure")).to_control()
    assert plant.input_labels == ["motor_speed_command_rad_s"]
    assert plant.output_labels == ["knee_angle_rad", "load_pressure_pa"]
    assert plant.state_labels == ["motor.x[0]", "cylinder.x[0]", "cylinder.x[1]", "cylinder.x[2]"]
    loop = linearize_loop(Scenario()).to_control()
    assert loop.input_labels == ["motor_speed_command_rad_s"]
    assert loop.output_labels == ["returned_command_rad_s"]
    assert loop.state_labels[0] == "plant/motor.x[0]"
    assert loop.state_labels[-1].startswith("controller/")


# --------------------------------------------------------------------------- parameters


def test_parameters_show_what_differs_from_the_defaults():
    assert repr(Scenario()) == str(Scenario()) == "Scenario()"
    scenario = Scenario(plant=PlantParameters(cylinder=CylinderParameters(mass_kg=1.8), linkage=G2))
    shown = "Scenario(plant=PlantParameters(cylinder=CylinderParameters(mass_kg=1.8), linkage=G2))"
    assert repr(scenario) == shown
    assert eval(shown) == scenario
    assert repr(LinkageParameters(a_3_m=0.018)) == "LinkageParameters(a_3_m=0.018)"
    assert repr(UNCERTAINTY) == f"UncertaintySet({len(UNCERTAINTY.values)} values)"


def test_long_samples_are_shortened():
    times = tuple(float(n) for n in range(9))
    shown = repr(SampledReference(times_s=times, angles_deg=times))
    assert "times_s=(0.0, 1.0, …, 8.0: 9 values)" in shown


def test_what_rounding_leaves_of_zero_is_shown_as_zero():
    assert str(linearize_plant().operating_point) == (
        "knee at 40 deg: motor 0 rpm, load pressure 0 MPa, rod force 0 N"
    )
