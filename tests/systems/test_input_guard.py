"""The guard of a controller's inputs: what is bad, what takes its place, and who counts it."""

import math

import pytest

from diagramc.testing import check_leaf
from kneexo.parameters.device.safety_states import DETECTORS
from kneexo.systems import InputGuard

T, SPAN = 0.002, (0.1, 1.5)
GOOD = {
    "knee_reference": [0.5, 1.0, 2.0, 3.0],
    "measured_force": [100.0, 0.004],
    "biological_moment": [7.0],
    "motor_speed": [50.0],
}
# For each input: what takes its place, who counts it, and the largest values.
TABLE = {
    "knee_reference": ([0.5, 0, 0, 0], "following", [1.5, *(1.4 / T**n for n in (1, 2, 3))]),
    "measured_force": ([100.0, 0.004], "load_cell", [1e6, 2e6 / T]),
    "biological_moment": ([0.0], "", [1e3]),
    "motor_speed": ([50.0], "flow", [1e6 * 2 * math.pi / 60]),
}
ELEMENTS = [(name, n, top) for name, row in TABLE.items() for n, top in enumerate(row[2])]
NONE = {"bad": [0.0] * 6}


def started(**inputs):
    """A function that fixes inputs of a guard, updates it, and returns the outputs before."""
    system = InputGuard(SPAN, T)
    context = system.CreateDefaultContext()

    def sample(**inputs):
        for name, values in inputs.items():
            system.GetInputPort(name).FixValue(context, values)
        found = {n: system.GetOutputPort(n).Eval(context).tolist() for n in (*GOOD, "bad")}
        update = system.EvalUniquePeriodicDiscreteUpdate(context)
        context.get_mutable_discrete_state().SetFrom(update)
        return found

    sample(knee_angle=[0.3], **GOOD | inputs)
    system.ExecuteInitializationEvents(context)
    return sample


@pytest.mark.parametrize(("name", "element", "largest"), ELEMENTS)
def test_a_bad_element_makes_its_input_the_last_good_one(name, element, largest):
    sample, (held, detector, _) = started(), TABLE[name]
    lowest = SPAN[0] if (name, element) == ("knee_reference", 0) else -largest
    more = 1e-9 * abs(lowest)
    expected = GOOD | {name: held, "bad": [float(d == detector) for d in DETECTORS]}
    for value in (math.nan, math.inf, -math.inf, largest * (1 + 1e-9), lowest - more):
        values = [*GOOD[name][:element], value, *GOOD[name][element + 1 :]]
        assert sample(**{name: values}) == expected
    for value in (largest * (1 - 1e-9), lowest + more):
        values[element] = value
        assert sample(**{name: values}) == GOOD | {name: values} | NONE


def test_before_the_first_good_values_the_knee_stays_where_it_was_at_the_start():
    zeros = {name: [0.0] * len(values) for name, values in GOOD.items()}
    sample = started(**{name: [math.nan] * len(values) for name, values in GOOD.items()})
    for angle in (0.3, 0.9):
        found = sample(knee_angle=[angle])
        assert found == zeros | {"knee_reference": [0.3, 0, 0, 0], "bad": [0, 0, 1, 1, 0, 1]}
    assert sample(**GOOD) == GOOD | NONE


def test_scalars_dependencies_and_parameters():
    system = InputGuard(SPAN, T)
    inputs = {n: [(0.9 * x, 1.1 * x) for x in values] for n, values in GOOD.items()}
    inputs |= {"knee_angle": [(0.2, 0.4)]}
    check_leaf(system, inputs | {"discrete_state": (0.9, 1.1)})
