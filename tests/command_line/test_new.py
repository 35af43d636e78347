"""The file that ``kneexo new`` writes: it loads, runs, and has the numbers of the parameters."""

import math
import re

import numpy as np
import pytest
import yaml

from kneexo.command_line.main import main
from kneexo.geometry.rod_polynomial import controller_polynomial, largest_error_mm
from kneexo.parameters import LINKAGES, Scenario
from kneexo.parameters.paths import value_at
from kneexo.parameters.scenario_file import load_scenario

FOUR_SECTIONS = ("plant.linkage", "plant.cylinder", "plant.load", "controller")


@pytest.fixture
def written(tmp_path, capsys):
    """Path of a file that ``kneexo new`` wrote."""
    path = tmp_path / "mine.yaml"
    assert main(["new", str(path)]) == 0
    capsys.readouterr()
    return path


def test_the_values_are_those_of_the_preset(written):
    scenario, preset = load_scenario(written), Scenario.preset("leg")
    data = yaml.safe_load(written.read_text(encoding="utf-8"))
    sections = {**data["plant"], "controller": data["controller"]}
    assert [len(section) for section in sections.values()] == [14, 5, 3, 4]
    for section in FOUR_SECTIONS:
        for name, value in sections[section.rpartition(".")[2]].items():
            expected = value_at(preset, f"{section}.{name}")
            assert value == value_at(scenario, f"{section}.{name}")
            if name != "kind":  # numbers have six digits
                assert value == pytest.approx(expected, rel=5e-6)
    same = {"reference": preset.reference, "plant": preset.plant}
    assert scenario.model_copy(update=same) == preset


def test_each_number_has_its_unit_and_range(written):
    """Of three values by hand, and a comment for each."""
    lines = written.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100
    assert "    bore_m: 0.02  # m, 0.001…1; Table 3" in lines
    assert "    segment_mass_kg: 1.6  # kg, 0…200; Table 3: shank" in lines
    assert "    phi_rad: -2.9161  # rad, -7…7; knee angle minus angle of the coupler" in lines
    numbers = [line for line in lines if re.match(r" +\w+: -?\d", line)]
    assert len(numbers) == 14 + 5 + 2 + 3
    assert all(re.search(r"  # (\S+, \S+…\S+|-1 or 1); \w", line) for line in numbers)


def test_the_polynomial_is_fitted_to_the_linkage(written):
    scenario = load_scenario(written)
    link = scenario.plant.linkage
    assert link not in LINKAGES.values()  # the angles are rounded
    assert largest_error_mm(link, controller_polynomial(scenario)) < 0.05


def test_the_reference_is_a_period_of_the_default_sine(written):
    reference, sine = load_scenario(written).reference, Scenario().reference
    assert reference.times_s[0] == 0.0
    assert reference.times_s[-1] == pytest.approx(1.0 / sine.frequency_hz, rel=1e-12)
    wave = np.cos(2.0 * math.pi * sine.frequency_hz * np.array(reference.times_s))
    np.testing.assert_allclose(
        reference.angles_deg, sine.mean_deg - sine.amplitude_deg * wave, atol=1e-4
    )


def test_the_controllers_in_comments_load(written):
    code = "def law(rod_extension, rod_reference):\n    return 1e5 * rod_reference[0]\n"
    written.with_suffix(".py").write_text(code)
    text = written.read_text(encoding="utf-8")
    others = re.findall(r"^# (controller: .*)$", text, flags=re.M)
    rest = re.sub(r"^controller:\n(  .*\n)+", "", text, flags=re.M)
    kinds = []
    for other in others:
        written.write_text(f"{rest}{other}\n", encoding="utf-8")
        scenario = load_scenario(written)
        kinds.append(scenario.controller.kind)
        written.write_text(f"{rest}{other}\nwearer: leg\n", encoding="utf-8")
        worn = load_scenario(written)
        assert worn == scenario.model_copy(update={"wearer": Scenario.preset("wearer").wearer})
    assert kinds == ["pid", "torque", "law"]


@pytest.mark.slow  # compiles the equations of the leg
def test_the_file_runs(written, tmp_path, undrawn):
    out = tmp_path / "run"
    assert main(["simulate", str(written), "--out", str(out), "--json"]) == 0
    saved = load_scenario(out / "scenario.yaml")
    assert saved.simulation.duration_s == 10.0
    assert saved.polynomial == controller_polynomial(load_scenario(written))
