// Measures the response of the closed loop to sines, as kneexo.analysis.frequency.sine_estimate does, and
// the large-signal bandwidth, as kneexo.analysis.frequency.bandwidth does.
"use strict";

const SineSweep = (() => {
  // The values of SineEstimateSettings with which kneexo searches a bandwidth.
  const RAMP_CYCLES = 1;
  const RAMP_MIN_S = 0.5;
  const TOLERANCE = 2e-3;
  const AVERAGED_CYCLES = 2;
  const LARGEST_CYCLES = 6;

  const HARMONICS = 3; // see _HARMONICS in kneexo/analysis/frequency/sine_estimate.py
  const AT_LIMIT = 0.99; // share of a limit from which it counts as reached
  const LOWEST_HZ = 0.02;
  const SEARCH_STEP = 1.25;
  const GAIN_TOLERANCE = 2e-4;
  const FREQUENCY_TOLERANCE = 1e-5;
  const NO_GAIN = 1e-12;

  // -------------------------------------------------------------------------- one response

  // Fit mean, fundamental and harmonics to columns of samples; return the rows mean, cos, −sin.
  function fitted(time, frequency, columns) {
    const size = 2 * HARMONICS + 1;
    const normal = Array.from({ length: size }, () => new Array(size).fill(0));
    const right = columns.map(() => new Array(size).fill(0));
    const basis = new Array(size).fill(1);
    for (let k = 0; k < time.length; k++) {
      for (let n = 1; n <= HARMONICS; n++) {
        const phase = 2 * Math.PI * frequency * n * time[k];
        basis[2 * n - 1] = Math.cos(phase);
        basis[2 * n] = -Math.sin(phase);
      }
      for (let i = 0; i < size; i++) {
        for (let j = 0; j < size; j++) normal[i][j] += basis[i] * basis[j];
        columns.forEach((column, c) => (right[c][i] += basis[i] * column[k]));
      }
    }
    return right.map((side) => LinearLoop.solve(normal, side).slice(0, 3));
  }

  // The slope at t of the parabola through three points.
  function slopeOf(times, values, t) {
    return values.reduce((sum, value, i) => {
      const [a, b] = times.filter((_, j) => j !== i);
      return sum + (value * (2 * t - a - b)) / ((times[i] - a) * (times[i] - b));
    }, 0);
  }

  // The complex response [real, imaginary] in each cycle. A drift of the mean is removed.
  function cycleResponses(period, angle, reference, frequency, start, cycles) {
    const fits = [];
    for (let cycle = 0; cycle < cycles; cycle++) {
      // A sample on the border belongs to the next cycle, in spite of rounding of its time.
      const limits = [0, 1].map((k) => start + (cycle + k) / frequency - 1e-9);
      const [first, end] = limits.map((limit) => Math.min(Math.ceil(limit / period), angle.length));
      const middle = 0.5 * (limits[0] + limits[1]);
      const time = Float64Array.from({ length: end - first }, (_, k) => (first + k) * period);
      const ramp = time.map((t) => t - middle);
      const part = (signal) => signal.subarray(first, end);
      fits.push(fitted(time, frequency, [part(angle), part(reference), ramp]));
    }
    // The fit of a ramp gives the time to which a mean belongs and the fundamental of a drift.
    const times = fits.map(([, , ramp], cycle) => cycle / frequency + ramp[0]);
    const means = fits.map(([output]) => output[0]);
    return fits.map(([output, reference, ramp], cycle) => {
      const near = Math.min(Math.max(cycle - 1, 0), cycles - 3);
      const three = [times, means].map((column) => column.slice(near, near + 3));
      const drift = slopeOf(...three, times[cycle]);
      const [x, y] = [1, 2].map((part) => output[part] - drift * ramp[part]);
      return divide(x, y, reference[1], reference[2]);
    });
  }

  function divide(a, b, c, d) {
    const size = c * c + d * d;
    return [(a * c + b * d) / size, (b * c - a * d) / size];
  }

  // Count the last responses that agree, each with the next one.
  function settledCycles(responses) {
    let count = 1;
    for (let k = responses.length - 1; k > 0; k--, count++) {
      const [next, last] = [responses[k], responses[k - 1]];
      const change = Math.hypot(next[0] - last[0], next[1] - last[1]);
      if (change > TOLERANCE * Math.hypot(...next)) break;
    }
    return count;
  }

  // Gain, phase and saturation of the loop at one frequency. Throws if the run fails.
  async function respond(request, frequency, pause) {
    const period = Simulator.periodOf(request.model);
    if (frequency > (0.1 / period) * (1 + 1e-12)) {
      throw new Error(`${frequency} Hz is too high: must be <= ${0.1 / period} Hz`);
    }
    const ramp = Math.max(RAMP_CYCLES / frequency, RAMP_MIN_S);
    const sine = { "reference.frequency_hz": frequency, "reference.ramp_s": ramp, "push.torque_n_m": 0 };
    const values = { ...request.values, ...sine };
    for (let cycles = AVERAGED_CYCLES + 1; ; cycles = Math.min(2 * cycles, LARGEST_CYCLES)) {
      const duration_s = ramp + cycles / frequency;
      const { instance, columns, rows, end } = await Simulator.simulate(
        { ...request, reference: "sine", values, duration_s },
        pause,
        "sweep",
      );
      if (end) throw new Error(`${end.reason} at ${end.time_s.toPrecision(4)} s`);
      const angle = instance.output("knee_angle_rad", rows);
      const responses = cycleResponses(period, angle, columns[0], frequency, ramp, cycles);
      let count = settledCycles(responses);
      const settled = count >= AVERAGED_CYCLES;
      if (!settled && cycles < LARGEST_CYCLES) continue;
      if (!settled) count = Math.max(AVERAGED_CYCLES, Math.floor(cycles / 2));
      const speed = instance.output("motor_speed_rad_s", rows);
      const limits = Simulator.limitsOf(request.model, values);
      const from = Math.floor(rows - 1 - count / frequency / period + 1e-9) + 1;
      return {
        ...pointOf(frequency, responses.slice(-count), settled),
        ...saturation(speed.subarray(from), period, limits),
      };
    }
  }

  function pointOf(frequency, responses, settled) {
    const [x, y] = [0, 1].map((i) => responses.reduce((sum, r) => sum + r[i], 0) / responses.length);
    const phase = (Math.atan2(y, x) * 180) / Math.PI;
    return { frequency_hz: frequency, gain: Math.hypot(x, y), phase_deg: phase, settled };
  }

  // The shares of the samples at the speed limit, at the acceleration limit, and at either limit.
  function saturation(speed, period, limits) {
    const fast = (k) => Math.abs(speed[k]) >= AT_LIMIT * limits.motor_speed_limit_rad_s;
    const steep = AT_LIMIT * limits.motor_acceleration_limit_rad_s2 * period;
    const hard = (k) => Math.abs(speed[k + 1] - speed[k]) >= steep;
    const count = (holds, size) => {
      let sum = 0;
      for (let k = 0; k < size; k++) sum += holds(k);
      return sum / size;
    };
    const size = speed.length;
    return {
      speed_limited_share: count(fast, size),
      acceleration_limited_share: count(hard, size - 1),
      saturated_share: count((k) => fast(k) || (k + 1 < size && hard(k)), size),
    };
  }

  // -------------------------------------------------------------------------------- search

  // Search the frequency at which the gain first falls below 1/√2. ``excess`` measures ln(gain √2) at
  // ln f. Return null if the gain does not fall that far.
  async function firstFall(excess, known, near, top) {
    const bottom = Math.log(LOWEST_HZ);
    const sorted = [...known].sort((a, b) => a[0] - b[0]);
    const fall = sorted.findIndex(([, e], k) => k > 0 && e < 0 && sorted[k - 1][1] >= 0);
    if (fall > 0) return root(excess, sorted[fall - 1], sorted[fall]);
    const above = sorted.length > 0 && sorted[0][1] >= 0;
    const start = Math.min(Math.max(near, bottom), top);
    let [low, value] = sorted.at(above ? -1 : 0) ?? [start, await excess(start)];
    while (value < 0) {
      if (low === bottom) return null;
      // A limit of the speed makes the gain fall as 1/f, so that the fall is near f gain √2.
      low = Math.max(Math.min(low - Math.log(SEARCH_STEP), low + value - 0.1), bottom);
      value = await excess(low);
    }
    let last = [low, value];
    while (last[0] < top) {
      const high = Math.min(last[0] + Math.log(SEARCH_STEP), top);
      const next = [high, await excess(high)];
      if (next[1] < 0) return root(excess, last, next);
      last = next;
    }
    return null;
  }

  // Return the zero of a falling function between two points by the Illinois method. The value at an
  // end that stays for the second time counts half.
  async function root(excess, [a, fa], [b, fb]) {
    let side = 0;
    while (b - a > FREQUENCY_TOLERANCE) {
      const middle = (a * fb - b * fa) / (fb - fa);
      const value = await excess(middle);
      if (Math.abs(value) < GAIN_TOLERANCE) return Math.exp(middle);
      if (value < 0) {
        [b, fb, fa] = [middle, value, side < 0 ? fa / 2 : fa];
        side = -1;
      } else {
        [a, fa, fb] = [middle, value, side > 0 ? fb / 2 : fb];
        side = 1;
      }
    }
    return Math.exp(0.5 * (a + b));
  }

  // The answer to a request of kind "sweep". ``send`` receives each point when it is measured. The
  // search for the −3 dB frequency adds points to the requested frequencies.
  async function sweep(request, pause, send) {
    const model = Simulator.modelOf(request);
    const values = Simulator.valuesOf(model, "sine", request.values);
    const known = [];
    const excess = async (logarithm, frequency = Math.exp(logarithm)) => {
      await pause();
      const point = await respond({ ...request, model, values }, frequency, pause);
      send({ point });
      const value = Math.log(Math.max(point.gain, NO_GAIN) * Math.SQRT2);
      known.push([logarithm, value]);
      return value;
    };
    try {
      if (!(values["reference.amplitude_deg"] > 0)) throw new Error("the amplitude is 0°");
      for (const frequency of request.frequencies ?? []) await excess(Math.log(frequency), frequency);
      const top = Math.log(0.1 / Simulator.periodOf(model));
      const near = Math.log(request.near_hz ?? 1);
      return { minus_3_db_hz: await firstFall(excess, known, near, top) };
    } catch (error) {
      if (error.cancelled) throw error;
      return { minus_3_db_hz: null, failure: error.message };
    }
  }

  return { sweep, respond, firstFall, cycleResponses };
})();
