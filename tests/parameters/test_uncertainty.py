"""Uncertain values: their intervals and options, their files, and one line for each fault."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from kneexo.errors import ParameterError, ScenarioError
from kneexo.parameters import (
    LINKAGES,
    UNCERTAIN_KNEE,
    UNCERTAINTY,
    CuffParameters,
    FullCylinderParameters,
    PlantParameters,
    Scenario,
    Uncertainty,
    UncertaintySet,
)
from kneexo.parameters.paths import changed, has_path
from kneexo.parameters.presets import PRESETS
from kneexo.parameters.scenario_file import load_uncertainty
from kneexo.parameters.uncertainty import applicable, draw, options_of, realize
from kneexo.studies.paper import PID_TUNED


@pytest.fixture
def load(tmp_path):
    def read(text, *scenario):
        path = tmp_path / "set.yaml"
        path.write_text(text, encoding="utf-8")
        return load_uncertainty(path, *scenario)

    return read


def test_a_file_gives_its_set(load):
    uncertainty = load(
        "# what may be\n"
        "plant.cylinder.mass_kg: {low: 1.4, high: 1.8, source: Table 2}\n"
        "plant.pump.lag_s:\n"
        "  low: 5e-3\n"
        "  high: 0.02\n"
        "  scale: log\n"
        "plant.linkage: {options: [G1, G3], known: true}\n"
        "plant.full_order: {options: [null, {}, {coulomb_friction_n: 40}]}\n"
    )
    assert uncertainty == UncertaintySet(
        values={
            "plant.cylinder.mass_kg": Uncertainty(low=1.4, high=1.8, source="Table 2"),
            "plant.pump.lag_s": Uncertainty(low=5e-3, high=0.02, scale="log"),
            "plant.linkage": Uncertainty(options=("G1", "G3"), known=True),
            "plant.full_order": Uncertainty(options=(None, {}, {"coulomb_friction_n": 40})),
        }
    )


def test_values_that_the_scenario_does_not_have_are_kept(load):
    text = (
        "plant.load.segment_mass_kg: {low: 0, high: 3}\nplant.cylinder.mass_kg: {low: 1, high: 2}"
    )
    uncertainty = load(text, Scenario())
    assert list(uncertainty.values) == ["plant.load.segment_mass_kg", "plant.cylinder.mass_kg"]
    present, absent = applicable(Scenario(), uncertainty)
    assert list(present.values) == ["plant.cylinder.mass_kg"]
    assert absent == ("plant.load.segment_mass_kg",)
    assert applicable(UNCERTAIN_KNEE, uncertainty) == (uncertainty, ())


def test_another_controller_does_not_make_a_path_unknown(load):
    uncertainty = load("controller.phi_m_s2: {low: 1, high: 4}", Scenario(controller=PID_TUNED))
    assert list(uncertainty.values) == ["controller.phi_m_s2"]


def test_the_default_set_applies_to_the_default_scenario():
    assert applicable(UNCERTAIN_KNEE, UNCERTAINTY) == (UNCERTAINTY, ())


def test_the_default_set_keeps_the_values_of_another_knee():
    """Its ranges are about the paper's knee: they would turn a larger knee into the paper's."""
    values = {
        "plant.linkage.a_2_m": 0.0335,
        "plant.cylinder.bore_m": 0.025,
        "plant.full_order": {"coulomb_friction_n": 60.0},
    }
    larger = changed(UNCERTAIN_KNEE, values)
    present, absent = applicable(larger, UNCERTAINTY)
    assert absent == ("plant.cylinder.bore_m", "plant.linkage", "plant.full_order")
    assert {**present.values, **{path: UNCERTAINTY.values[path] for path in absent}} == dict(
        UNCERTAINTY.values
    )
    for values in draw(present, 20, seed=1):
        plant = realize(larger, present, values).plant
        assert plant.linkage == larger.plant.linkage
        assert plant.cylinder.bore_m == 0.025
    # A set of the user's own means what it says.
    chosen = UncertaintySet(values={"plant.linkage": UNCERTAINTY.values["plant.linkage"]})
    assert applicable(larger, chosen) == (chosen, ())


@pytest.mark.parametrize("preset", PRESETS)
def test_the_default_set_varies_every_value_of_a_preset(preset):
    scenario = Scenario.preset(preset)
    _, absent = applicable(scenario, UNCERTAINTY)
    assert all(not has_path(scenario, path) for path in absent)


def test_the_default_set_leaves_out_options_that_the_scenario_refuses():
    """A plant with a bypass has no reduced order; a set of the user's is refused."""
    scenario = Scenario.preset("leg").changed({"plant.bypass": {}})
    kept, others = applicable(scenario, UNCERTAINTY)
    assert others == ()
    assert kept.values["plant.full_order"].options == ({}, {"coulomb_friction_n": 40.0})
    mine = UncertaintySet(values={"plant.full_order": Uncertainty(options=(None, {}))})
    with pytest.raises(ParameterError, match="bypass: must be left out of the reduced order"):
        applicable(scenario, mine)


