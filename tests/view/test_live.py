"""Frames of the live view against the bars of the mechanism."""

import numpy as np
import pytest
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from kneexo.diagrams import make_closed_loop
from kneexo.parameters import Scenario
from kneexo.parameters.linkages import LINKAGES
from kneexo.view.live import KneeFrames, add_live_view
from kneexo.view.mechanism import BARS, points
from kneexo.view.page import bar_pose


@pytest.mark.parametrize("name", sorted(LINKAGES))
def test_each_frame_is_where_its_bar_is(name):
    scene_graph = SceneGraph()
    frames = KneeFrames(scene_graph, LINKAGES[name])
    context = frames.CreateDefaultContext()
    frames.GetInputPort("knee_angle").FixValue(context, [0.7])
    poses = frames.GetOutputPort("frame_poses").Eval(context)
    inspector = scene_graph.model_inspector()
    at = points(LINKAGES[name], 0.7)
    assert poses.size() == len(BARS)
    for frame in poses.ids():
        bar = BARS[inspector.GetName(frame)]
        start, end = at[bar.start][0], at[bar.end][0]
        expected = bar_pose(start, end, bar.layer_m)
        np.testing.assert_array_equal(poses.value(frame).GetAsMatrix4(), expected.GetAsMatrix4())
        (geometry,) = inspector.GetGeometries(frame)
        shape = inspector.GetShape(geometry)
        assert shape.length() == pytest.approx(abs(end - start), abs=1e-12)
        assert shape.radius() == bar.radius_m


def test_a_running_simulation_is_shown():
    scenario = Scenario.model_validate({"simulation": {"integrator": "radau3"}})
    builder = DiagramBuilder()
    loop = builder.AddNamedSystem("loop", make_closed_loop(scenario, signals=()))
    meshcat = Meshcat()
    angle = loop.GetOutputPort("knee_angle")
    visualizer = add_live_view(builder, angle, scenario.plant.linkage, meshcat)
    visualizer.StartRecording()
    assert not meshcat.HasPath("/drake/visualizer/shank")
    Simulator(builder.Build()).AdvanceTo(0.05)
    for bar in BARS:
        assert meshcat.HasPath(f"/drake/visualizer/{bar}")
    visualizer.PublishRecording()
