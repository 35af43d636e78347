import dataclasses

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from kneexo.command_line.main import main
from kneexo.parameters import LINKAGES, Scenario
from kneexo.view.legs import Leg, leg_of_scenario
from kneexo.view.mechanism import PINS, points
from kneexo.view.page import (
    FRAMES_PER_S,
    MARK,
    MOST_FRAMES,
    shown_s,
    view_page,
)
from kneexo.view.parts import placements
from kneexo.view.pressure_colour import pressure_colours

SHORT = {"simulation": {"duration_s": 0.5}}


def scenario_of(**fields):
    return Scenario.model_validate(SHORT | fields)


def test_a_page_tells_its_runs_in_safe_html():
    time = np.linspace(0.0, 1.0, 11)
    leg = Leg(
        "<b>mine</b>", Scenario().plant.linkage, time, 0.5 + 0 * time, 0.6 + 0 * time, -2e6 * time
    )
    page = view_page([leg])
    assert MARK in page
    assert "&lt;b&gt;mine&lt;/b&gt;" in page
    assert "−2.0 MPa … red 2.0 MPa" in page
    assert len(page) < 8e6


@pytest.mark.parametrize("linkage", ["G1", "G3"])
def test_a_page_holds_the_parts_where_the_live_view_has_them(linkage, commands):
    link, time = LINKAGES[linkage], np.linspace(0.0, 2.0, 201)
    angle, reference = 0.7 + 0.4 * np.sin(time), 0.6 + 0.5 * np.cos(time)
    leg = Leg("mine", link, time, angle, reference, 1e6 * np.sin(time))
    still, moving, opacity = {}, {}, {}
    for command in commands(view_page([leg, leg])):
        if command["type"] == "set_object" and "materials" in command["object"]:
            opacity[command["path"]] = command["object"]["materials"][0].get("opacity")
        if command["type"] == "set_transform":
            matrix = np.reshape(command["matrix"], (4, 4)).T
            still[command["path"]] = RigidTransform(matrix)
        if command["type"] == "set_animation":
            for clip in command["animations"]:
                for track in clip["clip"]["tracks"]:
                    keys = [key["value"] for key in track["keys"]]
                    moving[clip["path"], track["name"]] = keys

    def shown(path, frame):
        """The pose in the world of a path: of each of its folders, still or moving."""
        pose, folders = RigidTransform(), path.split("/")
        for end in range(len(folders)):
            at = "/knee/" + "/".join(folders[: end + 1])
            if (at, ".position") in moving:
                x, y, z, w = moving[at, ".quaternion"][frame]
                place = moving[at, ".position"][frame]
                pose = pose @ RigidTransform(Quaternion(wxyz=np.array([w, x, y, z])), place)
            else:
                pose = pose @ still.get(at, RigidTransform())
        return pose

    paths = {path for path, _ in moving} | set(still)
    for frame in (0, 9, 64):
        now = frame / FRAMES_PER_S
        values = (np.interp(now, time, signal) for signal in (angle, reference))
        for part, placement in placements(link, *values).items():
            (pose,) = placement.poses()
            pose = RigidTransform([0.0, -0.15, 0.0]) @ pose
            ghost = part.startswith("reference_")
            folder = "leg0/reference" if ghost else "leg0"
            name = part.removeprefix("reference_")
            places = [f"{folder}/{name}", f"{folder}/on_shank/{name}"]
            (path,) = (place for place in places if f"/knee/{place}" in paths)
            assert opacity[f"/knee/{path}"] == (0.35 if ghost else 1.0)
            in_page = shown(path, frame)
            np.testing.assert_allclose(
                in_page.translation(), pose.translation(), atol=1e-6, err_msg=part
            )
            axes = [where.rotation().matrix()[:, 2] for where in (in_page, pose)]
            np.testing.assert_allclose(*axes, atol=1e-6, err_msg=part)


@pytest.mark.slow
def test_a_page_tells_where_it_ends_and_stays_small(tmp_path, capsys):
    time = np.linspace(0.0, 400.0, 4001)
    angle = 0.6 + 0.5 * np.sin(time)
    legs = [Leg(name, Scenario().plant.linkage, time, angle, angle, 1e6 * angle) for name in "ab"]
    assert shown_s(legs[:1]) == MOST_FRAMES / FRAMES_PER_S == 150.0
    assert shown_s(legs) == 75.0
    page = view_page(legs)
    assert "<li>a (nearest)</li><li>b</li>" in page
    assert "the first 75 of 400 s" in page
    assert 6e6 < len(page) < 8e6
    short = Leg("c", Scenario().plant.linkage, *(values[:101] for values in (time, *[angle] * 3)))
    assert shown_s([short]) == 10.0
    assert "the first 1" not in view_page([short])
    command = ["view", "--out", str(tmp_path / "knee.html"), "--set", "simulation.duration_s=200"]
    assert main(command) == 0
    assert "kneexo: only the first 150 s are shown" in capsys.readouterr().err


# -------------------------------------------------------------------------------- browser

