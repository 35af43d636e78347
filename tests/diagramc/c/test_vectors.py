"""Test vectors: outputs of the compiled diagram after each step."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LinearSystem

from diagramc import read_diagram, recorded_vectors, source_of
from diagramc.errors import CompilationError

SAMPLES = np.arange(1.0, 21.0)[:, None]


def low_pass(feedthrough=0.0):
    """Y = x + d u, x⁺ = 0.5 x + u every 10 ms."""
    system = LinearSystem(A=[[0.5]], B=[[1.0]], C=[[1.0]], D=[[feedthrough]], time_period=0.01)
    system.set_name("low_pass")
    return system


def test_vectors_are_the_outputs_after_each_step():
    for feedthrough in (0.0, 3.0):
        read = read_diagram(low_pass(feedthrough), inputs=["u0"])
        vectors = recorded_vectors(low_pass(feedthrough), source_of(read, "m"), SAMPLES)
        x, expected = 0.0, []
        for (u,) in SAMPLES:
            x = 0.5 * x + u
            expected.append([x + feedthrough * u])
        np.testing.assert_allclose(vectors.outputs, expected, rtol=1e-15)
        np.testing.assert_array_equal(vectors.inputs, SAMPLES)


def test_vectors_without_steps_are_refused():
    source = source_of(read_diagram(low_pass(), inputs=["u0"]), "m")
    with pytest.raises(CompilationError, match="m: test vectors have 0 steps; must be at least 1"):
        recorded_vectors(low_pass(), source, np.zeros((0, 1)))


def test_inputs_that_vary_need_a_diagram_without_sample_times_or_without_states(multirate):
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", LinearSystem(A=[[-1.0]], B=[[1.0]], C=[[1.0]], D=[[0]]))
    law = builder.AddNamedSystem("law", low_pass())
    builder.Connect(plant.get_output_port(), law.get_input_port())
    builder.ExportInput(plant.get_input_port(), "u")
    builder.ExportOutput(law.get_output_port(), "y")
    diagram = builder.Build()
    source = source_of(read_diagram(diagram, inputs=["u"]), "m")
    constant = np.full((50, 1), 2.0)
    assert np.ptp(recorded_vectors(diagram, source, constant).outputs) > 0.0
    with pytest.raises(CompilationError, match="test vectors need inputs that are constant"):
        recorded_vectors(diagram, source, SAMPLES)
