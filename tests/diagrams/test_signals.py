"""Tables of the signals of the closed loop against its diagrams."""

import pytest

from kneexo.diagrams import make_closed_loop, make_controller, make_plant
from kneexo.diagrams.signals import (
    CONTROLLER_SIGNALS,
    OPTIONAL_OUTPUTS,
    PLANT_OUTPUTS,
    SIGNALS,
    columns,
)
from kneexo.parameters import Scenario

UNITS = ("rad", "rad_s", "rad_s2", "rad_s3", "m", "m_s", "m_s2", "m_s3", "m3_s", "pa", "n", "n_m")
UNITS = (*UNITS, "w", "units", "s", "faults", "opening", "a", "v", "degc", "state", "reason")


def ports(diagram):
    """Size of each output port by its name."""
    indices = range(diagram.num_output_ports())
    outputs = [diagram.get_output_port(i) for i in indices]
    return {port.get_name(): port.size() for port in outputs}


def test_columns_are_unique_and_end_in_a_unit():
    names = columns(tuple(SIGNALS))
    assert len(set(names)) == len(names)
    assert all(name.endswith(tuple(f"_{unit}" for unit in UNITS)) for name in names)


def test_columns_keep_the_order_of_the_signals():
    assert columns(("icr", "knee_angle")) == ("icr_x_m", "icr_y_m", "knee_angle_rad")
    assert columns(()) == ()


def test_an_unknown_signal_is_refused():
    with pytest.raises(KeyError, match="knee_colour"):
        columns(("knee_colour",))


@pytest.mark.parametrize("order", ["reduced", "full"])
def test_each_signal_has_a_column_for_each_element_of_its_port(order):
    scenario = Scenario(plant={"full_order": {}} if order == "full" else {})
    sizes = ports(make_closed_loop(scenario))
    assert sizes
    logged = {name: len(SIGNALS[name]) for name in sizes if name in SIGNALS}
    assert logged == {name: sizes[name] for name in logged}
    _, further = OPTIONAL_OUTPUTS["full_order"]
    assert (set(further) <= set(sizes)) == (order == "full")


def test_signals_of_the_controller_are_its_ports():
    names = set(ports(make_controller(Scenario(protection={}))))
    assert names | set(ports(make_controller(Scenario(controller="torque")))) >= CONTROLLER_SIGNALS


def test_outputs_of_the_plant_are_its_ports():
    names = [name for outputs in PLANT_OUTPUTS.values() for name in outputs]
    assert len(set(names)) == len(names)
    assert set(ports(make_plant(Scenario().plant))) >= set(names)
