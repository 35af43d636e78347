"""The data of a stage, and the stage in a browser against the placements of the parts."""

import base64
import json

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid
from pydrake.math import RigidTransform

from kneexo.errors import LinkageError
from kneexo.parameters import G1, LINKAGES, LinkageParameters
from kneexo.view.mechanism import points
from kneexo.view.parts import parts, placements
from kneexo.view.pressure_colour import pressure_colours
from kneexo.view.stage import stage_leg

RATING_PA = 3.5e6


def unpack(text):
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def a_run(end_s=4.0, pressure=2e6):
    time = np.linspace(0.0, end_s, 401)
    return time, 0.7 - 0.7 * np.cos(time), 0.8 - 0.7 * np.cos(time), pressure * np.sin(time)


# ------------------------------------------------------------------------------------ data


@pytest.mark.parametrize("name", sorted(LINKAGES))
def test_interpolated_frames_are_within_a_tenth_of_a_millimetre(name):
    """Against the linkage between the rows, at the farthest point of each part."""
    link = LINKAGES[name]
    data = stage_leg(name, link, np.radians(-2.0), np.radians(95.0), RATING_PA)
    json.dumps(data, allow_nan=False)
    rows = np.linspace(data["low_rad"], data["high_rad"], data["rows"])
    between = 0.5 * (rows[1:] + rows[:-1])
    expected = placements(link, between, between)
    assert set(data["frames"]) == set(expected)
    for frame, text in data["frames"].items():
        x, z, turn = unpack(text).reshape(-1, 3).astype(float).T
        x, z, turn = (0.5 * (values[1:] + values[:-1]) for values in (x, z, turn))
        reach = max(
            np.hypot(*np.abs(p["position"])[[0, 2]]) + max(p["size"])
            for p in data["parts"]
            if p["frame"] == frame
        )
        error = np.abs(x + 1j * z - expected[frame].origin)
        error += reach * np.abs(np.exp(1j * turn) - expected[frame].direction)
        assert error.max() < 1e-4, frame


def test_parts_have_the_shapes_colours_and_poses_of_the_live_view():
    data, leg = stage_leg("x", G1, 0.0, 0.0, RATING_PA), parts(G1)
    assert [part["name"] for part in data["parts"]] == list(leg)
    for part in data["parts"]:
        x, y, z, w = part["quaternion"]
        expected = leg[part["name"]]
        pose = RigidTransform(Quaternion(wxyz=np.array([w, x, y, z])), part["position"])
        assert pose.IsNearlyEqualTo(expected.pose, 1e-8)
        shape = {"cylinder": Cylinder, "capsule": Capsule, "ellipsoid": Ellipsoid, "box": Box}[
            part["shape"]
        ]
        assert type(expected.shape) is shape
        assert repr(shape(*part["size"])) == repr(expected.shape)
        assert part["colour"] == list(expected.colour.rgba)


def test_both_centres_are_drawn_where_they_are_and_the_legend_has_the_migration():
    linkage, wearer = stage_leg("G1", G1, 0.0, 1.6, RATING_PA)["centre_paths"]
    at_45 = points(G1, np.radians(45.0))["icr"][0]
    assert linkage["points"][45] == pytest.approx([at_45.real, at_45.imag], abs=1e-6)
    # The centre of gait2392 at 45°, backwards and up, minus the best place of G1, in mm.
    assert wearer["points"][45] == pytest.approx(
        [-1e-3 * (9.9 - 20.7), 1e-3 * (-12.8 + 10.5)], abs=0.15e-3
    )
    assert wearer["label"].endswith("the strap migrates by 3.1 mm (rms)")


