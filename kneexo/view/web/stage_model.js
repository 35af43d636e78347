"use strict";

/* The legs of a stage as numbers: poses of frames over the knee angle, runs over time. */
const StageModel = (() => {
  /** Numbers from the text that `pack` of kneexo/view/stage.py writes. */
  function unpack(text) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }

  /** Index of the last time that is at most t, or 0. */
  function lastBefore(time, t) {
    let low = 0;
    let high = time.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (time[middle] <= t) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  class Leg {
    constructor(data) {
      this.data = data;
      this.name = data.name;
      this.run = null;
      this.frames = Object.fromEntries(
        Object.entries(data.frames).map(([name, text]) => [name, unpack(text)]),
      );
    }

    /** Last time of the run in s. */
    get end() {
      return this.run ? this.run.time[this.run.time.length - 1] : 0;
    }

    /**
     * Knee angle, reference and angle of the wearer in rad, pressure in Pa and torque of the wearer in
     * N·m at time t, linear between samples. A run without wearer has no torque.
     */
    at(t) {
      if (!this.run) return { angle: 0, reference: 0, wearer: 0, pressure: 0 };
      const { time } = this.run;
      const first = lastBefore(time, t);
      const second = Math.min(first + 1, time.length - 1);
      const width = time[second] - time[first];
      const share = width > 0 ? Math.min(Math.max((t - time[first]) / width, 0), 1) : 0;
      const mix = (values) => values[first] + share * (values[second] - values[first]);
      const { angle, reference, pressure, wearer, torque } = this.run;
      const common = { angle: mix(angle), reference: mix(reference), pressure: mix(pressure) };
      return { ...common, wearer: mix(wearer ?? angle), ...(torque && { torque: mix(torque) }) };
    }

    /** Torque in N·m of the push of the run that acts at a time, or 0. */
    pushAt(t) {
      const { torque, start_s, end_s } = this.run?.push ?? {};
      return t >= start_s && t < end_s ? torque : 0;
    }

    /** Pose of a frame at a knee angle in rad: x and z of its origin in m, turn of its x axis in rad. */
    pose(frame, angle) {
      const { low_rad: low, high_rad: high, rows } = this.data;
      const place = Math.min(Math.max((angle - low) / (high - low), 0), 1) * (rows - 1);
      const row = Math.min(Math.floor(place), rows - 2);
      const share = place - row;
      const table = this.frames[frame];
      return [0, 1, 2].map(
        (k) => table[3 * row + k] + share * (table[3 * row + 3 + k] - table[3 * row + k]),
      );
    }

    /** Poses of all frames in a state of `at`. */
    poses(state) {
      return Object.fromEntries(
        Object.keys(this.frames).map((frame) => [
          frame,
          this.pose(frame, ["reference", "wearer"].includes(frame) ? state[frame] : state.angle),
        ]),
      );
    }

    /** Red, green and blue of the cylinder at a pressure in Pa. */
    pressureColour(pressure) {
      const [low, none, high] = this.data.pressure_colours;
      const share = Math.min(Math.max(pressure / this.data.rating_pa, -1), 1);
      const full = share > 0 ? high : low;
      return none.map((value, k) => value + Math.abs(share) * (full[k] - value));
    }
  }

  const UNITS = [
    [1e6, "MPa"],
    [1e3, "kPa"],
    [1, "Pa"],
  ];

  /** A pressure as text with its unit and three digits, in bar if the page says so. */
  function pressureText(pressure, unitOfPage) {
    if (unitOfPage === "bar") return `${signed(pressure * 1e-5, 3)} bar`;
    if (Math.abs(pressure) < 0.5) return "0 Pa";
    const [factor, unit] = UNITS.find(([size]) => Math.abs(pressure) >= size) ?? UNITS[2];
    return `${signed(pressure / factor, 3)} ${unit}`;
  }

  /** A number with a minus sign in place of a hyphen and with `digits` digits, without an exponent. */
  function signed(value, digits) {
    const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(Math.abs(value) || 1)));
    const text = Math.abs(value).toFixed(Math.min(decimals, digits - 1));
    return value < 0 && Number(text) !== 0 ? `−${text}` : text;
  }

  const torqueText = (torque) => `${torque > 0 ? "+" : ""}${signed(torque, 3)} N·m`;

  /** Degrees with a fixed number of decimals. */
  function degrees(radians, decimals) {
    const text = Math.abs((radians * 180) / Math.PI).toFixed(decimals);
    return `${radians < 0 && Number(text) !== 0 ? "−" : ""}${text}°`;
  }

  /** The texts below a leg at a time. */
  function readout(leg, t) {
    const { angle, reference, pressure, wearer, torque } = leg.at(t);
    const share = (100 * Math.abs(pressure)) / leg.data.rating_pa;
    return {
      "knee angle": degrees(angle, 1),
      reference: degrees(reference, 1),
      error: degrees(reference - angle, 2),
      pressure: `${pressureText(pressure, leg.data.pressure_unit)}, ${share < 0.1 ? "< 0.1" : signed(share, 2)} % of rating`,
      ...(torque !== undefined && {
        "wearer's knee": degrees(wearer, 1),
        "wearer's torque": torqueText(torque),
      }),
    };
  }

  return { Leg, unpack, pressureText, readout, torqueText };
})();
