"""The knee of a Drake simulation while it runs: frames for SceneGraph, drawn by Meshcat."""

from __future__ import annotations

from typing import Any

from pydrake.common.value import Value
from pydrake.geometry import (
    Cylinder,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    MakePhongIllustrationProperties,
    Meshcat,
    MeshcatVisualizer,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from kneexo.parameters import LinkageParameters
from kneexo.view.mechanism import BARS, points
from kneexo.view.page import bar_pose


class KneeFrames(LeafSystem):
    """Frames of the parts of leg and linkage, for SceneGraph.

    ===============  ====  ================================================
    input port       size  unit
    ===============  ====  ================================================
    knee_angle       1     rad
    **output port**
    frame_poses            `FramePoseVector`: pose of each part in the world
    ===============  ====  ================================================

    Stateless. Registers its parts as the source ``knee`` of ``scene_graph``.
    """

    def __init__(self, scene_graph: SceneGraph, linkage: LinkageParameters) -> None:
        super().__init__()
        self._linkage = linkage
        self.source = scene_graph.RegisterSource("knee")
        self._frames: dict[str, FrameId] = {}
        straight = points(linkage, 0.0)
        for name, bar in BARS.items():
            length = float(abs(straight[bar.end][0] - straight[bar.start][0]))
            frame = scene_graph.RegisterFrame(self.source, GeometryFrame(name))
            shape = Cylinder(bar.radius_m, length)
            geometry = GeometryInstance(RigidTransform(), shape, name)
            geometry.set_illustration_properties(
                MakePhongIllustrationProperties([*bar.colour, 1.0])
            )
            scene_graph.RegisterGeometry(self.source, frame, geometry)
            self._frames[name] = frame
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self.DeclareAbstractOutputPort(
            "frame_poses", lambda: Value(FramePoseVector()), self._calc_poses
        )

    def _calc_poses(self, context: Any, output: Any) -> None:
        now = points(self._linkage, self._angle.Eval(context))
        poses = FramePoseVector()
        for name, bar in BARS.items():
            pose = bar_pose(now[bar.start][0], now[bar.end][0], bar.layer_m)
            poses.set_value(self._frames[name], pose)
        output.set_value(poses)


def add_live_view(
    builder: DiagramBuilder, knee_angle: OutputPort, linkage: LinkageParameters, meshcat: Meshcat
) -> MeshcatVisualizer:
    """Show the knee of a diagram in Meshcat while Drake's Simulator runs it.

    ``knee_angle``: a port of size 1 in rad, such as that of `make_closed_loop` as part of
    ``builder``. The visualizer that is returned can record: ``StartRecording``.
    """
    scene_graph = builder.AddNamedSystem("scene_graph", SceneGraph())
    frames = builder.AddNamedSystem("knee_frames", KneeFrames(scene_graph, linkage))
    builder.Connect(knee_angle, frames.GetInputPort("knee_angle"))
    builder.Connect(
        frames.GetOutputPort("frame_poses"), scene_graph.get_source_pose_port(frames.source)
    )
    return MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
