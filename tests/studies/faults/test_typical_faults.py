"""The typical faults of a scenario."""

import pytest

from kneexo.diagrams.faults import fault_structure
from kneexo.parameters import Scenario
from kneexo.studies.faults.typical_faults import TYPICAL_FAULTS, typical_faults


@pytest.mark.parametrize("preset", ["paper", "bench", "leg", "wearer"])
def test_a_scenario_accepts_each_of_its_typical_faults(preset):
    scenario = Scenario.preset(preset).changed({"simulation.duration_s": 10.0})
    faults = typical_faults(scenario)
    places = {fault.place for sizes in faults.values() for fault in sizes}
    assert ("load_cell" in places) == scenario.has_load_cell
    full_order = preset in ("leg", "wearer")
    assert ("plant.full_order.relief_pressure_pa" in places) == full_order
    assert ("plant.full_order.entrained_air" in places) == full_order
    assert "plant.cylinder.leakage_m3_per_s_pa" in places
    for sizes in faults.values():
        for fault in sizes:
            fault_structure(scenario.changed({"faults": (fault.changed({"start_s": 5.0}),)}))


def test_the_sizes_of_a_number_are_factors_of_its_healthy_value():
    faults = typical_faults(Scenario().changed({"plant.pump.lag_s": 0.02}))
    assert [fault.size for fault in faults["motor accelerates slowly"]] == [0.04, 0.1, 0.4]
    assert [fault.si_size for fault in faults["scaling of the drive wrong"]] == pytest.approx(
        [10.471975512, 52.35987756, 209.4395102]
    )


def test_a_number_that_is_zero_in_a_healthy_knee_has_sizes_of_its_own():
    torn = typical_faults(Scenario())["seal torn"]
    pump = Scenario().plant.pump.internal_leakage_m3_per_s_pa
    assert [fault.size / pump for fault in torn] == pytest.approx([3.0, 10.0, 100.0])
    leaky = Scenario().changed({"plant.cylinder.leakage_m3_per_s_pa": 1e-12})
    assert "seal torn" not in typical_faults(leaky)


def test_an_encoder_that_does_not_round_has_no_bits():
    faults = typical_faults(Scenario(encoder={"quantized": False}))
    assert "bit of the word disturbed" not in faults


def test_each_cause_stands_once():
    causes = [typical.cause for typical in TYPICAL_FAULTS]
    assert len(set(causes)) == len(causes)
