"""Faults and protection of a page as data; tests/page/web/test_playground_faults.py runs them."""

import re

import pytest

from kneexo.errors import ParameterError
from kneexo.page.faults import (
    IDLE_S,
    direct_maps,
    fault_data,
    is_protected,
    sizes_of,
    with_thrown_faults,
)
from kneexo.page.thrown_faults import RESET, THROWN_FAULTS, Throw, throw_of
from kneexo.parameters import FaultParameters, Scenario
from kneexo.parameters.device.plant import RPM
from kneexo.parameters.device.safety_states import TRANSITIONS

PROTECTED, LEG = map(Scenario.preset, ("protected", "leg"))
RESET_FAULT = {"place": "reset", "kind": "value", "size": 1.0, "start_s": 8.0}
LEAK = "plant.cylinder.leakage_m3_per_s_pa"


def with_faults(*faults, base=PROTECTED):
    return base.changed({"faults": tuple(FaultParameters(**fault) for fault in faults)})


def test_a_page_shows_faults_of_a_scenario_with_faults_or_protection():
    assert is_protected(PROTECTED)
    assert not is_protected(LEG)
    assert is_protected(with_faults({"kind": "frozen"}, base=LEG))


@pytest.mark.parametrize(
    "faults",
    [
        [{"kind": "noise", "size": 1.0}],
        [{"kind": "frozen"}, {"kind": "offset", "size": 1.0}],
        [{"kind": "frozen", "signal": "knee_angle_rad", "above": 1.0}],
        [RESET_FAULT | {"start_s": start_s, "duration_s": 0.5} for start_s in (1.0, 2.0)],
    ],
)
def test_faults_that_a_page_cannot_throw_are_refused(faults):
    with pytest.raises(ParameterError, match=r"^faults: a page throws one .* encoder frozen,"):
        is_protected(with_faults(*faults))


def test_protection_with_a_wearer_is_refused():
    worn = Scenario.preset("wearer").changed({"protection": {}})
    with pytest.raises(ParameterError, match=r"^protection: a page with a wearer cannot show"):
        is_protected(worn)


def test_the_fault_of_a_scenario_is_the_one_that_the_page_shows_first():
    fault = {"place": LEAK, "kind": "value", "size": 3e-9, "start_s": 4.0, "duration_s": 2.0}
    scenario = with_faults(fault, RESET_FAULT)
    assert throw_of(scenario) == Throw("piston_leak", 3e-9, 4.0, 2.0, 8.0)
    data = fault_data(scenario)
    assert (data["fault"], data["protection"]) == ("piston_leak", "on")
    assert fault_data(with_faults(fault, base=LEG))["protection"] == "off"
    assert [quantity["value"] for quantity in data["quantities"]] == [4.0, 2.0, 8.0]
    size = data["choices"]["piston_leak"]["quantity"]
    assert (size["value"], size["low"], size["high"]) == (3e-9, 3e-12, 3e-9)
    assert size["shown_factor"] * 1e-10 == pytest.approx(10.0)  # cm³/(s·bar)
    assert throw_of(PROTECTED) == Throw()
    starts = [fault_data(PROTECTED)["quantities"][0]["value"]]
    starts.append(fault_data(PROTECTED.changed({"simulation.duration_s": 2.0}))["quantities"][0])
    assert starts[0] == 7.5
    assert starts[1]["value"] == 0.5


def test_a_plant_without_motor_has_no_faults_of_the_motor():
    without = {"motor_weak", "supply_sag"}
    assert set(fault_data(PROTECTED)["choices"]) == set(THROWN_FAULTS)
    assert set(fault_data(LEG)["choices"]) == set(THROWN_FAULTS) - without


@pytest.mark.parametrize(
    ("safe_state", "last"), [("zero_speed", "stopped"), ("bypass", "released")]
)
def test_the_machine_of_a_page_is_the_table(safe_state, last):
    changes = {"plant.bypass": {}, "protection.safe_state": safe_state}
    data = fault_data(PROTECTED.changed(changes))
    assert list(data["states"]) == ["starting", "operating", "stopping", last]
    unreached = {"stopped", "released"} - {last}
    assert {tuple(row) for row in data["transitions"]} == {
        (row.state, row.event, row.next_state)
        for row in TRANSITIONS
        if row.release in (None, safe_state != "zero_speed") and row.state not in unreached
    }
    causes = dict(zip(data["reasons"], data["causes"], strict=True))
    assert (causes["none"], causes["speed"], causes["start"]) == ("", "disobeyed", "overdue")


def test_all_faults_are_in_one_loop_with_the_sizes_of_the_page():
    sizes = {quantity["name"]: quantity["value"] for quantity in sizes_of(fault_data(PROTECTED))}
    scenario = with_thrown_faults(PROTECTED, {**sizes, "fault.supply_sag.size": 3.0, LEAK: 1e-12})
    found = dict(zip(THROWN_FAULTS, scenario.faults, strict=True))
    assert all((fault.start_s, fault.duration_s) == (0.0, IDLE_S) for fault in found.values())
    assert found["supply_sag"].size == 3.0
    assert found["encoder_jump"].size == 5.0
    assert found[RESET].place == "reset"
    assert scenario.plant.cylinder.leakage_m3_per_s_pa == 1e-12


def test_starts_durations_and_thresholds_have_formulas_by_name():
    numbers = {name: number for number, name in enumerate(THROWN_FAULTS)}
    columns = [
        "controller/detectors.speed_threshold",
        "controller/detectors.speed_s",
        f"fault_{numbers['encoder_jump']}.start_s",
        f"fault_{numbers['supply_sag']}_motor.duration_s",
        f"fault_{numbers['supply_sag']}_motor.offset_0",
    ]
    maps = dict(direct_maps(PROTECTED, columns))
    names = {index: (formula["of"], formula["factors"]) for index, formula in maps.items()}
    assert names == {
        0: (["protection.speed_rpm"], [RPM]),
        2: (["fault.encoder_jump.start_s"], [1.0]),
        3: (["fault.supply_sag.duration_s"], [1.0]),
    }
    data = fault_data(PROTECTED)
    assert data["idle"]["fault.reset.start_s"] == IDLE_S
    assert data["idle"]["protection.speed_rpm"] == 400.0
    assert min(data["off"].values()) > 1e8
    assert all(
        re.fullmatch(r"fault\.\w+", name)
        for name in (quantity["name"] for quantity in data["quantities"])
    )
