"""Live views: wiring, and what a recording of Drake's Simulator holds."""

import math
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer, SceneGraph
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from kneexo.diagrams import make_closed_loop
from kneexo.errors import LinkageError, ParameterError
from kneexo.geometry.linkage import icr, pose, rod_extension
from kneexo.parameters import G1, G3, LinkageParameters, Scenario
from kneexo.view.mechanism import PINS
from kneexo.view.meshcat_view import add_meshcat_view
from kneexo.view.parts import parts
from kneexo.view.pressure_colour import pressure_colours

PERIOD_S = 1.0 / 32.0
FULL_PA = 2e5


@pytest.fixture
def meshcat():
    return Meshcat(MeshcatParams(host="localhost"))


def source(builder, name, port="knee_angle", size=1):
    """A leg of a user's own: a system with one port that stands still."""
    inner = DiagramBuilder()
    value = inner.AddNamedSystem("value", ConstantVectorSource(np.full(size, 0.5)))
    inner.ExportOutput(value.get_output_port(), port)
    return builder.AddNamedSystem(name, inner.Build())


def test_a_leg_of_its_knee_angle_alone_is_shown(meshcat):
    builder = DiagramBuilder()
    leg = source(builder, "mine")
    visualizer = add_meshcat_view(builder, {leg: G1}, meshcat)
    diagram = builder.Build()
    names = [system.get_name() for system in diagram.GetSystems()]
    assert names == ["mine", "knee_scene_graph", "mine_frames", visualizer.get_name()]
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    shown = parts(G1)
    assert len(shown) > 40
    for name, part in shown.items():
        assert meshcat.HasPath(f"/drake/knees/mine/{part.frame}/{name}")
    assert meshcat.HasPath("/drake/icr_paths/mine")


def test_the_limb_of_a_wearer_moves_with_his_leg(meshcat):
    builder = DiagramBuilder()
    scenario = Scenario.model_validate({"plant": {"load": "knee"}, "wearer": "leg"})
    leg = builder.AddNamedSystem("worn", make_closed_loop(scenario, signals=()))
    add_meshcat_view(builder, {leg: G1}, meshcat)
    frames = builder.GetSubsystemByName("worn_frames").GetInputPort("wearer_motion")
    (source,) = (
        out
        for end, out in builder.connection_map().items()
        if end[1] == frames.get_index() and end[0].get_name() == "worn_frames"
    )
    assert source == (leg, leg.GetOutputPort("wearer_motion").get_index())


# ------------------------------------------------------------------------- a recorded run


class Recording:
    """The animation in a page of Meshcat."""

    def __init__(self, commands):
        (animation,) = (c for c in commands if c["type"] == "set_animation")
        self._tracks = {
            (clip["path"], track["name"]): track["keys"]
            for clip in animation["animations"]
            for track in clip["clip"]["tracks"]
        }
        (self.rate,) = {clip["clip"]["fps"] for clip in animation["animations"]}
        self._still = {
            c["path"].removeprefix("/drake/knees/"): np.reshape(c["matrix"], (4, 4)).T
            for c in commands
            if c["type"] == "set_transform"
        }

    def values(self, path, name):
        """Values at all frames, (frames, elements); frames follow each other without a gap."""
        keys = self._tracks[f"/drake/knees/{path}", name]
        assert [key["time"] for key in keys] == list(range(len(keys)))
        return np.array([key["value"] for key in keys])

    def poses(self, leg, part):
        """Poses of a part at all frames, (n, 4, 4): of its frame, and in its frame."""
        (path,) = (p for p in self._still if re.fullmatch(f"{leg}/[^/]+/{part}", p))
        frame = path.rpartition("/")[0]
        rows = zip(self.values(frame, ".quaternion"), self.values(frame, ".position"), strict=True)
        return np.array(
            [
                RigidTransform(Quaternion(wxyz=np.roll(turn, 1)), place).GetAsMatrix4()
                @ self._still[path]
                for turn, place in rows
            ]
        )

    def pin(self, leg, name):
        """Places of a pin in the plane of its knee, x + jz."""
        return self.poses(leg, f"pin_{name}")[:, :3, 3] @ [1.0, 0.0, 1j]

    def axis(self, leg, part):
        """Directions of the axis of a part, x + jz."""
        return self.poses(leg, part)[:, :3, 2] @ [1.0, 0.0, 1j]


