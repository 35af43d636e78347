"""Presets: what each one adds, how a file overrides it, and what its physics are by hand."""

import math
import re
from pathlib import Path

import pytest

from kneexo.analysis import track
from kneexo.analysis.wearer.coupling import coupled_loop
from kneexo.parameters import Cia402Parameters, KneeLoadParameters, NoBus, NoLoad, Scenario
from kneexo.parameters.criteria import SOUND_DISK_MARGIN
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import PRESETS, with_preset
from kneexo.parameters.scenario_file import dump_scenario, load_scenario

PAPER, BENCH, LEG, WEARER, PROTECTED = map(Scenario.preset, PRESETS)

MEAN_AREA_M2 = math.pi / 4.0 * (0.020**2 - 0.010**2 / 2.0)
"""Mean of Table 3's piston and ring."""


@pytest.fixture
def load(tmp_path):
    def read(text, preset=None):
        path = tmp_path / "scenario.yaml"
        path.write_text(text, encoding="utf-8")
        return load_scenario(path, preset)

    return read


def test_each_preset_adds_parts_to_the_one_before():
    assert list(PRESETS) == ["paper", "bench", "leg", "wearer", "protected"]
    assert Scenario() == PAPER
    assert (PAPER.plant.load, PAPER.plant.full_order, PAPER.bus) == (NoLoad(), None, NoBus())
    assert (BENCH.plant.load, BENCH.bus) == (KneeLoadParameters(), Cia402Parameters())
    assert changed(PAPER, {"plant.load": {"kind": "knee"}, "bus": {"kind": "cia402"}}) == BENCH
    assert changed(BENCH, {"plant.full_order": {"coulomb_friction_n": 40.0}}) == LEG
    gains = {"proportional_rad_s_per_n": 3, "integral_rad_s2_per_n": 10, "speed_feedforward": 0.3}
    torque = {"kind": "torque", **gains}
    assert changed(LEG, {"wearer": "leg", "controller": torque}) == WEARER
    parts = {"plant.motor": {}, "plant.end_stops": {}}
    parts |= {"protection": {"safe_state": "dynamic_brake"}}
    assert changed(LEG, parts) == PROTECTED
    # The pump leaks in all of them; the controller knows the plant.
    for scenario in (PAPER, BENCH, LEG, WEARER, PROTECTED):
        assert scenario.plant.pump.leakage_m3_per_s_pa == 2e-13
        assert scenario.nominal is None


def test_a_file_starts_from_its_preset_and_overrides_it(load):
    assert load("preset: leg") == LEG
    assert load("preset: bench\nplant: {load: {segment_mass_kg: 3.2}}") == changed(
        BENCH, {"plant.load.segment_mass_kg": 3.2}
    )
    heavy = load("preset: leg\nplant: {full_order: {entrained_air: 0.01}, linkage: G3}")
    assert heavy == changed(LEG, {"plant.full_order.entrained_air": 0.01, "plant.linkage": "G3"})
    # Another kind, or no value, takes the place of the whole part.
    plain = load("preset: leg\nplant: {load: {kind: none}, full_order: null}\nbus: {kind: none}")
    assert plain == PAPER
    assert load("preset: bench\nbus: {latency_samples: 2}").bus == Cia402Parameters(
        latency_samples=2
    )


def test_the_argument_takes_the_place_of_the_entry(load):
    text = "preset: bench\ncontroller: {kind: pid}"
    assert load(text, "leg") == changed(LEG, {"controller": {"kind": "pid"}})
    assert load("plant: {cylinder: {mass_kg: 1.7}}", "bench") == changed(
        BENCH, {"plant.cylinder.mass_kg": 1.7}
    )


@pytest.mark.parametrize("name", ["bench", "leg", "wearer", "protected"])
def test_a_written_scenario_is_complete_without_its_preset(load, name):
    text = dump_scenario(Scenario.preset(name))
    assert "preset" not in text
    assert load(text) == Scenario.preset(name)
    assert load(text, "paper") == Scenario.preset(name)


