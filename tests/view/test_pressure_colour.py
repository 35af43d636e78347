"""Colours of a part in Meshcat by pressure, as a page of Meshcat has them."""

import math

import numpy as np
import pytest
from pydrake.geometry import Box, Meshcat, MeshcatParams, Rgba
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Sine

from kneexo.errors import ParameterError
from kneexo.view.pressure_colour import PressureColour, pressure_colours

BLUE, GREY, RED = np.array([0.1, 0.3, 0.9]), np.full(3, 0.85), np.array([0.9, 0.15, 0.1])


@pytest.fixture
def meshcat():
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    meshcat.SetObject("part", Box(1.0, 1.0, 1.0), Rgba(0.0, 0.0, 0.0))
    return meshcat


def test_it_does_not_convert_to_other_scalars(meshcat):
    system = PressureColour(meshcat, "part", 1e6, 0.1)
    assert system.ToAutoDiffXdMaybe() is None
    assert system.ToSymbolicMaybe() is None


@pytest.mark.parametrize(
    ("pressure", "expected"),
    [
        (0.0, GREY),
        (2e6, RED),
        (-2e6, BLUE),
        (1e6, 0.5 * (GREY + RED)),
        (-5e5, 0.75 * GREY + 0.25 * BLUE),
        (9e6, RED),
        (-math.inf, BLUE),
    ],
)
def test_the_colour_goes_from_blue_over_grey_to_red(meshcat, commands, pressure, expected):
    system = PressureColour(meshcat, "/drake/part", 2e6, 0.1)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, [pressure])
    system.ForcedPublish(context)
    values = {
        command["property"]: command["value"]
        for command in commands(meshcat.StaticHtml())
        if command["type"] == "set_property" and command["path"] == "/drake/part/<object>"
    }
    assert values == {
        f"material.color[{channel}]": pytest.approx(value, abs=1e-12)
        for channel, value in zip("rgb", expected, strict=True)
    }


def test_a_recording_has_the_colour_of_each_period(meshcat, commands):
    builder = DiagramBuilder()
    wave = builder.AddNamedSystem("wave", Sine(1e6, 2.0 * math.pi, 0.0, 1))
    colour = builder.AddNamedSystem("colour", PressureColour(meshcat, "part", 1e6, 0.05))
    builder.Connect(wave.get_output_port(0), colour.get_input_port())
    meshcat.StartRecording(frames_per_second=20.0)
    Simulator(builder.Build()).AdvanceTo(1.0)
    meshcat.PublishRecording()
    (animation,) = (c for c in commands(meshcat.StaticHtml()) if c["type"] == "set_animation")
    ((path, clip),) = ((a["path"], a["clip"]) for a in animation["animations"])
    assert (path, clip["fps"]) == ("/drake/part/<object>", 20.0)
    colours = {}
    for track in clip["tracks"]:
        assert [key["time"] for key in track["keys"]] == list(range(21))
        colours[track["name"]] = [key["value"] for key in track["keys"]]
    colours = np.array([colours[f".material.color[{channel}]"] for channel in "rgb"]).T
    redder = colours[:, 0] > colours[:, 2] + 1e-9
    assert redder.tolist() == [0 < frame < 10 for frame in range(21)]
    np.testing.assert_allclose(colours[[5, 15]], [RED, BLUE], atol=1e-12)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_pressure_and_period_are_finite_and_positive(meshcat, value):
    with pytest.raises(ParameterError, match=r"^largest_pressure_pa = \S+ Pa: must be finite and"):
        PressureColour(meshcat, "part", value, 0.1)
    with pytest.raises(ParameterError, match=r"^period_s = \S+ s: must be finite and positive$"):
        PressureColour(meshcat, "part", 1e6, value)


def test_a_knee_without_any_pressure_is_grey():
    np.testing.assert_array_equal(pressure_colours(np.zeros(2), 0.0), [GREY, GREY])