def test_a_wearer_adds_cuff_and_load_cell_to_the_default_set_alone():
    """Ranges from half to twice the default stiffness, and of 0.5 % of the load cell's range."""
    wearer = Scenario.preset("wearer")
    present, _ = applicable(wearer, UNCERTAINTY)
    cuff = present.values["wearer.cuff.stiffness_n_m_per_rad"]
    offset = present.values["load_cell.offset_n"]
    stiffness = CuffParameters().stiffness_n_m_per_rad
    assert (cuff.low, cuff.high) == (stiffness / 2, stiffness * 2)
    assert (offset.low, offset.high) == pytest.approx(
        (-0.005 * wearer.load_cell.range_n, 0.005 * wearer.load_cell.range_n)
    )
    low = realize(wearer, present, {path: present.values[path].at(0.0) for path in present.values})
    assert (low.wearer.cuff.stiffness_n_m_per_rad, low.load_cell.offset_n) == (750.0, -10.0)
    chosen = UncertaintySet(values={"plant.linkage": UNCERTAINTY.values["plant.linkage"]})
    assert applicable(wearer, chosen) == (chosen, ())


FAULTS = {
    "": (None, "has no uncertain values"),
    "# nothing\n": (None, "has no uncertain values"),
    "- 1": (1, "the top level must be a mapping, not a list"),
    "plant.cylinder.mass_kg: 1.6": (
        1,
        r"plant.cylinder.mass_kg: must be {low: …, high: …} or {options: \[…\]}",
    ),
    "\n\nplant.cylinder.mas_kg: {low: 1, high: 2}": (3, "plant.cylinder.mas_kg: unknown name"),
    "plant.cylinder.mass_kg: {low: 1, high: 2}\nfoo: {low: 1, high: 2}": (2, "foo: unknown name"),
    "plant.cylinder.mass_kg.x: {low: 1, high: 2}": (1, "mass_kg is a single value"),
    "plant.cylinder.mass_kg:\n  low: 1.4\n  hihg: 1.8": (
        3,
        r"mass_kg\.hihg: unknown name; did you mean high\?",
    ),
    "plant.cylinder.mass_kg:\n  low: a\n  high: 1": (2, "mass_kg.low = 'a': must be a number"),
    "plant.cylinder.mass_kg: {low: 1.4}": (1, "mass_kg: must have either low and high, or options"),
    "plant.cylinder.mass_kg: {low: 1, options: [1]}": (1, "must have either low and high, or"),
    "plant.cylinder.mass_kg: {low: 1, high: 2, options: [1]}": (1, "must have either low and"),
    "plant.cylinder.mass_kg: {low: 2, high: 2}": (1, "mass_kg: low = 2 must be below high = 2"),
    "plant.cylinder.mass_kg: {low: 1, high: 2, scale: lin}": (1, r"did you mean linear\?"),
    "plant: {cylinder: {mass_kg: {low: 1, high: 2}}}": (1, "plant: must be a dotted path, such as"),
    "plant.cylinder.mass_kg: {low: 2, high: 1}": (1, "mass_kg: low = 2 must be below high = 1"),
    "plant.cylinder.mass_kg: {low: 1, high: .inf}": (1, "mass_kg.high = inf is out of range"),
    "plant.cylinder.mass_kg: {low: -1, high: 2}": (1, "mass_kg = -1 kg is out of range: .*kg"),
    "plant.cylinder.mass_kg: {low: 1, high: 2000}": (1, "mass_kg = 2000 kg is out of range"),
    "bus.latency_samples: {options: [0, 11]}": (
        1,
        "bus.latency_samples = 11 samples is out of range",
    ),
    "plant.pump.lag_s: {low: 0, high: 1, scale: log}": (1, "lag_s: low = 0 must be > 0"),
    "plant.linkage: {options: [G1, G9]}": (1, "plant.linkage = 'G9': must be G1, G2"),
    "plant.linkage: {options: []}": (1, "must have either low and high, or options"),
    "bus.latency_samples: {options: [0], known: true}": (1, "known is for values of the plant"),
    "plant.pump: {options: [{}]}\nplant.pump.lag_s: {low: 0.01, high: 0.02}": (2, "lies within"),
    "plant.pump.lag_s: {low: 1, high: 2}\nplant.pump.lag_s: {low: 1, high: 2}": (2, "duplicate"),
    "plant.pump.lag_s: {low: 1": (1, "YAML syntax"),
}


