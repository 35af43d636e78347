"""The leaf system that moves leg and linkage in Drake's SceneGraph."""

from __future__ import annotations

import math
from typing import Any

from pydrake.common.value import Value
from pydrake.geometry import (
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    MakePhongIllustrationProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem

from kneexo.errors import ParameterError
from kneexo.parameters import LinkageParameters
from kneexo.view.parts import parts, placements


class KneeFrames(LeafSystem):
    """Moves the frames of leg and linkage in SceneGraph, and the parts on these frames.

    The linkage determines the poses from the knee angle (Lee et al. 2020, Eq. 3–9; see
    `kneexo.view.mechanism.points`).

    ===============  ====  ========  ===================================================
    input port       size  unit
    ===============  ====  ========  ===================================================
    knee_angle       1     rad       θ_p, 0 = full extension, positive = flexion
    knee_reference   4     rad, …    θ_d and its derivatives, which have no effect here;
                                     the knee angle if unconnected
    wearer_motion    2     rad, …    θ_h of the wearer's leg, and its rate, which is not used
                                     here; the knee angle if unconnected
    **output port**
    frame_poses                      `FramePoseVector`: pose of each frame in the world
    ===============  ====  ========  ===================================================

    No state. The system has no scalar conversion, because its frames belong to a SceneGraph of
    floats. So linearize a diagram without views.

    Parameters
    ----------
    scene_graph
        The constructor adds the source ``name`` to this SceneGraph, for each rigid body a frame
        ``name::body``, and for each part a geometry on its frame.
    linkage
        Geometry of the linkage.
    name
        Name of the source in SceneGraph.
    depth_m
        The y coordinate of the knee's plane in the world, in m.

    Raises
    ------
    ParameterError
        ``depth_m`` is not finite.
    LinkageError
        The linkage cannot be assembled. Raised in the constructor, or later for a knee angle or
        reference.
    """

    def __init__(
        self,
        scene_graph: SceneGraph,
        linkage: LinkageParameters = LinkageParameters(),
        *,
        name: str = "knee",
        depth_m: float = 0.0,
    ) -> None:
        super().__init__()
        if not math.isfinite(depth_m):
            raise ParameterError(f"depth_m = {depth_m} m: must be finite")
        self._linkage, self._depth_m = linkage, float(depth_m)
        leg, straight = parts(linkage), placements(linkage, 0.0, 0.0)
        self.source = scene_graph.RegisterSource(name)
        self._frames: dict[str, FrameId] = {
            frame: scene_graph.RegisterFrame(self.source, GeometryFrame(f"{name}::{frame}"))
            for frame in straight
        }
        for part_name, part in leg.items():
            geometry = GeometryInstance(part.pose, part.shape, part_name)
            colour = [part.colour.r(), part.colour.g(), part.colour.b(), part.colour.a()]
            geometry.set_illustration_properties(MakePhongIllustrationProperties(colour))
            scene_graph.RegisterGeometry(self.source, self._frames[part.frame], geometry)
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._reference = self.DeclareVectorInputPort("knee_reference", 4)
        self._wearer = self.DeclareVectorInputPort("wearer_motion", 2)
        self.DeclareAbstractOutputPort(
            "frame_poses",
            lambda: Value(FramePoseVector()),
            self._calc_poses,
            {port.ticket() for port in (self._angle, self._reference, self._wearer)},
        )

    def _calc_poses(self, context: Any, output: Any) -> None:
        angle = self._angle.Eval(context)[0]
        reference, wearer = (
            port.Eval(context)[0] if port.HasValue(context) else angle
            for port in (self._reference, self._wearer)
        )
        vector = FramePoseVector()
        offset = RigidTransform([0.0, self._depth_m, 0.0])
        for frame, placement in placements(self._linkage, angle, reference, wearer).items():
            (pose,) = placement.poses()
            vector.set_value(self._frames[frame], offset @ pose)
        output.set_value(vector)