SEEK = """(async (time, part) => {
  viewer.animator.pause();
  viewer.animator.seek(time);
  const leg = viewer.scene_tree.find(["knee", "leg0"]).children;
  const paint = (node, shown) => node.object.traverse((mesh) => {
    if (!mesh.isMesh) return;
    mesh.kept ??= mesh.material;
    const look = { color: 0x00ff00, depthTest: false, toneMapped: false };
    mesh.material = shown ? new MeshCat.THREE.MeshBasicMaterial(look) : mesh.kept;
    mesh.renderOrder = 1;
  });
  for (const place of [leg, leg.on_shank.children])
    for (const [name, node] of Object.entries(place))
      if (name.startsWith("pin_")) paint(node, name == "pin_" + part);
  paint(leg.reference.children.on_shank.children.shank, part == "ghost_of_shank");
  viewer.set_dirty();
  for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
  return leg.cylinder.children["<object>"].object.material.color.toArray();
})"""
WIDTH, HEIGHT = 800, 600


def pixel_of(point):
    """Where the camera of a page with two legs sees a point (x, y, z) in m: column and row."""
    eye, target = np.array([0.35, -0.70, 0.05]), np.array([-0.04, 0.0, -0.03])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    ray = np.asarray(point) - eye
    scale = 0.5 * HEIGHT / np.tan(np.radians(0.5 * 75.0)) / (ray @ forward)
    up = np.cross(right, forward)
    return np.array([0.5 * WIDTH + scale * (ray @ right), 0.5 * HEIGHT - scale * (ray @ up)])


@pytest.mark.slow
@pytest.mark.parametrize(("linkage", "moving"), [("G1", "cylinder_pin"), ("G3", "rod_pin")])
def test_the_parts_are_seen_where_the_linkage_has_them(linkage, moving, browser, tmp_path):
    fields = {"plant": {"linkage": linkage}, "simulation": {"duration_s": 10.0}}
    leg, _ = leg_of_scenario("mine", Scenario.model_validate(fields))
    leg = dataclasses.replace(leg, reference_rad=0.5 * leg.knee_angle_rad)
    page = tmp_path / "knee.html"
    page.write_text(view_page([leg, leg]), encoding="utf-8")
    browser.open(page, WIDTH, HEIGHT)
    browser.wait_for("viewer.animator.actions.length > 0")
    largest = np.abs(leg.pressure_pa).max()
    centres = {}
    for time in (1.0, 4.0):
        angle, pressure = (
            np.interp(time, leg.time_s, v) for v in (leg.knee_angle_rad, leg.pressure_pa)
        )
        ends = {name: [point[0]] for name, point in points(leg.linkage, angle).items()}
        half = points(leg.linkage, 0.5 * angle)
        ends["ghost_of_shank"] = [half["shank_start"][0], half["ankle"][0]]
        for part in (*PINS, "ghost_of_shank"):
            colour = browser.evaluate(f"{SEEK}({time}, '{part}')")
            expected = pressure_colours(np.array([pressure]), largest)[0]
            np.testing.assert_allclose(colour, expected, atol=1e-6)
            picture = browser.picture()
            green = (picture[..., 1] > 0.9) & (picture[..., [0, 2]].max(axis=2) < 0.1)
            assert green.sum() > 20
            rows, columns = np.nonzero(green)
            centre = np.array([0.5 * (v.min() + v.max()) for v in (columns, rows)])
            expected = np.mean([pixel_of((p.real, -0.15, p.imag)) for p in ends[part]], axis=0)
            np.testing.assert_allclose(centre, expected, atol=5.0, err_msg=part)
            centres[part, time] = centre
    way = {part: np.linalg.norm(centres[part, 4.0] - centres[part, 1.0]) for part in PINS}
    assert way[moving] > 20.0
    assert way["rod_pin" if moving == "cylinder_pin" else "cylinder_pin"] < 1.0  # at the thigh
    browser.require_health()


@pytest.mark.slow
@pytest.mark.parametrize(("size", "phone"), [((800, 600), False), ((390, 800), True)])
def test_a_page_plays_by_itself(size, phone, browser, tmp_path):
    leg, _ = leg_of_scenario("mine", scenario_of(simulation={"duration_s": 10.0}))
    page = tmp_path / "knee.html"
    page.write_text(view_page([leg, leg]), encoding="utf-8")
    browser.open(page, *size, phone=phone)
    pictures = browser.views_of_playing()
    for picture in pictures:  # legs on white ground
        below = picture[picture.shape[0] // 4 :]  # the caption
        assert 0.005 < (below.min(axis=2) < 0.9).mean() < 0.5
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 0.1).sum() > 300
    browser.require_health()
    browser.require_width()
    assert browser.evaluate("document.title") == "kneexo: mine, mine"


@pytest.mark.slow
def test_faults_of_a_page_are_heard(browser, tmp_path):
    page = tmp_path / "page.html"
    for fault in (
        "<script>throw new Error('x')</script>",
        "<script>console.error('x')</script>",
        "<script>nothing()</script>",
        "<img src='missing.png'>",
        "<iframe srcdoc='<script>nothing()</script>'></iframe>",
    ):
        page.write_text(f"<!DOCTYPE html>{fault}")
        browser.open(page)
        with pytest.raises(AssertionError):
            browser.require_health()
    page.write_text("<!DOCTYPE html><p style='width: 900px'>wide</p>")
    browser.open(page, 390, 800, phone=True)
    browser.require_health()
    with pytest.raises(AssertionError):
        browser.require_width()