@pytest.mark.parametrize("text", FAULTS)
def test_a_fault_is_one_line_with_file_line_and_path(load, text):
    line, message = FAULTS[text]
    where = r"set\.yaml" if line is None else rf"set\.yaml:{line}"
    with pytest.raises(ScenarioError, match=rf"\A[^\n]*{where}: [^\n]*{message}[^\n]*\Z"):
        load(text)


@given(share=st.floats(0.0, 1.0))
def test_an_interval_spans_its_ends_on_its_scale(share: float) -> None:
    linear = Uncertainty(low=-2.0, high=6.0)
    assert linear.at(share) == pytest.approx(-2.0 + 8.0 * share, abs=1e-12)
    log = Uncertainty(low=1e-14, high=1e-12, scale="log")
    assert math.log10(log.at(share)) == pytest.approx(-14.0 + 2.0 * share, abs=1e-12)
    assert (log.at(0.0), log.at(1.0)) == (1e-14, 1e-12)  # exactly
    assert Uncertainty(options=("a", "b", "c")).at(share) == "abc"[min(int(3 * share), 2)]


def test_an_empty_uncertainty_set_is_refused() -> None:
    with pytest.raises(ParameterError, match="values"):
        UncertaintySet(values={})


@pytest.mark.parametrize("path", UNCERTAINTY.values)
def test_every_uncertain_value_has_a_source_and_fits_the_scenario(path: str) -> None:
    uncertain = UNCERTAINTY.values[path]
    assert uncertain.source != "given by the user"
    for share in (0.0, 0.5, 1.0):
        changed(UNCERTAIN_KNEE, {path: uncertain.at(share)})


# ------------------------------------------------------------------- draws and realizations


def test_the_controller_keeps_its_beliefs_but_for_what_it_knows():
    values = {
        "plant.cylinder.mass_kg": 1.8,
        "plant.linkage": "G3",
        "plant.full_order": {"coulomb_friction_n": 40.0},
        "bus.latency_samples": 2,
    }
    realized = realize(UNCERTAIN_KNEE, UNCERTAINTY, values)
    assert realized.plant.cylinder.mass_kg == 1.8
    assert realized.plant.linkage == LINKAGES["G3"]
    assert realized.plant.full_order == FullCylinderParameters(coulomb_friction_n=40.0)
    assert realized.bus.latency_samples == 2
    believed = UNCERTAIN_KNEE.plant.model_copy(update={"linkage": LINKAGES["G3"]})
    assert realized.believed_plant == believed


def test_nothing_changed_is_the_scenario_itself():
    realized = realize(UNCERTAIN_KNEE, UNCERTAINTY, {})
    assert realized == UNCERTAIN_KNEE.model_copy(update={"nominal": UNCERTAIN_KNEE.plant})


