"""The arrow of a wearer's torque, and the limb of the wearer, in a browser."""

import numpy as np
import pytest

from kneexo.parameters import G1
from kneexo.view.parts import parts, placements

ARROW = """(async (time) => {
  stage.pause();
  stage.seek(time);
  for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
  const strokes = [];
  const context = new Proxy({ canvas: { width: 1e6 } }, {
    get: (own, name) => own[name] ?? ((...values) => {
      if (name === "lineTo") strokes.push(values);
      return { width: 0 };
    }),
    set: (own, name, value) => { own[name] = value; return true; },
  });
  const leg = stage.legs[0];
  const { angle, torque } = leg.at(time);
  const [shank, place] = [leg.pose("shank", angle), (x, z) => [x, z]];
  StageArrow.draw(context, shank, torque, stage._quarterTurn, place, 1);
  const { scene } = stage._drawing.items[0];
  const shin = scene.getObjectByName("shin").matrixWorld.elements.slice(12, 15);
  const rows = document.querySelectorAll(".stage-readout div:not([hidden]) dd");
  const legend = document.querySelector(".stage-legend").textContent;
  return { strokes, shin, texts: [...rows].map((e) => e.textContent), legend };
})"""


def worn_run():
    time = np.linspace(0.0, 4.0, 401)
    angle, reference = 0.7 - 0.7 * np.cos(time), 0.8 - 0.7 * np.cos(time)
    pressure = 2e6 * np.sin(time)
    return time, angle, reference, pressure, angle + 0.03 * np.sin(time), -42.0 * np.sin(time)


@pytest.mark.slow
def test_the_arrow_of_a_wearer_turns_with_his_torque_and_the_limb_with_his_angle(stage):
    """Against the shank of `placements`, which a positive torque flexes; a quarter turn: 50 N·m."""
    run = worn_run()
    browser = stage([G1], [run])
    for time in (0.6, 1.5, 3.9):
        angle, _, _, wearer, torque = (np.interp(time, run[0], column) for column in run[1:])
        shown = browser.evaluate(f"{ARROW}({time})")
        shank = placements(G1, angle, angle)["shank"]
        points = np.array([complex(*point) for point in shown["strokes"]]) - shank.origin[0]
        start, tip = points[0], points[33]
        assert abs(start / shank.direction[0] - 0.18) < 1e-4
        further = placements(G1, angle + 0.1, 0.0)["shank"].direction[0] / shank.direction[0]
        turned = np.angle(tip / start) / np.angle(further) * 0.1
        assert turned == pytest.approx(torque / 50.0 * 0.5 * np.pi, rel=0.05)
        (pose,) = placements(G1, angle, angle, wearer)["wearer"].poses()
        expected = (pose @ parts(G1)["shin"].pose).translation()
        np.testing.assert_allclose(shown["shin"], expected, atol=1e-4)
        sign = "+" if torque > 0.0 else "−"
        assert shown["texts"][-2:] == [f"{np.degrees(wearer):.1f}°", f"{sign}{abs(torque):.1f} N·m"]
        assert "a quarter turn is 50 N·m" in shown["legend"]
    browser.require_health()
    browser = stage([G1], [run[:4]])
    assert browser.evaluate("document.querySelectorAll('.stage-readout div[hidden]').length") == 2
    assert "wearer" not in browser.evaluate("document.querySelector('.stage-legend').textContent")


@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True])
def test_the_picture_has_the_arrow_beside_the_shank(stage, flat):
    """Pixels of the arrow's colour lie in front of the leg for a torque that extends the knee."""
    time, angle, reference, pressure, wearer, _ = worn_run()
    shares = []
    for torque in (40.0, -40.0):
        run = time, angle, reference, pressure, wearer, torque + 0.0 * time
        browser = stage([G1], [run], flat=flat)
        shares.append(
            browser.evaluate("""(async () => {
          stage.pause(); stage.seek(1.5); stage.turn(-stage.orbit.azimuth, -stage.orbit.elevation);
          for (let frame = 0; frame < 3; ++frame) await new Promise(requestAnimationFrame);
          const canvas = document.querySelector(".whole canvas");
          const { width, height } = canvas;
          const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
          const columns = [];
          for (let k = 0; k < width * height; ++k) {
            const [red, green, blue] = data.subarray(4 * k, 4 * k + 3);
            const isArrow = red < 8 && Math.abs(green - 0x56) < 8 && Math.abs(blue - 0x3f) < 8;
            if (isArrow) columns.push((k % width) / width);
          }
          const mean = columns.reduce((a, b) => a + b, 0) / columns.length;
          return [columns.length / (width * height), mean];
        })()""")
        )
    (size, flexing), (other, extending) = shares
    assert min(size, other) > 1e-3
    assert extending > flexing + 0.05