def test_values_of_one_scenario_do_not_reach_the_next():
    values = with_preset("leg", {"plant": {"full_order": {"dead_volume_m3": 1e-5}}})
    values["plant"]["load"]["segment_mass_kg"] = 9.0
    assert Scenario.preset("leg") == LEG


def test_the_friction_is_four_percent_of_the_rated_pressure():
    """The reason that stands beside `SEAL_FRICTION_N`."""
    friction_pa = LEG.plant.full_order.coulomb_friction_n / MEAN_AREA_M2
    assert friction_pa == pytest.approx(0.146e6, rel=5e-3)
    assert friction_pa / LEG.plant.cylinder.pressure_rating_pa == pytest.approx(0.04, rel=0.05)


def test_the_areas_of_the_chambers_make_the_error_of_leg():
    """The paper's plant tracks ten times as well: it has one area in both directions."""
    leg, paper = (
        track(changed(scenario, {"simulation.duration_s": 20.0})).metrics.max_error_deg
        for scenario in (LEG, PAPER)
    )
    # docs/model_error.md: e = |1 − A_i/Ā| |ẋ| ω̂²/(λ² k/Φ), largest where the knee is fastest.
    stiffness = 4.0 * 17_200e5 * MEAN_AREA_M2**2 / 41_233e-9 / math.sqrt(1.4 * 1.8)
    slope = math.sqrt(1.8 / 1.4) * 2.8e5 / 3.2
    rate = math.radians(30.0) * 2.0 * math.pi * 0.1
    assert leg == pytest.approx(math.degrees(rate / 7.0 * stiffness / (20.0**2 * slope)), rel=0.1)
    assert leg == pytest.approx(0.55, abs=0.005)
    assert paper == pytest.approx(0.047, abs=0.002)


@pytest.mark.slow
def test_the_knee_with_a_wearer_is_sound_at_each_angle_and_with_the_default_gains_it_is_not():
    default = changed(WEARER, {"controller": {"kind": "torque"}})
    margins, without = (
        [coupled_loop(scenario, angle).margins().disk_margin for angle in (5, 30, 50, 70)]
        for scenario in (WEARER, default)
    )
    assert min(margins) >= SOUND_DISK_MARGIN
    assert min(without) == pytest.approx(0.27, abs=0.01)


def test_a_file_can_change_wearer_and_controller_of_the_preset(load):
    text = "preset: wearer\nwearer: {motion: active}\ncontroller: {mode: impedance}"
    expected = {"wearer.motion": "active", "controller.mode": "impedance"}
    assert load(text) == changed(WEARER, expected)
    assert load("preset: wearer\nwearer: none\ncontroller: smc") == LEG


def test_a_word_for_what_a_preset_has_keeps_it(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("preset: leg\nplant: {load: knee, full_order: true}\nbus: can\n")
    assert load_scenario(path) == Scenario.preset("leg")
    path.write_text("preset: leg\nplant: {load: none, full_order: false}\nbus: none\n")
    assert load_scenario(path) == Scenario()


@pytest.mark.slow
@pytest.mark.parametrize("name", PRESETS)
def test_the_table_of_the_presets_has_their_numbers(name):
    page = Path(__file__).parents[2] / "docs" / "scenario_files.md"
    row, *_ = re.findall(rf"^\| `{name}` \| .*$", page.read_text(encoding="utf-8"), re.MULTILINE)
    written = [float(cell.split()[0].rstrip("°")) for cell in row.strip("| ").split(" | ")[2:]]
    run = track(Scenario.preset(name))
    m = run.metrics
    computed = [m.max_error_deg, m.peak_pressure_mpa, m.peak_shaft_power_w]
    if name == "wearer":
        torque = run.verdict.interaction
        felt = re.search(r"feels ([\d.]+) N·m rms, at most ([\d.]+) N·m", page.read_text("utf-8"))
        written += map(float, felt.groups())
        computed += [torque.rms_torque_n_m, torque.peak_torque_n_m]
    # Two digits are written; without load the mode of the oil makes pressure and power.
    assert written == pytest.approx(computed, rel=0.06)
