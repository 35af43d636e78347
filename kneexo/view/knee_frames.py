"""Frames of leg and linkage for Drake's SceneGraph."""

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
from kneexo.view.mechanism import (
    BARS,
    GHOST,
    PINS,
    bar_pose,
    pin_pose,
    points,
    shapes,
)


def poses(
    linkage: LinkageParameters, knee_angle: float, reference: float, depth_m: float = 0.0
) -> dict[str, RigidTransform]:
    """Pose of each part of `shapes` in the world, at a knee angle and a reference in rad."""
    at = points(linkage, [knee_angle, reference])
    parts = {}
    for name, bar in BARS.items():
        ends = zip(at[bar.start].tolist(), at[bar.end].tolist(), strict=True)
        now, wanted = (bar_pose(*pair, depth_m + bar.layer_m) for pair in ends)
        parts[name] = now
        if name in GHOST:
            parts[f"reference_{name}"] = wanted
    for name in (*PINS, "icr"):
        parts[f"pin_{name}"] = pin_pose(complex(at[name][0]), depth_m)
    return parts


class KneeFrames(LeafSystem):
    """Frames of the parts of leg and linkage, for SceneGraph.

    Each part is where the linkage has it at the knee angle (Lee et al. 2020, Eq. 3–9; `points`).

    ===============  ====  ========  ===================================================
    input port       size  unit
    ===============  ====  ========  ===================================================
    knee_angle       1     rad       θ_p, 0 = full extension, positive = flexion
    knee_reference   4     rad, …    θ_d and its derivatives, which do not count here;
                                     the knee angle if unconnected
    **output port**
    frame_poses                      `FramePoseVector`: pose of each part in the world
    ===============  ====  ========  ===================================================

    Stateless. Registers its parts, each a frame ``name::part`` with one geometry, as the source
    ``name`` of ``scene_graph``; ``depth_m`` is the y of the knee's plane. The ghost of the
    reference is hidden in the shank while both agree.

    It has no scalar conversion: the frames belong to one SceneGraph of floats, and nothing depends
    on the picture. Linearize the diagram that is shown, not the one that shows it.

    Raises `ParameterError` for a depth that is not finite, `LinkageError` on construction and when
    evaluated where the linkage cannot be assembled.
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
        parts = shapes(linkage)
        self.source = scene_graph.RegisterSource(name)
        self._frames: dict[str, FrameId] = {}
        for part, (shape, colour) in parts.items():
            frame = scene_graph.RegisterFrame(self.source, GeometryFrame(f"{name}::{part}"))
            geometry = GeometryInstance(RigidTransform(), shape, part)
            properties = MakePhongIllustrationProperties(
                [colour.r(), colour.g(), colour.b(), colour.a()]
            )
            geometry.set_illustration_properties(properties)
            scene_graph.RegisterGeometry(self.source, frame, geometry)
            self._frames[part] = frame
        self._angle = self.DeclareVectorInputPort("knee_angle", 1)
        self._reference = self.DeclareVectorInputPort("knee_reference", 4)
        self.DeclareAbstractOutputPort(
            "frame_poses",
            lambda: Value(FramePoseVector()),
            self._calc_poses,
            {self._angle.ticket(), self._reference.ticket()},
        )

    def _calc_poses(self, context: Any, output: Any) -> None:
        angle = self._angle.Eval(context)[0]
        has_reference = self._reference.HasValue(context)
        reference = self._reference.Eval(context)[0] if has_reference else angle
        vector = FramePoseVector()
        for part, pose in poses(self._linkage, angle, reference, self._depth_m).items():
            vector.set_value(self._frames[part], pose)
        output.set_value(vector)