def test_the_hull_contains_the_ends_of_all_bars():
    from scipy.spatial import Delaunay

    data = stage_leg("x", G1, 0.0, 0.0, RATING_PA)
    hull = Delaunay(data["hull"])
    for part in data["parts"]:
        if part["shape"] != "cylinder":
            continue
        for angle in (0.0, 0.5 * np.pi):
            pose = (
                next(placements(G1, angle, angle)[part["frame"]].poses())
                @ parts(G1)[part["name"]].pose
            )
            for sign in (-0.499, 0.499):
                end = pose.multiply(np.array([0.0, 0.0, sign * part["size"][1]]))
                assert hull.find_simplex(end) >= 0, part["name"]


def test_a_linkage_that_does_not_close_is_refused():
    link = LinkageParameters(**(G1.model_dump() | {"a_4_m": 0.010}))
    with pytest.raises(LinkageError, match="cannot be assembled"):
        stage_leg("x", link, 0.0, 1.0, RATING_PA)


# --------------------------------------------------------------------------------- browser

MATRICES = """(async (time) => {
  stage.pause();
  stage.seek(time);
  for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
  return stage.legs.map((leg, index) => {
    const { scene, cylinder } = stage._drawing.items[index];
    scene.updateMatrixWorld();
    const places = {};
    scene.traverse((object) => {
      if (object.name) (places[object.name] ??= []).push(object.matrixWorld.elements);
    });
    return { places, colour: cylinder.color.getRGB({}, THREE.SRGBColorSpace) };
  });
})"""


@pytest.mark.slow
def test_a_browser_places_all_parts_where_the_placements_have_them(stage):
    names = sorted(LINKAGES)
    links = [LINKAGES[name] for name in names]
    runs = [a_run(pressure=p) for p in (2e6, -4e6, 2e3, 3e6, 1e6, -1e6)]
    browser = stage(links, runs)
    for time in (0.0, 1.234, 3.1):
        shown = browser.evaluate(f"{MATRICES}({time})")
        for link, run, leg in zip(links, runs, shown, strict=True):
            angle, reference, pressure = (np.interp(time, run[0], values) for values in run[1:])
            frames = placements(link, angle, reference)
            for name, part in parts(link).items():
                expected = (next(frames[part.frame].poses()) @ part.pose).GetAsMatrix4()
                for elements in leg["places"][name]:
                    matrix = np.reshape(elements, (4, 4)).T
                    np.testing.assert_allclose(matrix[:3, 3], expected[:3, 3], atol=1e-4)
                    np.testing.assert_allclose(matrix[:3, :3], expected[:3, :3], atol=2e-4)
            colour = pressure_colours(np.array([pressure]), RATING_PA)[0]
            np.testing.assert_allclose([leg["colour"][c] for c in "rgb"], colour, atol=1e-5)
    browser.require_health()


@pytest.mark.slow
def test_numbers_and_time_follow_the_run(stage):
    browser = stage([G1], [a_run(pressure=-2e3)], motion=True)
    browser.wait_for("stage.time > 0.05")
    assert browser.evaluate("stage.playing")
    browser.evaluate(f"{MATRICES}(1.5)")
    time, angle, reference, pressure = a_run(pressure=-2e3)
    angle, reference, pressure = (np.interp(1.5, time, v) for v in (angle, reference, pressure))
    cells = browser.evaluate(
        "[...document.querySelectorAll('.stage-readout div:not([hidden]) dd')]"
        ".map((e) => e.textContent)"
    )
    expected = [
        f"{np.degrees(angle):.1f}°",
        f"{np.degrees(reference):.1f}°",
        f"{np.degrees(reference - angle):.2f}°",
        f"−{-1e-3 * pressure:.2f} kPa, < 0.1 % of rating",
    ]
    assert cells == expected
    assert (
        browser.evaluate("document.querySelector('.stage-bar output').textContent")
        == "1.50 of 4.0 s"
    )
    assert browser.evaluate("stage.duration") == 4.0
    curve = browser.evaluate("stage._trace.plot.data[1]")
    np.testing.assert_allclose(curve, np.degrees(a_run()[2] - a_run()[1]), atol=1e-9)
    x, y = browser.evaluate("""(() => {
      const over = document.querySelector(".u-over");
      over.scrollIntoView();
      const box = over.getBoundingClientRect();
      return [box.left + 0.25 * box.width, box.top + 0.9 * box.height];
    })()""")
    for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
        button = "none" if kind == "mouseMoved" else "left"
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1)
    assert browser.evaluate("stage.time") == pytest.approx(1.0, abs=0.02)
    browser.require_health()


