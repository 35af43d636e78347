"""The guard of a controller's inputs: what is bad, what takes its place, and who counts it."""

import math

import pytest

from kneexo.parameters.safety_states import DETECTORS
from kneexo.systems import InputGuard
from kneexo.systems.input_guard import SIGNALS

T = 0.002
SPAN = (0.1, 1.5)
GOOD = {
    "knee_reference": [0.5, 1.0, 2.0, 3.0],
    "measured_force": [100.0, 0.004],
    "biological_moment": [7.0],
    "motor_speed": [50.0],
}
HELD = GOOD | {"knee_reference": [0.5, 0.0, 0.0, 0.0], "biological_moment": [0.0]}
LARGEST = {
    "knee_reference": [SPAN[1], *(1.4 / T**n for n in (1, 2, 3))],
    "measured_force": [1e6, 2e6 / T],
    "biological_moment": [1e3],
    "motor_speed": [1e6 * 2 * math.pi / 60],
}


class Run:
    """A guard in a Context."""

    def __init__(self, angle=0.3, **inputs):
        self.system = InputGuard(SPAN, T, tuple(SIGNALS))
        self.context = self.system.CreateDefaultContext()
        self.fix(knee_angle=[angle], **GOOD | inputs)
        self.system.ExecuteInitializationEvents(self.context)

    def fix(self, **inputs):
        for name, values in inputs.items():
            self.system.GetInputPort(name).FixValue(self.context, values)

    def get(self, name):
        return self.system.GetOutputPort(name).Eval(self.context).tolist()

    def update(self):
        update = self.system.EvalUniquePeriodicDiscreteUpdate(self.context)
        self.context.get_mutable_discrete_state().SetFrom(update)


ELEMENTS = [(name, n) for name, values in GOOD.items() for n in range(len(values))]


@pytest.mark.parametrize(("name", "element"), ELEMENTS)
def test_a_bad_element_makes_its_input_the_last_good_one(name, element):
    run, largest = Run(), LARGEST[name][element]
    lowest = SPAN[0] if (name, element) == ("knee_reference", 0) else -largest
    detector = {"knee_reference": "following", "measured_force": "load_cell"}.get(name, "flow")
    for bad in (math.nan, math.inf, -math.inf, largest * (1 + 1e-9), lowest - 1e-9 * abs(lowest)):
        values = list(GOOD[name])
        values[element] = bad
        run.fix(**{name: values})
        assert run.get(name) == HELD[name]
        expected = [float(d == detector and name != "biological_moment") for d in DETECTORS]
        assert run.get("bad") == expected
        run.update()
        for other in GOOD.keys() - {name}:
            assert run.get(other) == GOOD[other]
    for good in (largest * (1 - 1e-9), lowest + 1e-9 * abs(lowest)):
        values[element] = good
        run.fix(**{name: values})
        assert run.get(name) == values
        assert not any(run.get("bad"))


def test_before_the_first_good_values_the_knee_stays_where_it_is():
    bad = {name: [math.nan] * len(values) for name, values in GOOD.items()}
    run = Run(angle=0.7, **bad)
    for _ in range(3):
        assert run.get("knee_reference") == [0.7, 0.0, 0.0, 0.0]
        for name in GOOD.keys() - {"knee_reference"}:
            assert not any(run.get(name))
        run.update()
        run.fix(knee_angle=[0.9])  # only the angle of the start counts
    run.fix(**GOOD)
    assert [run.get(name) for name in GOOD] == list(GOOD.values())


def test_scalars_dependencies_and_parameters(leaf):
    system = InputGuard(SPAN, T, tuple(SIGNALS))
    structure = leaf.structure(system)
    assert structure.discrete == [4]
    feedthrough = {(name, name) for name in GOOD} | {(name, "bad") for name in GOOD}
    assert structure.feedthrough == feedthrough
    inputs = {n: [(0.9 * x, 1.1 * x) for x in values] for n, values in GOOD.items()}
    inputs |= {"knee_angle": [(0.2, 0.4)]}
    state = [(0.9, 1.1)] * 4
    leaf.Probe(system, inputs, state, spread=1e-3).check_contract(reference_max_rad=0.4)
