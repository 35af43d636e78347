"""Small diagrams for the tests of reading."""

import sys

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem


def _diagram_of(system, name="block"):
    """A diagram of one named system with all ports exported under their own names."""
    builder = DiagramBuilder()
    builder.AddNamedSystem(name, system)
    for index in range(system.num_input_ports()):
        port = system.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    for index in range(system.num_output_ports()):
        port = system.get_output_port(index)
        builder.ExportOutput(port, port.get_name())
    return builder.Build()


def _leaf(name, construct):
    """A leaf of all scalars that ``construct(self, T)`` declares."""

    def template(T):
        class Impl(LeafSystem_[T]):
            def _construct(self, *, converter=None):
                LeafSystem_[T].__init__(self, converter)
                construct(self, T)

            def _construct_copy(self, other, converter=None):
                Impl._construct(self, converter=converter)

        return Impl

    return TemplateSystem.define(f"{name}_", scope=sys.modules[__name__])(template)[float]()


@pytest.fixture(scope="session")
def diagram_of():
    """The function ``diagram_of(system, name)``."""
    return _diagram_of


@pytest.fixture(scope="session")
def leaf():
    """The function ``leaf(name, construct)``."""
    return _leaf