PRESS = """(async (key, options) => {
  const canvas = document.querySelector(".stage canvas");
  canvas.focus();
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, ...options }));
  await new Promise(requestAnimationFrame);
  return [stage.playing, stage.time, stage.orbit.azimuth];
})"""


@pytest.mark.slow
def test_keys_play_and_move_the_time(stage):
    browser = stage([G1], [a_run()])

    def press(key, **options):
        return browser.evaluate(f"{PRESS}({json.dumps(key)}, {json.dumps(options)})")

    browser.evaluate("stage.pause(), stage.seek(1), null")
    before = press("ArrowRight")
    assert before[:2] == [False, pytest.approx(1.1)]
    assert press("ArrowLeft")[1] == pytest.approx(1.0)
    assert press("ArrowLeft", shiftKey=True)[1:] == [pytest.approx(1.0), before[2] - 0.1]
    assert press("End")[1] == 4.0
    assert press("ArrowRight")[1] == 4.0
    assert press("Home")[1] == 0.0
    assert press(" ")[0] is True
    assert press(" ")[0] is False
    browser.evaluate("stage.loop = false, stage.speed = 100, stage.play(), null")
    browser.wait_for("!stage.playing")
    assert browser.evaluate("stage.time") == 4.0


@pytest.mark.slow
def test_a_slow_stage_rests_and_a_quick_one_does_not(stage):
    browser = stage([G1], [a_run()])
    clock = "document.querySelector('.stage-bar output').textContent"
    browser.evaluate("window.now_ms = 0, performance.now = () => now_ms, null")
    browser.evaluate("stage.pause(), stage.seek(1), null")
    browser.wait_for(f"{clock} === '1.00 of 4.0 s'")
    rest = "stage._frame_ms = %g, stage.rest(%g), stage.time = %g, stage.setName(0, 'x'), null"
    browser.evaluate(rest % (50, 300, 1.5))
    browser.evaluate("new Promise(requestAnimationFrame).then(() => 0)")
    assert browser.evaluate(clock) == "1.00 of 4.0 s"
    browser.evaluate("now_ms = 300, null")
    browser.wait_for(f"{clock} === '1.50 of 4.0 s'")
    browser.evaluate(rest % (5, 1e6, 2))
    browser.wait_for(f"{clock} === '2.00 of 4.0 s'")
    browser.evaluate(rest % (50, 1e6, 3))
    browser.evaluate("stage.seek(2.5), null")  # an action of the user
    browser.wait_for(f"{clock} === '2.50 of 4.0 s'")


@pytest.mark.slow
def test_a_drag_turns_the_legs_and_the_wheel_scrolls_the_page(stage):
    browser = stage([G1], [a_run()], (800, 400))

    def mouse(kind, x, y, **options):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **options)

    before = browser.evaluate("stage.orbit")
    mouse("mousePressed", 200, 200, button="left", buttons=1, clickCount=1)
    mouse("mouseMoved", 150, 230, button="left", buttons=1)
    mouse("mouseReleased", 150, 230, button="left", clickCount=1)
    mouse("mouseMoved", 300, 300)
    after = browser.evaluate("stage.orbit")
    assert after["azimuth"] - before["azimuth"] == pytest.approx(0.4)
    assert after["elevation"] - before["elevation"] == pytest.approx(0.24)
    mouse("mouseWheel", 200, 200, deltaX=0, deltaY=100)
    browser.wait_for("scrollY > 0")
    assert browser.evaluate("stage.orbit.zoom") == 1.0
    mouse("mouseWheel", 200, 200, deltaX=0, deltaY=-100, modifiers=2)  # Ctrl
    browser.wait_for("stage.orbit.zoom > 1")
    browser.evaluate("stage.resetView(), null")
    assert browser.evaluate("stage.orbit") == before
    assert (
        browser.evaluate("getComputedStyle(document.querySelector('canvas')).touchAction")
        == "pan-y"
    )


