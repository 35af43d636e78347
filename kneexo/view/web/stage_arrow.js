"use strict";

/* The torque of the wearer on the exoskeleton as a curved arrow about the knee. */
const StageArrow = (() => {
  const COLOUR = "#00563f";
  const RADIUS_M = 0.18; // a quarter turn stays in the picture
  const HEAD_M = 0.045;
  const LEAST_RAD = 0.02;

  /** Return the torque in N·m of a quarter turn, a round number. It is 0 if no run has a wearer. */
  function scaleOf(legs) {
    const torques = legs.map((leg) => leg.run?.torque).filter((torque) => torque);
    if (torques.length === 0) return 0;
    const largest = torques.reduce(
      (most, torque) => torque.reduce((a, b) => Math.max(a, Math.abs(b)), most), 1e-3);
    const power = 10 ** Math.floor(Math.log10(largest));
    return power * [1, 1.5, 2, 3, 5, 7, 10].find((step) => step * power >= largest);
  }

  /** Call `paint` for a white edge and then for the colour. The edge shows on every background. */
  function edged(context, pixels, paint) {
    for (const [colour, edge] of [["#fff", 4 * pixels], [COLOUR, 0]]) {
      Object.assign(context, { strokeStyle: colour, fillStyle: colour, lineWidth: edge });
      paint(edge);
    }
  }

  function trace(context, points) {
    context.beginPath();
    for (const point of points) context.lineTo(...point);
  }

  /**
   * Draw the arrow of a torque in N·m. It starts at the shank, whose pose is x, z in m and a turn.
   * `place` converts x and z in m to pixels of the canvas, of which a CSS pixel has `pixels`.
   */
  function draw(context, [x, z, shank], torque, scale, place, pixels) {
    const sweep = (-0.5 * Math.PI * torque) / scale; // flexion turns the shank clockwise
    if (!(Math.abs(sweep) > LEAST_RAD)) return;
    const at = (radius, angle, ahead = 0) => place(
      x + radius * Math.cos(angle) - ahead * Math.sin(angle),
      z + radius * Math.sin(angle) + ahead * Math.cos(angle));
    const size = Math.min(HEAD_M, Math.abs(sweep) * RADIUS_M);
    const end = shank + sweep - (Math.sign(sweep) * size) / RADIUS_M;
    const arc = Array.from({ length: 33 }, (_, k) => at(RADIUS_M, shank + (k / 32) * (end - shank)));
    const sides = [0.5, -0.5].map((share) => at(RADIUS_M + share * size, end));
    const head = [at(RADIUS_M, end, Math.sign(sweep) * size), ...sides];
    edged(context, pixels, (edge) => {
      context.lineWidth += 5 * pixels;
      trace(context, arc);
      context.stroke();
      trace(context, head);
      context.closePath();
      context.lineWidth = edge;
      if (edge) context.stroke();
      context.fill();
    });
    label(context, StageModel.torqueText(torque), head[0], at(RADIUS_M, end), pixels);
  }

  /** Write a text beyond the tip of an arrow that points from `base` to `tip`, within the canvas. */
  function label(context, text, tip, base, pixels) {
    context.font = `600 ${13 * pixels}px system-ui, sans-serif`;
    Object.assign(context, { textAlign: "center", textBaseline: "middle", lineJoin: "round" });
    const half = 0.5 * context.measureText(text).width + 4 * pixels;
    const [right, down] = [0, 1].map((k) => tip[k] - base[k]);
    const length = Math.hypot(right, down);
    const beyond = tip[0] + (right / length) * (half + 6 * pixels);
    const x = Math.min(Math.max(beyond, half), context.canvas.width - half);
    const below = x === beyond ? 0 : 20; // the text would cover the arrow
    const y = tip[1] + ((down / length) * 14 + below) * pixels;
    edged(context, pixels, (edge) => {
      if (edge) context.strokeText(text, x, y);
      else context.fillText(text, x, y);
    });
  }

  return { COLOUR, draw, scaleOf };
})();