def test_a_controller_that_believes_something_else_goes_on_doing_so():
    wrong = UNCERTAIN_KNEE.model_copy(update={"nominal": PlantParameters(ideal_motor=True)})
    values = {"plant.cylinder.mass_kg": 1.7, "plant.linkage": "G2"}
    plant = realize(wrong, UNCERTAINTY, values)
    assert plant.nominal == PlantParameters(ideal_motor=True, linkage=LINKAGES["G2"])


@given(st.integers(0, 30), st.integers(0, 30), st.integers(0, 2**32))
def test_a_sample_does_not_depend_on_how_many_are_drawn(few, more, seed):
    few, more = sorted((few, more))
    assert draw(UNCERTAINTY, more, seed)[:few] == draw(UNCERTAINTY, few, seed)


def test_samples_fill_their_ranges_evenly():
    drawn = draw(UNCERTAINTY, 4000, 1)
    assert drawn != draw(UNCERTAINTY, 4000, 2)
    for path, one in UNCERTAINTY.values.items():
        own = [values[path] for values in drawn]
        if one.options:
            counts = [own.count(option) / 4000 for option in one.options]
            # Six standard deviations of a binomial share.
            assert counts == pytest.approx([1 / 3] * 3, abs=6.0 * math.sqrt(2 / 9 / 4000))
            continue
        x, low, high = np.array(own), one.low, one.high
        if one.scale == "log":
            x, low, high = np.log(x), math.log(low), math.log(high)
        share = (x - low) / (high - low)
        assert share.min() >= 0.0
        assert share.max() <= 1.0
        assert share.mean() == pytest.approx(0.5, abs=6.0 / math.sqrt(12 * 4000))


def test_realized_samples_are_those_of_a_whole_change() -> None:
    for values in draw(UNCERTAINTY, 40, 3):
        known = {"nominal.linkage": values["plant.linkage"]}
        nominal = UNCERTAIN_KNEE.believed_plant
        expected = UNCERTAIN_KNEE.changed({"nominal": nominal, **values, **known})
        ours = realize(UNCERTAIN_KNEE, UNCERTAINTY, values)
        assert ours == expected
        assert ours.model_dump_json() == expected.model_dump_json()


def test_two_scenarios_with_the_same_options_stay_apart() -> None:
    options = UncertaintySet(values={"bus.latency_samples": Uncertainty(options=(0, 1))})
    for offset_m in (0.0, 0.01):
        scenario = Scenario(initial_offset_m=offset_m)
        for latency in (0, 1, 0):
            ours = realize(scenario, options, {"bus.latency_samples": latency})
            assert (ours.initial_offset_m, ours.bus.latency_samples) == (offset_m, latency)


def test_values_that_contradict_each_other_have_the_message_of_a_change() -> None:
    path = "plant.cylinder.bore_m"
    narrow = UncertaintySet(values={path: Uncertainty(low=0.001, high=0.02)})
    with pytest.raises(ParameterError, match=r"rod_diameter_m = 0\.01 m must be below") as caught:
        realize(Scenario(), narrow, {path: 0.005})
    with pytest.raises(ParameterError) as expected:
        Scenario().changed({path: 0.005})
    assert str(caught.value) == str(expected.value)


def test_options_that_are_no_plain_data() -> None:
    linkages = UncertaintySet(
        values={"plant.linkage": Uncertainty(options=tuple(LINKAGES.values()))}
    )
    for linkage in LINKAGES.values():
        assert realize(Scenario(), linkages, {"plant.linkage": linkage}).plant.linkage == linkage


def test_samples_with_equal_options_have_equal_structures() -> None:
    samples = draw(UNCERTAINTY, 60, 5)
    groups: dict[str, list[Scenario]] = {}
    for values in samples:
        plant = realize(UNCERTAIN_KNEE, UNCERTAINTY, values)
        groups.setdefault(options_of(values), []).append(plant)
    assert 10 < len(groups) <= 27
    for same in groups.values():
        assert len({(s.bus, s.plant.linkage, s.nominal) for s in same}) == 1
        assert len({s.plant.full_order for s in same}) == 1