@pytest.mark.slow
def test_less_motion_waits_for_play_and_paper_has_the_whole_curve(stage, browser):
    stage([G1], [a_run()])
    browser.evaluate("new Promise((done) => setTimeout(done, 300))")
    assert browser.evaluate("[stage.playing, stage.time]") == [False, 0]
    width = "document.querySelector('.stage-trace canvas').clientWidth"
    assert browser.evaluate(width) > 1200
    browser.evaluate("window.dispatchEvent(new Event('beforeprint')), null")
    browser.wait_for(f"{width} === 600")
    browser.evaluate("window.dispatchEvent(new Event('afterprint')), null")
    browser.wait_for(f"{width} > 1200")


@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize(("size", "phone"), [((1440, 1000), False), ((390, 800), True)])
def test_the_leg_fills_its_box(stage, flat, size, phone):
    """The leg takes most of its box, straight or bent, and no part is cut."""
    browser = stage([G1], [a_run()], size, phone, flat=flat)
    script = """(async (time) => {
      stage.pause();
      stage.seek(time);
      stage.turn(-stage.orbit.azimuth, 0);
      for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
      const canvas = document.querySelector(".whole canvas");
      const { width, height } = canvas;
      const data = canvas.getContext("2d").getImageData(0, 0, width, height).data;
      const ends = [1, 0, 1, 0];
      for (let k = 0; k < width * height; ++k) {
        if (data[4 * k + 3] === 0) continue;
        const [row, column] = [Math.floor(k / width) / height, (k % width) / width];
        ends[0] = Math.min(ends[0], row);
        ends[1] = Math.max(ends[1], row);
        ends[2] = Math.min(ends[2], column);
        ends[3] = Math.max(ends[3], column);
      }
      return ends;
    })"""
    straight, bent = (browser.evaluate(f"{script}({time})") for time in (0.0, 3.1))
    browser.evaluate("document.querySelector('.whole').style.flex = '0 0 8rem', null")
    narrow = browser.evaluate(f"{script}(3.1)")
    for top, bottom, left, right in (straight, bent, narrow):
        assert min(top, left) > 0.004
        assert max(bottom, right) < 0.996
    share = max(straight[1] - straight[0], bent[3] - bent[2])
    assert share > 0.7
    browser.require_width()
    browser.require_health()


@pytest.mark.slow
def test_slow_frames_get_fewer_pixels_and_a_still_picture_all(stage):
    browser = stage([G1], [a_run()])
    canvas = "document.querySelector('.whole canvas')"
    width = f"{canvas}.width"
    frame = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    browser.evaluate("stage._adapt = () => {}, stage._sharpness = 0.5, stage.play(), null")
    browser.evaluate(frame)
    moving = browser.evaluate(width)
    browser.evaluate("stage.pause(), null")
    browser.evaluate(frame)
    box = browser.evaluate(f"{canvas}.clientWidth")
    assert moving == pytest.approx(0.5 * box, abs=1.0)
    assert browser.evaluate(width) >= box
    script = """(() => {  // in one script, so that no frame comes between
      delete stage._adapt;
      stage.play();
      stage._sharpness = 1;
      return [100, 20, 5].map((frame_ms) => (stage._adapt(frame_ms), stage._sharpness));
    })()"""
    assert browser.evaluate(script) == pytest.approx([0.85, 0.85, 0.935])
    browser = stage([G1], [a_run()], (800, 600))  # a small picture keeps its pixels
    browser.evaluate("stage._adapt = () => {}, stage._sharpness = 0.1, stage.play(), null")
    browser.evaluate(frame)
    pixels = browser.evaluate(f"{canvas}.width * {canvas}.height")
    assert pixels == pytest.approx(120_000, rel=0.01)


