"""Shared by the tests of compilation."""

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Gain,
    LinearSystem,
    LogVectorOutput,
    Saturation,
    Sine,
    ZeroOrderHold,
)


@pytest.fixture
def multirate():
    """A sine, held every 4 ms, through a plant, sampled every 10 ms from 5 ms on; nested."""
    inner = DiagramBuilder()
    plant = inner.AddNamedSystem(
        "plant",
        LinearSystem(A=[[0.0, 1.0], [-400.0, -4.0]], B=[[0.0], [400.0]], C=[[1.0, 0.0]], D=[[0.0]]),
    )
    limit = inner.AddNamedSystem("limit", Saturation(min_value=[-0.7], max_value=[0.7]))
    inner.Connect(limit.get_output_port(), plant.get_input_port())
    inner.ExportInput(limit.get_input_port(), "u")
    inner.ExportOutput(plant.get_output_port(), "y")
    inner = inner.Build()
    inner.set_name("inner")
    builder = DiagramBuilder()
    sine = builder.AddNamedSystem("sine", Sine(1.0, 10.0, 0.3, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.004, 1))
    builder.AddNamedSystem("inner", inner)
    sampler = builder.AddNamedSystem("sampler", ZeroOrderHold(0.010, 1, offset_sec=0.005))
    gain = builder.AddNamedSystem("gain", Gain(2.0, 1))
    builder.Connect(sine.get_output_port(0), hold.get_input_port())
    builder.Connect(hold.get_output_port(), inner.get_input_port())
    builder.Connect(inner.get_output_port(), sampler.get_input_port())
    builder.Connect(sampler.get_output_port(), gain.get_input_port())
    for name, system in (("y", inner), ("sampled", gain), ("held", hold)):
        builder.ExportOutput(system.get_output_port(), name)
        log = LogVectorOutput(system.get_output_port(), builder, publish_period=0.002)
        log.set_name(f"log_{name}")
    return builder.Build()
