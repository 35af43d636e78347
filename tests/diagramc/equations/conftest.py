"""Small diagrams for the tests of reading."""

import pytest
from pydrake.systems.framework import DiagramBuilder


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


@pytest.fixture(scope="session")
def diagram_of():
    """The function ``diagram_of(system, name)``."""
    return _diagram_of