@pytest.mark.slow
def test_pressures_are_in_words_with_their_share_of_the_rating(stage):
    browser = stage([G1], [a_run()])
    script = """[1.2e6, -2.5e3, 40, 0.1, -7e6].map((pressure) => {
      const run = { time: [0], angle: [0], reference: [0], pressure: [pressure] };
      return StageModel.readout(Object.assign(stage.legs[0], { run }), 0).pressure;
    })"""
    assert browser.evaluate(script) == [
        "1.20 MPa, 34 % of rating",
        "−2.50 kPa, < 0.1 % of rating",
        "40.0 Pa, < 0.1 % of rating",
        "0 Pa, < 0.1 % of rating",
        "−7.00 MPa, 200 % of rating",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LINKAGES))
def test_a_drawing_from_the_side_has_all_parts_at_their_places(name, stage):
    """The transformation of the canvas when it draws a part, against the pose of the part."""
    link = LINKAGES[name]
    browser = stage([link], [a_run()], flat=True)
    browser.evaluate("stage.pause(), null")
    script = """(() => {
      const { leg, parts } = stage._drawing.items[0];
      const poses = leg.poses({ angle: 0.9, reference: 0.5, wearer: 0.7 });
      const context = document.createElement("canvas").getContext("2d");
      let matrix;
      context.beginPath = () => { matrix = context.getTransform(); };
      return parts.map((part) => {
        stage._drawing._part(context, part, poses[part.frame], part.colour);
        return [part.name, matrix.e, matrix.f, matrix.c, matrix.d];
      });
    })()"""
    frames, leg = placements(link, 0.9, 0.5, 0.7), parts(link)
    drawn = browser.evaluate(script)
    assert {name for name, *_ in drawn} == set(leg)
    for name, x, z, along_x, along_z in drawn:
        pose = next(frames[leg[name].frame].poses()) @ leg[name].pose
        np.testing.assert_allclose([x, z], pose.translation()[[0, 2]], atol=1e-4, err_msg=name)
        axis = pose.rotation().matrix()[[0, 2], 2]
        if np.hypot(*axis) > 0.5:
            np.testing.assert_allclose([along_x, along_z], axis, atol=1e-3, err_msg=name)


@pytest.mark.slow
def test_a_canvas_shows_the_same_leg_without_webgl(stage):
    """From the side both drawings cover the same pixels, but for perspective and the outline."""
    masks = []
    for flat in (False, True):
        browser = stage([G1], [a_run()], flat=flat)
        assert browser.evaluate("stage._drawing instanceof StageFlat") is flat
        script = """(async () => {
          stage.pause(); stage.seek(1.2); stage.turn(-stage.orbit.azimuth, -stage.orbit.elevation);
          for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
          const canvas = document.querySelector(".whole canvas");
          const small = document.createElement("canvas");
          small.width = small.height = 120;
          small.getContext("2d").drawImage(canvas, 0, 0, 120, 120);
          const { data } = small.getContext("2d").getImageData(0, 0, 120, 120);
          return Array.from({ length: 14400 }, (_, k) => Number(data[4 * k + 3] > 80));
        })()"""
        masks.append(np.array(browser.evaluate(script)).reshape(120, 120)[:104])  # above the ground
        browser.require_health()
    ends = [[np.flatnonzero(mask.any(axis=k))[[0, -1]] for k in (0, 1)] for mask in masks]
    solid, flat = (
        m[y[0] : y[1] + 1, x[0] : x[1] + 1] for m, (x, y) in zip(masks, ends, strict=True)
    )
    assert abs(solid.shape[0] - flat.shape[0]) < 8
    assert abs(solid.shape[1] - flat.shape[1]) < 8
    size = np.minimum(solid.shape, flat.shape)
    solid, flat = (mask[: size[0], : size[1]] for mask in (solid, flat))
    share = (solid != flat).sum() / solid.sum()
    assert share < 0.35