@pytest.fixture(scope="module")
def recorded(commands):
    """Two legs for 0.3 s: logs by leg and port, the recorded page and its commands."""
    common = {"reference": {"kind": "sine", "frequency_hz": 1.0}}
    load = {"kind": "knee"}
    scenarios = {
        "smc": Scenario.model_validate(common | {"plant": {"load": load}}),
        "pid": Scenario.model_validate(
            common | {"controller": {"kind": "pid"}, "plant": {"linkage": "G3", "load": load}}
        ),
    }
    meshcat, builder, logs = Meshcat(MeshcatParams(host="localhost")), DiagramBuilder(), {}
    legs = {}
    for name, scenario in scenarios.items():
        leg = builder.AddNamedSystem(name, make_closed_loop(scenario, signals=()))
        legs[leg] = scenario.plant.linkage
        for port in ("knee_angle", "knee_reference", "load_pressure"):
            logs[name, port] = LogVectorOutput(leg.GetOutputPort(port), builder, PERIOD_S)
    visualizer = add_meshcat_view(builder, legs, meshcat, largest_pressure_pa=FULL_PA)
    visualizer.StartRecording()
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.3)
    visualizer.PublishRecording()
    context = simulator.get_context()
    values = {key: log.FindLog(context).data()[0].copy() for key, log in logs.items()}
    page = meshcat.StaticHtml()
    return SimpleNamespace(logs=values, page=page, commands=commands(page))


@pytest.mark.parametrize(("leg", "link"), [("smc", G1), ("pid", G3)])
def test_a_recording_holds_the_linkage_at_the_simulated_angles(recorded, leg, link):
    logs = recorded.logs
    recording, angle = Recording(recorded.commands), logs[leg, "knee_angle"]
    assert recording.rate == 1.0 / PERIOD_S
    assert np.ptp(angle) > math.radians(3.0)  # it moves
    assert angle.size == 10
    places = {name: recording.pin(leg, name) for name in (*PINS, "icr")}
    at = pose(link, angle)
    centre_x, centre_y = icr(link, at.theta_3, at.theta_4)
    ground = {
        "o_a": complex(link.o_a_x_m, link.o_a_y_m),
        "o_b": complex(link.o_b_x_m, link.o_b_y_m),
    }
    linkage = ground | {"a": at.joint_a, "b": at.joint_b, "rod_pin": at.rod_pin}
    linkage["icr"] = centre_x + 1j * centre_y
    for first in linkage:
        for second in linkage:
            np.testing.assert_allclose(
                np.abs(places[first] - places[second]),
                np.abs(linkage[first] - linkage[second] + np.zeros(angle.size)),
                atol=1e-12,
                err_msg=f"{first} {second}",
            )
    np.testing.assert_allclose(
        np.abs(places["rod_pin"] - places["cylinder_pin"]),
        link.rod_length_m + rod_extension(link, angle),
        atol=1e-12,
    )
    shank = -1j * np.exp(-1j * angle)  # down, and back by the knee angle
    np.testing.assert_allclose(recording.axis(leg, "shank"), shank, atol=1e-12)
    reference = -1j * np.exp(-1j * logs[leg, "knee_reference"])
    assert np.abs(reference - shank).max() > 1e-4
    ghost = -recording.axis(leg, "reference_shin")  # its own axis points up
    np.testing.assert_allclose(ghost, reference, atol=1e-12)


@pytest.mark.parametrize("leg", ["smc", "pid"])
def test_a_recording_holds_the_pressure_as_colour(recorded, leg):
    recording, path = Recording(recorded.commands), f"{leg}/cylinder/cylinder/<object>"
    share = recorded.logs[leg, "load_pressure"] / FULL_PA
    assert share.min() < -0.1
    assert np.abs(share).max() < 1.0
    for channel, positive, negative in (("r", 0.9, 0.1), ("g", 0.15, 0.3), ("b", 0.1, 0.9)):
        full = np.where(share > 0.0, positive, negative)
        shown = recording.values(path, f".material.color[{channel}]")
        np.testing.assert_allclose(shown, 0.85 + np.abs(share) * (full - 0.85), atol=1e-12)


def test_legs_stand_beside_each_other_the_first_one_nearest(recorded):
    recording = Recording(recorded.commands)
    depths = [recording.values(f"{leg}/shank", ".position")[:, 1] for leg in ("smc", "pid")]
    assert [set(depth) for depth in depths] == [{-0.15}, {0.15}]
    (camera,) = (
        command["value"]
        for command in recorded.commands
        if command.get("path") == "/Cameras/default/rotated/<object>"
        and command.get("property") == "position"
    )
    assert camera[2] > 0.15  # three.js: z is Drake's −y
    lines = {c["path"]: c for c in recorded.commands if "icr_paths" in str(c.get("path"))}
    assert set(lines) == {"/drake/icr_paths/smc", "/drake/icr_paths/pid"}


