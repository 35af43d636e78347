// Linearizes a sampled loop and computes its margins, as kneexo.analysis.linear.sampled_loop and
// diagramc.margins do. The linear model comes from differences of single ticks of the module
// without quantizers.
"use strict";

const LinearLoop = (() => {
  const STEP = 1e-6; // largest relative step of the central differences
  const CONTROLLER_STEP = 1e-3; // largest change of the controller's states, such as rad/s, by a step
  const PERTURBATION_STEP_RAD_S = 1e-2;
  const NEWTON_STEPS = 50;
  const NO_FACTOR = 1e-4; // a smaller gain margin is the rounding error of a pole at frequency zero
  const LOWEST_HZ = 0.01;
  const GRID_POINTS = 1000;
  const FINEST = 10; // bisections of an interval of the grid
  // Distances from a resonance in units of its half width.
  const WIDTHS = Array.from({ length: 41 }, (_, k) => 1e-2 * 10 ** (k / 8));
  const REFERENCE_SIZE = 4; // θ_d and three derivatives

  // ------------------------------------------------------------------------------ matrices
  // A matrix is an array of rows.

  const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);

  const column = (matrix, j) => matrix.map((row) => row[j]);

  const product = (a, b) => {
    const columns = b[0].map((_, j) => column(b, j));
    return a.map((row) => columns.map((other) => dot(row, other)));
  };

  // Solve a square system by elimination with complete pivoting. An unknown without influence is 0.
  function solve(matrix, right) {
    const rows = matrix.map((row, i) => [...row, right[i]]);
    const n = rows.length;
    const order = [...rows.keys()]; // unknown of each column
    let rank = 0;
    let scale = 0;
    for (; rank < n; rank++) {
      const [r, c] = pivotOf(rows, rank, n);
      const size = Math.abs(rows[r][c]);
      scale ||= size;
      if (size <= 1e-14 * scale) break;
      [rows[rank], rows[r]] = [rows[r], rows[rank]];
      for (const row of rows) [row[rank], row[c]] = [row[c], row[rank]];
      [order[rank], order[c]] = [order[c], order[rank]];
      for (let i = rank + 1; i < n; i++) {
        const factor = rows[i][rank] / rows[rank][rank];
        for (let j = rank; j <= n; j++) rows[i][j] -= factor * rows[rank][j];
      }
    }
    const solution = new Array(n).fill(0);
    for (let i = rank - 1; i >= 0; i--) {
      let rest = rows[i][n];
      for (let j = i + 1; j < rank; j++) rest -= rows[i][j] * solution[order[j]];
      solution[order[i]] = rest / rows[i][i];
    }
    return solution;
  }

  function pivotOf(rows, first, n) {
    let place = [first, first];
    for (let i = first; i < n; i++) {
      for (let j = first; j < n; j++) {
        if (Math.abs(rows[i][j]) > Math.abs(rows[place[0]][place[1]])) place = [i, j];
      }
    }
    return place;
  }

  // The largest magnitude of an eigenvalue: the limit of |A^m|^(1/m), for m = 2, 4, 8 … 2^50.
  function spectralRadius(matrix) {
    let power = matrix;
    let logarithm = 0; // of the factor by which the powers were scaled
    let exponent = 1;
    for (let k = 0; k < 50; k++) {
      const size = Math.hypot(...power.flat());
      if (size === 0) return 0;
      logarithm += Math.log(size) / exponent;
      power = power.map((row) => row.map((value) => value / size));
      power = product(power, power);
      exponent *= 2;
    }
    return Math.exp(logarithm);
  }

  // Make zI − A at z = e^{jω} diagonal by elimination, together with the right-hand side b.
  function reduced({ a, b }, angle) {
    const n = b.length;
    const width = n + 1;
    const re = new Float64Array(n * width);
    const im = new Float64Array(n * width);
    for (let i = 0; i < n; i++) {
      for (let j = 0; j < n; j++) re[i * width + j] = -a[i][j];
      re[i * width + i] += Math.cos(angle);
      im[i * width + i] = Math.sin(angle);
      re[i * width + n] = b[i];
    }
    for (let k = 0; k < n; k++) eliminate(re, im, k, n);
    const at = (i, j) => [re[i * width + j], im[i * width + j]];
    return b.map((_, i) => ({ pivot: at(i, i), right: at(i, n) }));
  }

  // c (zI − A)⁻¹ b, as [real, imaginary]. Not finite at a pole.
  function transfer(system, angle) {
    let [x, y] = [0, 0];
    reduced(system, angle).forEach(({ pivot, right }, i) => {
      const [u, v] = divide(...right, ...pivot);
      x += system.c[i] * u;
      y += system.c[i] * v;
    });
    return [x, y];
  }

  // |det(zI − A)|, which is the product of the distances from z to all poles.
  const determinant = (system, angle) =>
    reduced(system, angle).reduce((size, { pivot }) => size * Math.hypot(...pivot), 1);

  function divide(a, b, c, d) {
    const size = c * c + d * d;
    return [(a * c + b * d) / size, (b * c - a * d) / size];
  }

  // Eliminate column k of a complex matrix with right-hand side, by the column's largest pivot.
  function eliminate(re, im, k, n) {
    const width = n + 1;
    const size = (i) => re[i * width + k] ** 2 + im[i * width + k] ** 2;
    let pivot = k;
    for (let i = k + 1; i < n; i++) if (size(i) > size(pivot)) pivot = i;
    for (let j = k; j <= n; j++) {
      const [p, q] = [k * width + j, pivot * width + j];
      [re[p], re[q], im[p], im[q]] = [re[q], re[p], im[q], im[p]];
    }
    const diagonal = k * width + k;
    for (let i = 0; i < n; i++) {
      const head = i * width + k;
      if (i === k || (re[head] === 0 && im[head] === 0)) continue;
      const [fr, fi] = divide(re[head], im[head], re[diagonal], im[diagonal]);
      for (let j = k; j <= n; j++) {
        const [p, q] = [k * width + j, i * width + j];
        re[q] -= fr * re[p] - fi * im[p];
        im[q] -= fr * im[p] + fi * re[p];
      }
    }
  }

  // ------------------------------------------------------------------------- linearization

  // The map of one tick: states, reference and perturbation to the next states and two outputs.
  function tickMap(instance) {
    const { outputs, states, discrete } = instance.table;
    const n = states.length + discrete.length;
    const shown = ["motor_speed_command_rad_s", "knee_angle_rad"].map((name) => outputs.indexOf(name));
    return {
      n,
      step(point) {
        instance.states().set(point.slice(0, n));
        point.slice(n).forEach((value, i) => (instance.input(i)[0] = value));
        if (instance.wasm.advance(0, 1) < 1) {
          throw new Error(`no linear loop: ${instance.endAt(1).reason}`);
        }
        const rows = instance.view(instance.wasm.outputs(), 2 * outputs.length);
        return [...instance.states(), ...shown.map((index) => rows[2 * index + 1])];
      },
    };
  }

  // The Jacobian of the map of a tick by central differences. They give the mean of the slopes on
  // both sides of a kink, such as that of the absolute values of Eq. 27 at rest.
  function jacobian(map, point, steps) {
    const columns = point.map((_, j) => {
      const [above, below] = [steps[j], -steps[j]].map((shift) => {
        const moved = [...point];
        moved[j] += shift;
        return map.step(moved);
      });
      return above.map((up, i) => (up - below[i]) / (2 * steps[j]));
    });
    return columns[0].map((_, i) => column(columns, i));
  }

  // Steps that exceed rounding errors. ``slopes`` are those of the controller's states and command.
  // They limit the steps, because the law multiplies two variables with a kink at rest. The first
  // states, as many as ``continuous``, and the reference have a further limit.
  function stepsAt(point, continuous, slopes) {
    return point.map((value, j) => {
      const last = point.length - 1;
      if (j === last) return PERTURBATION_STEP_RAD_S;
      const step = STEP * (1 + Math.abs(value));
      if (!slopes) return 0.1 * step;
      const steepest = Math.max(...column(slopes, j).map(Math.abs));
      const discrete = j >= continuous && j < last - REFERENCE_SIZE;
      return CONTROLLER_STEP / Math.max(steepest, discrete ? 1 : CONTROLLER_STEP / step);
    });
  }

  // The point where a tick changes no state, by Newton's method. Null if there is none near it.
  function equilibrium(map, start) {
    let point = start;
    for (let k = 0; k < NEWTON_STEPS; k++) {
      const change = map.step(point).slice(0, map.n).map((value, i) => value - point[i]);
      const slope = jacobian(map, point, stepsAt(point, 0)).slice(0, map.n);
      const square = slope.map((row, i) => row.slice(0, map.n).map((v, j) => v - (i === j ? 1 : 0)));
      const step = solve(square, change);
      if (!step.every(Number.isFinite)) return null;
      point = point.map((value, i) => (i < map.n ? value - step[i] : value));
      const small = (value, i) => Math.abs(value) < 1e-9 * (1 + Math.abs(point[i]));
      if (step.every(small)) return change.every((value) => Math.abs(value) < 1e-6) ? point : null;
    }
    return null;
  }

  // Matrices of the closed loop, and of the loop that is open at the command.
  function matricesOf(map, point, continuous) {
    const { n } = map;
    const slopes = jacobian(map, point, stepsAt(point, continuous)).slice(continuous, n + 1);
    const slope = jacobian(map, point, stepsAt(point, continuous, slopes));
    // A discrete state that never changes, such as the integral of a PID without integral action,
    // is no state of the loop.
    const still = (row, i) => row.every((v, j) => Math.abs(v - (i === j ? 1 : 0)) < 1e-7);
    const live = [...Array(n).keys()].filter((i) => i < continuous || !still(slope[i], i));
    const part = (row) => live.map((j) => row[j]);
    const rows = live.map((i) => slope[i]);
    const [command, angle] = slope.slice(n);
    const closed = rows.map(part);
    const b = rows.map((row) => row[n + REFERENCE_SIZE]);
    const c = part(command);
    // The perturbation d = v − y replaces the command y by any signal v, which opens the loop.
    const open = closed.map((row, i) => row.map((value, j) => value - b[i] * c[j]));
    const byReference = (row) => row.slice(n, n + REFERENCE_SIZE);
    return {
      closed,
      loop: { a: open, b, c: c.map((value) => -value) },
      reference: rows.map(byReference),
      angle: { c: part(angle), d: byReference(angle) },
    };
  }

  // ------------------------------------------------------------------------------- margins

  // The loop transfer L at a frequency in Hz, as [real, imaginary].
  const responseOf = (loop, period) => (frequency) => transfer(loop, 2 * Math.PI * frequency * period);

  // Frequencies in Hz and the values of L, dense near each resonance and where L turns quickly.
  function gridOf(loop, period) {
    const highest = 0.5 / period;
    const ratio = (highest / LOWEST_HZ) ** (1 / GRID_POINTS);
    const even = Array.from({ length: GRID_POINTS }, (_, k) => LOWEST_HZ * ratio ** k).concat(highest);
    const size = (f) => determinant(loop, 2 * Math.PI * f * period);
    const near = aroundResonances(size, even).filter((f) => f > LOWEST_HZ && f < highest);
    const response = responseOf(loop, period);
    const points = [];
    for (const f of [...even, ...near].sort((a, b) => a - b)) {
      refine(response, points, { f, value: response(f) }, 0);
    }
    return points.filter(({ value }) => value.every(Number.isFinite));
  }

  // Append a point. If L turns quickly before the point, first append points between.
  function refine(response, points, next, depth) {
    const last = points.at(-1);
    const [x, y] = last ? divide(...next.value, ...last.value) : [1, 0];
    const quick = Math.abs(Math.atan2(y, x)) > 0.2 || Math.abs(Math.log(Math.hypot(x, y))) > 0.3;
    if (quick && depth < FINEST) {
      const f = 0.5 * (last.f + next.f);
      refine(response, points, { f, value: response(f) }, depth + 1);
      refine(response, points, next, depth + 1);
    } else points.push(next);
  }

  // Frequencies around each pole near the unit circle, where the determinant has a minimum. Such a
  // resonance may be much narrower than the distance of two frequencies of the grid.
  function aroundResonances(size, grid) {
    const sizes = grid.map(size);
    const isLowest = (k) => sizes[k] < sizes[k - 1] && sizes[k] <= sizes[k + 1];
    return grid.flatMap((_, k) => {
      if (!isLowest(k)) return [];
      const f = lowest(size, grid[k - 1], grid[k + 1]);
      const width = (size(f) / sizes[k + 1]) * (grid[k + 1] - f);
      return [0, ...WIDTHS].flatMap((x) => [f - x * width, f + x * width]);
    });
  }

  // The place of the minimum of a function between two numbers.
  function lowest(value, low, high) {
    for (let k = 0; k < 80; k++) {
      const [left, right] = [(2 * low + high) / 3, (low + 2 * high) / 3];
      [low, high] = value(left) < value(right) ? [low, right] : [left, high];
    }
    return 0.5 * (low + high);
  }

  // The frequencies at which a function of L changes its sign between points of the grid.
  function crossings(response, grid, of) {
    const frequencies = [];
    for (let k = 1; k < grid.length; k++) {
      const negative = of(grid[k - 1].value) < 0;
      if (negative === of(grid[k].value) < 0) continue;
      frequencies.push(bisect((f) => of(response(f)) < 0 === negative, grid[k - 1].f, grid[k].f));
    }
    return frequencies;
  }

  // The place between two numbers where a condition ends.
  function bisect(holds, low, high) {
    for (let k = 0; k < 60; k++) {
      const middle = 0.5 * (low + high);
      [low, high] = holds(middle) ? [middle, high] : [low, middle];
    }
    return 0.5 * (low + high);
  }

  const smallest = (pairs) => pairs.reduce((a, b) => (b[0] < a[0] ? b : a), [Infinity, NaN]);

  function marginsOf(response, grid, highest) {
    const real = crossings(response, grid, ([, y]) => y).map((f) => [response(f)[0], f]);
    const ends = [0, highest].map((f) => [response(f), f]);
    // L is real at both ends; at a pole that rounding has moved, its real part has no meaning.
    const finite = ends.filter(([[x, y]]) => Math.hypot(x, y) < 1 / NO_FACTOR);
    const gains = [...real, ...finite.map(([[x], f]) => [x, f])]
      .filter(([x]) => x < 0 && x > -1 / NO_FACTOR)
      .map(([x, f]) => [-1 / x, f]);
    const lower = gains.filter(([gain]) => gain <= 1).map(([gain]) => gain);
    const lags = crossings(response, grid, ([x, y]) => Math.hypot(x, y) - 1).map((f) => {
      const [x, y] = response(f);
      return [180 + (Math.atan2(y, x) * 180) / Math.PI, f];
    });
    const upper = smallest(gains.filter(([gain]) => gain >= 1));
    const lag = smallest(lags);
    const delay = smallest(lags.map(([phase, f]) => [phase / 360 / f, f]));
    return {
      gain_margin: upper[0],
      gain_margin_frequency_hz: upper[1],
      lower_gain_margin: Math.max(0, ...lower),
      phase_margin_deg: lag[0],
      phase_margin_frequency_hz: lag[1],
      delay_margin_s: delay[0],
      delay_margin_frequency_hz: delay[1],
      ...sensitivityPeak(response, grid),
    };
  }

  // The largest |1/(1 + L)|, refined between the neighbours of the largest point of the grid.
  function sensitivityPeak(response, grid) {
    const size = ([x, y]) => 1 / Math.hypot(1 + x, y);
    const values = grid.map(({ value }) => size(value));
    const best = values.reduce((most, value, i) => (value > values[most] ? i : most), 0);
    const ends = [best - 1, best + 1].map((k) => grid[Math.min(Math.max(k, 0), grid.length - 1)].f);
    const frequency = lowest((f) => -size(response(f)), ...ends);
    return { sensitivity_peak: size(response(frequency)), sensitivity_peak_frequency_hz: frequency };
  }

  // The first frequency at which a gain falls below 1/√2 of its value at the lowest, or null.
  function minus3dB(gain, grid) {
    const bound = gain(grid[0].f) / Math.SQRT2;
    const index = grid.findIndex(({ f }) => gain(f) < bound);
    return index < 1 ? null : bisect((f) => gain(f) >= bound, grid[index - 1].f, grid[index].f);
  }

  // The gain of the knee angle's samples to a sine of the reference with its derivatives.
  function trackingGain({ closed, reference, angle }, period) {
    return (frequency) => {
      const w = 2 * Math.PI * frequency;
      const part = (even) => (row) => (even ? row[0] - row[2] * w ** 2 : row[1] * w - row[3] * w ** 3);
      const at = (even) =>
        transfer({ a: closed, b: reference.map(part(even)), c: angle.c }, w * period);
      const [[xr, xi], [yr, yi]] = [at(true), at(false)];
      return Math.hypot(xr - yi + part(true)(angle.d), xi + yr + part(false)(angle.d));
    };
  }

  function curvesOf(grid) {
    const phases = [];
    for (const { value } of grid) {
      const phase = (Math.atan2(value[1], value[0]) * 180) / Math.PI;
      const last = phases.at(-1) ?? -90;
      phases.push(phase - 360 * Math.round((phase - last) / 360));
    }
    return {
      frequency_hz: Float64Array.from(grid, ({ f }) => f),
      loop_magnitude: Float64Array.from(grid, ({ value }) => Math.hypot(...value)),
      loop_phase_deg: Float64Array.from(phases),
    };
  }

  // ------------------------------------------------------------------------------- request

  // Prepare the module without quantizers at rest with a constant knee angle in deg.
  function atRest(model, setup, values, angle) {
    const instance = Simulator.instanceOf(model.smooth.module, `linear ${setup}`);
    const reference = [Simulator.radians(angle), 0, 0, 0];
    const all = { ...values, start_angle_rad: reference[0] };
    instance.prepare(Simulator.parametersOf(model.smooth, all), 1);
    reference.forEach((value, order) => instance.input(order).fill(value));
    if (instance.wasm.start()) throw new Error(instance.endAt(0).reason);
    const map = tickMap(instance);
    return { instance, map, start: [...instance.states(), ...reference, 0] };
  }

  // The reason why an equilibrium has no linear loop, or null. See find_equilibrium in
  // kneexo/analysis/linear/loop_equilibrium.py.
  function obstacle(model, values, instance, map, point) {
    const command = Math.abs(map.step(point)[map.n]);
    const limit = Simulator.limitsOf(model, values).command_limit_rad_s;
    if (command >= limit * (1 - 1e-9)) return "the motor is at its speed limit; reduce the load";
    const s = instance.output("sliding_variable_m_s2", 2)?.[1] ?? 0;
    const outside = Math.abs(s) >= (values["controller.phi_m_s2"] ?? Infinity);
    return outside ? "the error at rest is outside the boundary layer; increase Φ" : null;
  }

  // The answer to a request of kind "linear": margins and the curve of L.
  function linear(request) {
    const { reference, setup = 0 } = request;
    const model = Simulator.modelOf(request);
    const values = Simulator.valuesOf(model, reference, request.values);
    const range = Simulator.rangeOf(model, reference, values, request.duration_s);
    const angle = 0.5 * (range[0] + range[1]);
    const { instance, map, start } = atRest(model, setup, values, angle);
    const none = (failure) => ({ knee_angle_deg: angle, stable: null, failure });
    const point = equilibrium(map, start);
    if (!point) return none("the loop does not rest at this angle; reduce the load");
    const failure = obstacle(model, values, instance, map, point);
    if (failure) return none(failure);
    const { states, sample_time_s: period } = instance.table;
    const matrices = matricesOf(map, point, states.length);
    const radius = spectralRadius(matrices.closed);
    const highest = 0.5 / period;
    const response = responseOf(matrices.loop, period);
    const grid = gridOf(matrices.loop, period);
    const common = {
      knee_angle_deg: angle,
      stable: radius < 1,
      largest_eigenvalue: radius,
      ...curvesOf(grid),
    };
    if (!common.stable) return common;
    const closed = (f) => Math.hypot(...complementary(response(f)));
    return {
      ...common,
      ...marginsOf(response, grid, highest),
      bandwidth_linear_hz: minus3dB(trackingGain(matrices, period), grid),
      feedback_bandwidth_hz: minus3dB(closed, grid),
    };
  }

  const complementary = ([x, y]) => divide(x, y, 1 + x, y);

  return { linear, marginsOf, gridOf, spectralRadius, solve, transfer };
})();
