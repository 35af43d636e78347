"""Frames of the knee against the linkage by compass; test_parts.py has their parts."""

import math
from itertools import combinations

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, SceneGraph

from kneexo.errors import LinkageError, ParameterError
from kneexo.geometry.linkage import encoder_angle
from kneexo.parameters import G1, LINKAGES, LinkageParameters
from kneexo.view.knee_frames import KneeFrames

BARS = {
    *("thigh", "thigh_plate", "thigh_bracket", "link_2", "link_4", "shank", "foot"),
    *("shank_plate", "shank_bracket", "cylinder", "rod"),
}
LIMBS = {"upper_thigh", "lower_thigh", "knee", "calf", "shin", "heel", "toes"}
GHOSTS = {"reference_calf", "reference_shin", "reference_heel", "reference_toes"}
DRIVE = {"pump", "gear", "motor", "valve_block"}
PINS = {f"pin_{name}" for name in ("o_a", "o_b", "a", "b", "cylinder_pin", "rod_pin", "icr")}
ANGLES = np.radians([1.0, 20.0, 45.0, 70.0, 89.0])


class Shown:
    """A system of frames, and the poses of its parts by name."""

    def __init__(self, linkage, **options):
        self.scene_graph = SceneGraph()
        self.system = KneeFrames(self.scene_graph, linkage, **options)
        self.inspector = self.scene_graph.model_inspector()
        self.prefix = options.get("name", "knee")

    def shapes(self):
        inspector = self.inspector
        return {inspector.GetName(g): inspector.GetShape(g) for g in inspector.GetAllGeometryIds()}

    def colours(self):
        colours = {}
        for geometry in self.inspector.GetAllGeometryIds():
            name = self.inspector.GetName(geometry)
            properties = self.inspector.GetIllustrationProperties(geometry)
            colours[name] = properties.GetProperty("phong", "diffuse")
        return colours

    def poses(self, angle, reference=None, wearer=None):
        context = self.system.CreateDefaultContext()
        self.system.GetInputPort("knee_angle").FixValue(context, [angle])
        if reference is not None:
            self.system.GetInputPort("knee_reference").FixValue(context, [reference, 9.0, 9.0, 9.0])
        if wearer is not None:
            self.system.GetInputPort("wearer_motion").FixValue(context, [wearer, 9.0])
        vector = self.system.GetOutputPort("frame_poses").Eval(context)
        inspector = self.inspector
        return {
            inspector.GetName(geometry): vector.value(frame) @ inspector.GetPoseInFrame(geometry)
            for frame in vector.ids()
            for geometry in inspector.GetGeometries(frame)
        }


# ------------------------------------------------------------------------------ structure


def test_it_does_not_convert_to_other_scalars():
    system = KneeFrames(SceneGraph())
    assert system.ToAutoDiffXdMaybe() is None
    assert system.ToSymbolicMaybe() is None


def test_parts_are_limbs_bones_links_pins_actuator_and_the_ghost_of_the_reference():
    shown = Shown(G1, name="left")
    shapes = shown.shapes()
    assert set(shapes) > BARS | GHOSTS | PINS | LIMBS | DRIVE
    assert {name for name in shapes if name.startswith("reference")} == GHOSTS
    assert set(shown.poses(0.5)) == set(shapes)
    assert shown.inspector.GetName(shown.system.source) == "left"
    for ghost in GHOSTS:  # within the skin that it agrees with
        skin = shapes[ghost.removeprefix("reference_")]
        assert type(shapes[ghost]) is type(skin)
        if isinstance(skin, Capsule):
            assert skin.radius() - shapes[ghost].radius() == pytest.approx(0.002)
            assert skin.length() == shapes[ghost].length()
        else:
            gaps = [getattr(skin, axis)() - getattr(shapes[ghost], axis)() for axis in "abc"]
            assert gaps == pytest.approx([0.002] * 3)
    assert shapes["rod"].radius() < shapes["cylinder"].radius()
    assert isinstance(shapes["link_2"], Box)  # two shapes, so that colour is not all
    assert isinstance(shapes["link_4"], Cylinder)
    colours = shown.colours()
    for limb in LIMBS | GHOSTS:
        assert colours[limb].a() <= 0.5 < colours["shank"].a()  # transparent


