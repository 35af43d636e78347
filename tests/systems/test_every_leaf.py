"""What all leaf systems have in common: names of Context parameters, conversion, periods.

The numbers of a leaf are tested in its own file against an independent source, and the ranges of
all parameters in ``tests/parameters/fields/test_quantity.py``.
"""

import inspect
import math

import pytest

from kneexo import systems
from kneexo.parameters import LawParameters
from kneexo.systems._leaf import NamedLeaf


def law(rod_extension, gain=2.0):
    return gain * rod_extension


REQUIRED = {
    "EncoderCount": (0.1,),
    "FunctionLaw": (LawParameters(function=law, values={"gain": 2.0}),),
    "HeldCommand": (0.002, ("rod_extension",)),
    "LinearLaw": (0.002, ("rod_extension",), 1, 1),
}
"""Arguments of the classes that have no default for them."""

CLASSES = {
    name: value
    for name in systems.__all__
    if inspect.isclass(value := getattr(systems, name)) and issubclass(value, NamedLeaf)
}
every_leaf = pytest.mark.parametrize("name", CLASSES)


def made(name):
    return CLASSES[name](*REQUIRED.get(name, ()))


def test_every_class_is_here():
    assert set(CLASSES) == {name for name in systems.__all__ if f"{name}_" in systems.__all__}


@every_leaf
def test_a_name_that_is_unknown_and_a_number_that_is_not_finite_are_refused(name):
    system = made(name)
    system.set_name("part")
    context = system.CreateDefaultContext()
    known = system.parameter_names
    with pytest.raises(ValueError, match=r"^part: unknown parameter 'no'; known: ") as caught:
        system.set_parameter(context, "no", 1.0)
    assert str(caught.value).endswith(f"known: {', '.join(known)}")
    for parameter in known:
        before = getattr(system.parameters(context), parameter)
        with pytest.raises(ValueError, match=f"^part: {parameter} = nan: must be finite$"):
            system.set_parameter(context, parameter, math.nan)
        assert getattr(system.parameters(context), parameter) == before


@every_leaf
def test_conversions_have_the_same_ports_states_and_parameters(name, leaf):
    system = made(name)
    expected = leaf.structure(system)
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    for converted in (system.ToAutoDiffXd(), system.ToSymbolic()):
        assert isinstance(converted, CLASSES[name])
        structure = leaf.structure(converted)
        assert structure.inputs == expected.inputs
        assert structure.outputs == expected.outputs
        assert structure.continuous == expected.continuous
        assert structure.discrete == expected.discrete
        assert converted.parameter_names == system.parameter_names
        other = converted.GetUniquePeriodicDiscreteUpdateAttribute()
        assert (other and other.period_sec()) == (timing and timing.period_sec())