# ------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("port", "size", "line"),
    [
        ("angle", 1, "mine: must have an output port knee_angle of size 1"),
        ("knee_angle", 2, "mine: must have an output port knee_angle of size 1"),
    ],
)
def test_a_leg_without_its_knee_angle_is_refused(meshcat, port, size, line):
    builder = DiagramBuilder()
    with pytest.raises(ParameterError, match=f"^{line}$"):
        add_meshcat_view(builder, {source(builder, "mine", port, size): G1}, meshcat)
    assert [system.get_name() for system in builder.GetSystems()] == ["mine"]  # nothing half done


def test_other_input_that_is_wrong_is_one_line_and_leaves_the_builder_as_it_was(meshcat):
    with pytest.raises(ParameterError, match=r"^legs: there is none; must be at least one"):
        add_meshcat_view(DiagramBuilder(), {}, meshcat)
    other, builder = DiagramBuilder(), DiagramBuilder()
    with pytest.raises(ParameterError, match=r"^mine: must be a system of the builder$"):
        add_meshcat_view(builder, {source(other, "mine"): G1}, meshcat)
    twins = {source(other, "twin"): G1, source(other, "twin"): G3}
    with pytest.raises(ParameterError, match=r"^legs: two have the name twin; choose another$"):
        add_meshcat_view(other, twins, meshcat)
    leg = builder.AddNamedSystem("loop", make_closed_loop(Scenario(), signals=()))
    with pytest.raises(ParameterError, match=r"^largest_pressure_pa = 0 Pa: must be finite and"):
        add_meshcat_view(builder, {leg: G1}, meshcat, largest_pressure_pa=0.0)
    link = LinkageParameters(**(G1.model_dump() | {"a_4_m": 0.010}))
    with pytest.raises(LinkageError, match="cannot be assembled"):
        add_meshcat_view(builder, {leg: link}, meshcat)
    second = source(builder, "second")
    with pytest.raises(LinkageError, match="cannot be assembled"):
        add_meshcat_view(builder, {leg: G1, second: link}, meshcat)
    assert [system.get_name() for system in builder.GetSystems()] == ["loop", "second"]
    assert not meshcat.HasPath("/drake/icr_paths")
    add_meshcat_view(builder, {leg: G1}, meshcat)
    line = r"^knee_scene_graph: the builder has a system of this name; choose another$"
    with pytest.raises(ParameterError, match=line):
        add_meshcat_view(builder, {second: G1}, meshcat)


def test_the_colour_is_full_at_the_rating_of_the_cylinder(meshcat, commands):
    builder, inner = DiagramBuilder(), DiagramBuilder()
    for port, value in (("knee_angle", 0.5), ("load_pressure", 0.7e6)):  # a fifth of 3.5 MPa
        constant = inner.AddNamedSystem(port, ConstantVectorSource([value]))
        inner.ExportOutput(constant.get_output_port(), port)
    leg = builder.AddNamedSystem("leg", inner.Build())
    add_meshcat_view(builder, {leg: G1}, meshcat)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    colour = {
        command["property"]: command["value"]
        for command in commands(meshcat.StaticHtml())
        if command.get("path") == "/drake/knees/leg/cylinder/cylinder/<object>"
    }
    assert [colour[f"material.color[{c}]"] for c in "rgb"] == pytest.approx([0.86, 0.71, 0.70])


def test_a_view_goes_beside_the_scene_graph_of_a_user(meshcat):
    builder = DiagramBuilder()
    leg = source(builder, "mine")
    scene_graph = builder.AddNamedSystem("scene_graph", SceneGraph())
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
    add_meshcat_view(builder, {leg: G1}, meshcat)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    assert meshcat.HasPath("/drake/knees/mine/shank")


@pytest.mark.slow
def test_diagrams_do_not_import_the_geometry_that_only_views_need():
    code = "import sys, kneexo.diagrams, kneexo.systems; print('pydrake.geometry' in sys.modules)"
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert process.stdout == "False\n"


@pytest.mark.slow
def test_a_browser_plays_a_recording_with_its_colours(recorded, browser, tmp_path):
    page = tmp_path / "recording.html"
    page.write_text(recorded.page)
    browser.open(page)
    browser.wait_for("viewer.animator.actions.length > 0")
    cylinder = "viewer.scene_tree.find(['drake', 'knees', 'smc', 'cylinder', 'cylinder'])"
    material = f"{cylinder}.children['<object>'].object.material"
    for frame in (2, 8):
        browser.evaluate(f"viewer.animator.pause(), viewer.animator.seek({frame * PERIOD_S}), null")
        pressure = recorded.logs["smc", "load_pressure"][[frame]]
        colour = browser.evaluate(f"{material}.color.toArray()")
        np.testing.assert_allclose(colour, pressure_colours(pressure, FULL_PA)[0], atol=1e-6)
    picture = browser.picture()
    assert (np.ptp(picture, axis=2) > 0.1).sum() > 100  # coloured parts
    browser.require_health()