def test_the_limb_stands_beside_the_linkage_and_the_pump_at_its_cylinder():
    shown = Shown(G1)
    for angle in (0.0, 0.7, 1.5):
        poses = shown.poses(angle)
        assert all(poses[limb].translation()[1] == 0.105 for limb in LIMBS)
        assert all(poses[part].translation()[1] == 0.0 for part in DRIVE)
        cylinder = poses["cylinder"]
        for part in DRIVE:
            way = poses[part].translation() - cylinder.translation()
            across = way - (way @ cylinder.rotation().col(2)) * cylinder.rotation().col(2)
            assert 0.02 < np.linalg.norm(across) < 0.045
            assert across[0] < 0.0  # behind the leg


# -------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("name", LINKAGES)
def test_pins_have_the_distances_of_the_compass_construction(name, compass):
    link = LINKAGES[name]
    walk = compass(link, encoder_angle(link, np.concatenate([[0.0], ANGLES])))
    np.testing.assert_allclose(walk.knee_angle[1:], ANGLES, atol=1e-12)
    expected = {
        "pin_o_a": complex(link.o_a_x_m, link.o_a_y_m),
        "pin_o_b": complex(link.o_b_x_m, link.o_b_y_m),
        "pin_cylinder_pin": link.rod_anchor_radius_m * np.exp(1j * link.rod_anchor_angle_rad),
        "pin_a": walk.joint_a,
        "pin_b": walk.joint_b,
        "pin_rod_pin": walk.rod_pin,
    }
    shown = Shown(link)
    for index, angle in enumerate(ANGLES, 1):
        places = {pin: pose.translation() for pin, pose in shown.poses(angle).items()}
        points = {pin: np.broadcast_to(at, walk.joint_a.shape) for pin, at in expected.items()}
        for first, second in combinations(expected, 2):
            distance = np.linalg.norm(places[first] - places[second])
            expected_distance = abs(points[first][index] - points[second][index])
            assert distance == pytest.approx(expected_distance, abs=1e-12), (first, second)


def test_the_ghost_is_the_shank_at_the_reference_or_at_the_angle_without_a_reference():
    shown = Shown(G1)
    at_reference, with_reference = shown.poses(0.9), shown.poses(0.4, reference=0.9)
    without = shown.poses(0.4)
    for ghost in GHOSTS:
        part = ghost.removeprefix("reference_")
        assert with_reference[ghost].IsExactlyEqualTo(at_reference[part])
        assert without[ghost].IsExactlyEqualTo(without[part])
    for part in set(without) - GHOSTS:
        assert with_reference[part].IsExactlyEqualTo(without[part])


# ------------------------------------------------------------------------------ bad input


def test_the_limb_is_at_the_angle_of_the_wearer_if_there_is_one():
    shown = Shown(G1)
    apart, together, knee = shown.poses(0.4, 0.4, 1.1), shown.poses(1.1), shown.poses(0.4)
    for name in ("shin", "toes", "foot"):
        assert apart[name].IsExactlyEqualTo(together[name])
    for name in ("sole", "rod", "reference_shin"):
        assert apart[name].IsExactlyEqualTo(knee[name])


def test_a_linkage_that_does_not_close_is_refused_on_construction():
    with pytest.raises(LinkageError, match="cannot be assembled at knee angle 0 deg"):
        KneeFrames(SceneGraph(), LinkageParameters(**(G1.model_dump() | {"a_4_m": 0.010})))


def test_an_angle_without_a_pose_is_one_line():
    with pytest.raises(LinkageError, match=r"^the linkage cannot .* knee angle nan deg[^\n]*$"):
        Shown(G1).poses(math.nan)


@pytest.mark.parametrize("depth", [math.nan, math.inf])
def test_a_depth_that_is_not_finite_is_one_line(depth):
    with pytest.raises(ParameterError, match=rf"^depth_m = {depth} m: must be finite$"):
        KneeFrames(SceneGraph(), depth_m=depth)
