"use strict";

/* Draws legs from the side by canvas, where a browser has no WebGL. */
const StageFlat = (() => {
  /** The angle of a part's z axis from z towards x in rad, or null if this axis is across the plane. */
  function turnOf([x, y, z, w]) {
    const along = [2 * (x * z + w * y), 1 - 2 * (x * x + y * y)];
    return Math.hypot(...along) < 0.5 ? null : Math.atan2(...along);
  }

  /** Add the outline of a part to a path, with its middle at the origin and its z axis up. */
  function trace(context, part, turn) {
    const [a, b, c] = part.size;
    if (part.shape === "ellipsoid") context.ellipse(0, 0, a, c, 0, 0, 2 * Math.PI);
    else if (part.shape === "box") context.rect(-a / 2, -c / 2, a, c);
    else if (turn === null) context.arc(0, 0, a, 0, 2 * Math.PI);
    else if (part.shape === "capsule") context.roundRect(-a, -b / 2 - a, 2 * a, b + 2 * a, a);
    else context.rect(-a, -b / 2, 2 * a, b);
  }

  /** The least y coordinate of a part. The y axis points away from the viewer. */
  function nearest({ position, quaternion, role, shape, size }) {
    if (role === "skin") return position[1]; // behind brace and linkage
    const isAcross = turnOf(quaternion) === null;
    const depth = shape === "box" || isAcross ? size[1] / 2 : size[shape === "ellipsoid" ? 1 : 0];
    return position[1] - depth;
  }

  const css = ([red, green, blue, alpha = 1]) =>
    `rgb(${255 * red} ${255 * green} ${255 * blue} / ${alpha})`;

  class StageFlat {
    constructor(legs) {
      this.stillPixels = 1;
      this.items = legs.map((leg) => ({
        leg,
        state: leg.at(0),
        parts: leg.data.parts.toSorted((a, b) => nearest(b) - nearest(a)), // the far ones first
      }));
    }

    pose(index, state) {
      this.items[index].state = state;
    }

    /** Draw a leg, or only its linkage, into a canvas. Return the function from x and z to pixels. */
    draw(index, canvas, orbit, onlyLinkage) {
      const { leg, parts, state } = this.items[index];
      const context = canvas.getContext("2d");
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.clearRect(0, 0, canvas.width, canvas.height);
      this._look(context, canvas, onlyLinkage ? leg.data.joint_hull : leg.data.hull, orbit.zoom);
      const poses = leg.poses(state);
      for (const part of parts) {
        if (onlyLinkage && (part.role === "skin" || part.role === "ghost")) continue;
        const colour =
          part.name === "cylinder" ? leg.pressureColour(state.pressure) : part.colour;
        this._part(context, part, poses[part.frame], colour);
      }
      for (const path of leg.data.centre_paths) this._path(context, path);
      const seen = context.getTransform();
      context.resetTransform();
      return (x, z) => [seen.a * x + seen.e, seen.d * z + seen.f];
    }

    /** Scale the picture so that it contains all points, with x to the right and z up. */
    _look(context, { width, height }, points, zoom) {
      const [xs, zs] = [points.map((point) => point[0]), points.map((point) => point[2])];
      const [left, right] = [Math.min(...xs), Math.max(...xs)];
      const [low, high] = [Math.min(...zs), Math.max(...zs)];
      const scale = 0.96 * zoom * Math.min(width / (right - left), height / (high - low));
      context.translate(width / 2, height / 2);
      context.scale(scale, -scale);
      context.translate(-(left + right) / 2, -(low + high) / 2);
      this.pixel = 1 / scale;
    }

    _part(context, part, [x, z, turn], colour) {
      const tilt = turnOf(part.quaternion);
      context.save();
      context.translate(x, z);
      context.rotate(turn);
      context.translate(part.position[0], part.position[2]);
      context.rotate(-(tilt ?? 0));
      context.beginPath();
      trace(context, part, tilt);
      if (part.role === "ghost") {
        context.strokeStyle = "#15181c";
        context.lineWidth = 2 * this.pixel;
        context.setLineDash([6 * this.pixel, 4 * this.pixel]);
        context.stroke();
      } else {
        context.fillStyle = css(colour);
        context.fill();
      }
      context.restore();
    }

    _path(context, { points, colour }) {
      context.beginPath();
      for (const [x, z] of points) context.lineTo(x, z);
      context.strokeStyle = colour;
      context.lineWidth = 1.5 * this.pixel;
      context.stroke();
    }
  }

  return StageFlat;
})();
