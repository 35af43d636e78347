// Runs closed loops as WebAssembly and computes the metrics of kneexo.analysis.tracking.tracking.
// No imports and no DOM, so that it works in a worker and in tests.
// Modules, models and maps are described in kneexo/page/model.py.
"use strict";

const Simulator = (() => {
  const PIECE_MS = 8; // time between two pauses, in which a worker hears of newer values
  const PIECE_TICKS = [100, 20000]; // fewest and most ticks of a piece
  const FIRST_PART_MS = 16; // time after which the page gets the first part of a run
  const NEXT_PART_MS = 200;
  const SOON_MS = 24; // a run that ends within this time needs no part before
  const STATUS = {
    1: "an input is not finite or out of its range",
    2: "the motion diverges: a value is no longer finite",
    4: "the knee or the cylinder leaves its range of motion",
    16: "a parameter is not finite",
    64: "the plant changes too fast for the tolerance of the integrator",
  };
  const PUSH = ["push.torque_n_m", "push.start_s", "push.duration_s"];
  const KNEE_TORQUE = "plant.load.knee_torque_n_m";

  function bytesOf(base64) {
    const text = atob(base64);
    const bytes = new Uint8Array(text.length);
    for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
    return bytes;
  }

  const radians = (degrees) => (degrees * Math.PI) / 180;

  // ------------------------------------------------------------------------------- modules

  const sources = new Map(); // key of a module: {code, table}
  const loaded = new Map(); // key of a model: the model
  const instances = new Map();

  function load({ modules = {}, models = {} }) {
    for (const [key, { code, table }] of Object.entries(modules)) {
      if (!sources.has(key)) sources.set(key, { code, table });
    }
    for (const [key, model] of Object.entries(models)) loaded.set(key, model);
  }

  // The model of a request. The request has the key of the model, or the model.
  function modelOf({ model }) {
    const data = typeof model === "string" ? loaded.get(model) : model;
    if (!data) throw new Error(`model ${model} is not loaded`);
    return data;
  }

  // The instance of a module for a purpose. Each purpose has a memory of its own, so a sweep can
  // pause while another run uses the same module.
  function instanceOf(key, purpose) {
    const name = `${purpose} ${key}`;
    if (!instances.has(name)) {
      const source = sources.get(key);
      if (!source) throw new Error(`module ${key} is not loaded`);
      source.module ??= new WebAssembly.Module(bytesOf(source.code));
      instances.set(name, new Instance(source.module, source.table));
    }
    return instances.get(name);
  }

  class Instance {
    constructor(module, table) {
      this.table = table;
      this.wasm = new WebAssembly.Instance(module, {}).exports;
      this.wasm._initialize?.();
      this.ticks = 0;
    }

    // Set all parameters, and provide rows for ``ticks`` ticks.
    prepare(parameters, ticks) {
      if (!this.wasm.reserve(ticks)) {
        throw new Error(`too little memory for a run of ${ticks * this.table.sample_time_s} s`);
      }
      this.ticks = ticks;
      this.view(this.wasm.params(), parameters.length).set(parameters);
    }

    view(address, length) {
      return new Float64Array(this.wasm.memory.buffer, address, length);
    }

    input(index) {
      return this.view(this.wasm.inputs() + 8 * index * (this.ticks + 1), this.ticks + 1);
    }

    get outputs() {
      return this.view(this.wasm.outputs(), this.table.outputs.length * (this.ticks + 1));
    }

    // Return a copy of the first ``rows`` values of an output, or null if the module lacks it.
    output(name, rows, outputs = this.outputs) {
      const index = this.table.outputs.indexOf(name);
      if (index < 0) return null;
      return outputs.slice(index * (this.ticks + 1), index * (this.ticks + 1) + rows);
    }

    states() {
      const { states, discrete } = this.table;
      return this.view(this.wasm.states(), states.length + discrete.length);
    }

    // Keep moments of the next run, from which later runs with other changes go on, or keep nothing. The moments
    // of the last run stay if the next one has the same parameters and inputs.
    keep(run) {
      const { kept } = this;
      const isSame = run && kept?.inputs === run.inputs && kept.parameters.every((value, k) => value === run.parameters[k]);
      if (!isSame) this.kept = run && { ...run, moments: [], outputs: null };
    }

    // Step through all rows. Return the number of rows before a failure. ``pause`` gets the number of ticks
    // until then, and may throw. ``changes`` maps ticks to the parameters that are valid from then on.
    async run(pause, changes = new Map()) {
      const stops = [...changes.keys(), this.ticks].sort((a, b) => a - b);
      let tick = this.from = this.begin(stops[0]);
      if (tick === null) return 0;
      for (const [index, stop] of stops.entries()) {
        tick = await this.advance(tick, stop, pause, index === 0);
        if (tick < stop || !changes.has(stop)) break;
        this.view(this.wasm.params(), changes.get(stop).length).set(changes.get(stop));
      }
      if (this.kept && !changes.size) this.keepOutputs(tick);
      return tick + 1;
    }

    // Start, or go back to a moment if all outputs of the run without changes are known. Return the tick,
    // or null if the start fails.
    begin(latest) {
      if (this.kept?.outputs) {
        this.outputs.set(this.kept.outputs);
        return this.restore(latest);
      }
      if (this.wasm.start()) return null;
      if (this.kept) this.kept.moments = [this.moment(0)];
      return 0;
    }

    // Go on from the first change of the last run, as if there were no change.
    async goOn(pause) {
      if (!this.kept.outputs) this.keepOutputs(await this.advance(this.restore(this.ticks), this.ticks, pause, true));
    }

    keepOutputs(tick) {
      Object.assign(this.kept, { outputs: this.outputs.slice(), isWhole: tick === this.ticks });
    }

    // All memory between the stack, which is empty now, and the rows: parameters, states and status. A copy of the
    // stack too would take ten times as long as the run.
    moment(tick) {
      const { stack_bytes: start } = this.table;
      return { tick, memory: new Uint8Array(this.wasm.memory.buffer, start, this.wasm.inputs() - start).slice() };
    }

    // Go back to the last moment that is not after a tick. Return its tick.
    restore(latest) {
      const { tick, memory } = this.kept.moments.findLast((moment) => moment.tick <= latest);
      new Uint8Array(this.wasm.memory.buffer).set(memory, this.table.stack_bytes);
      return tick;
    }

    // Step from a tick to another one, in pieces of about `PIECE_MS`, and perhaps keep the moment after each
    // piece. Return the tick before a failure.
    async advance(tick, stop, pause, keeps) {
      let piece = PIECE_TICKS[0];
      while (tick < stop) {
        const start = performance.now();
        const count = Math.min(piece, stop - tick);
        const good = this.wasm.advance(tick, count);
        tick += good;
        if (good < count) break;
        if (keeps && tick > this.kept?.moments.at(-1).tick) this.kept.moments.push(this.moment(tick));
        const wanted = (count * PIECE_MS) / Math.max(performance.now() - start, 0.1);
        piece = Math.round(Math.min(Math.max(wanted, PIECE_TICKS[0]), PIECE_TICKS[1]));
        if (tick < this.ticks) await pause(tick);
      }
      return tick;
    }

    // Why a run ended early, or null.
    endAt(rows) {
      if (rows > this.ticks) return null;
      const status = this.wasm.status();
      const reason = STATUS[status] ?? `the model stops with status ${status}`;
      return { time_s: Math.max(rows - 1, 0) * this.table.sample_time_s, reason };
    }
  }

  // ---------------------------------------------------------------------------- parameters

  // Return the value of a formula, as map_value in kneexo/page/maps.py does.
  const KINDS = {
    affine: (map, q) => q.reduce((sum, value, i) => sum + map.factors[i] * value, map.offset),
    power: (map, q) => q.reduce((value, x, i) => value * x ** map.exponents[i], map.factor),
    least: ({ limit, factors, unit }, q) => {
      const least = Math.min(limit ?? Infinity, ...q.map((x, i) => factors[i] * x));
      return unit ? unit * Math.floor((least / unit) * (1 + 1e-12)) : least;
    },
    chebyshev: (map, q) => {
      const polynomials = q.map((value, i) => chebyshev(map.terms, i, placeOf(value, map.domain[i])));
      return map.terms.reduce(
        (sum, [c, ...orders]) => sum + orders.reduce((t, n, i) => t * polynomials[i][n], c),
        0,
      );
    },
  };

  // Scale a value from its domain to −1 … 1.
  const placeOf = (value, [low, high]) => (2 * value - low - high) / (high - low);

  // Chebyshev polynomials T_0, T_1 … at u, up to the highest order of variable i in the terms.
  function chebyshev(terms, i, u) {
    const highest = terms.reduce((most, term) => Math.max(most, term[i + 1]), 1);
    const values = [1, u];
    for (let n = 2; n <= highest; n++) values.push(2 * u * values[n - 1] - values[n - 2]);
    return values;
  }

  function mapped(map, values) {
    const at = map.of.map((name) => {
      if (!Number.isFinite(values[name])) throw new Error(`${name} has no value`);
      return values[name];
    });
    return Math.max(KINDS[map.kind](map, at), map.at_least ?? -Infinity);
  }

  // Return the parameters of a module. Formulas replace some elements of its base.
  function parametersOf(part, values) {
    const parameters = Float64Array.from(part.base);
    for (const map of part.maps) parameters[map.index] = mapped(map, values);
    return parameters;
  }

  // A limit is a number, the name of a quantity, a formula, or null for no limit.
  function limitOf(limit, values) {
    if (limit === null || limit === undefined) return Infinity;
    if (typeof limit === "number") return limit;
    return typeof limit === "string" ? values[limit] : mapped(limit, values);
  }

  // Return all limits at the present values.
  function limitsOf(model, values) {
    const names = ["command_limit_rad_s", "motor_speed_limit_rad_s", "motor_acceleration_limit_rad_s2", "pressure_rating_pa", "relief_pressure_pa"];
    return Object.fromEntries(names.map((name) => [name, limitOf(model.limits[name], values)]));
  }

  // Return the values of all quantities of a model. Values of the request replace the defaults.
  function valuesOf(model, reference, values) {
    const quantities = [...model.quantities, ...(model.references[reference]?.quantities ?? [])];
    const defaults = quantities.map(({ name, value }) => [name, value]);
    return { ...model.faults?.idle, ...Object.fromEntries(defaults), ...values };
  }

  // ---------------------------------------------------------------------------------- runs

  // The four columns of the reference: θ_d and its derivatives at ticks 0 … ticks.
  async function referenceColumns(source, values, ticks, period_s, pause, purpose) {
    if (source.powers !== undefined) return sampledColumns(source, ticks, period_s);
    const instance = instanceOf(source.module, purpose);
    instance.prepare(parametersOf(source, values), ticks);
    const rows = await instance.run(pause);
    if (rows <= ticks) throw new Error(`reference: ${instance.endAt(rows).reason}`);
    return instance.table.outputs.map((name) => instance.output(name, rows));
  }

  // Angle and three derivatives of a piecewise polynomial at the ticks.
  function sampledColumns(source, ticks, period_s) {
    const columns = [0, 1, 2, 3].map(() => new Float64Array(ticks + 1));
    eachTick(source, ticks, period_s, (tick, segment) => {
      const powers = segmentAt(source, segment, tick * period_s);
      columns.forEach((column, order) => { column[tick] = powers[order]; });
    });
    return columns;
  }

  // Call `visit` with each tick and the segment of a piecewise polynomial at this tick.
  function eachTick(source, ticks, period_s, visit) {
    source.decoded ??= [source.breaks, source.powers].map((text) => new Float64Array(bytesOf(text).buffer));
    const [breaks] = source.decoded;
    let segment = 0;
    for (let tick = 0; tick <= ticks; ++tick) {
      const time = tick * period_s;
      // A segment is closed on the left; the last break also belongs to the segment before.
      while (segment < breaks.length - 1 && time >= breaks[segment]) ++segment;
      if (time > breaks[segment]) ++segment;
      visit(tick, segment, breaks[segment] ?? Infinity);
    }
  }

  // Return value and three derivatives of a segment at a time. Its powers are of the time since its start.
  function segmentAt({ decoded: [breaks, powers] }, segment, time) {
    const width = powers.length / (breaks.length + 1);
    const row = powers.subarray(segment * width, (segment + 1) * width);
    const since = time - (breaks[segment - 1] ?? 0);
    return [0, 1, 2, 3].map((order) => derivativeAt(row, since, order));
  }

  // The derivative of this order of the polynomial with the coefficients `row`, at x.
  function derivativeAt(row, x, order) {
    let sum = 0;
    for (let power = row.length - 1; power >= order; --power) {
      let factor = row[power];
      for (let down = 0; down < order; ++down) factor *= power - down;
      sum = sum * x + factor;
    }
    return sum;
  }

  // Return the input of a loop with a wearer (IntervalReference in kneexo.systems). For each tick it
  // has the start, a break, and the coefficients of two polynomials, eight up to the break and four
  // after it. Their variable u is the share of the tick that has passed.
  function intervalColumns(source, columns, ticks, period_s) {
    const result = Array.from({ length: 14 }, () => new Float64Array(ticks + 1));
    const fill = (tick, first, values) => values.forEach((value, k) => { result[first + k][tick] = value; });
    const scaled = (values) => values.map((value, n) => (value * period_s ** n) / FACTORIALS[n]);
    const rowAt = (tick) => scaled(columns.map((column) => column[tick]));
    for (let tick = 0; tick <= ticks; ++tick) fill(tick, 0, [tick * period_s, NEVER_S]);
    if (source.powers === undefined) {
      for (let tick = 0; tick < ticks; ++tick) fill(tick, 2, powersBetween(rowAt(tick), rowAt(tick + 1)));
      return result;
    }
    eachTick(source, ticks, period_s, (tick, segment, end) => {
      const time = tick * period_s;
      fill(tick, 2, rowAt(tick));
      if (end >= time + period_s) return;
      result[1][tick] = end;
      fill(tick, 10, scaled(segmentAt(source, segment + 1, time)));
    });
    return result;
  }

  const NEVER_S = 1e9;
  const FACTORIALS = [1, 1, 2, 6];

  // Return the coefficients of the polynomial of degree 7 with given value and scaled derivatives at u = 0 and 1.
  function powersBetween([a, b, c, d], [value, slope, half, sixth]) {
    const gap = [value - a - b - c - d, slope - b - 2 * c - 3 * d, 2 * half - 2 * c - 6 * d, 6 * sixth - 6 * d];
    const sum = (...factors) => factors.reduce((total, factor, k) => total + factor * gap[k], 0);
    return [a, b, c, d, sum(35, -15, 2.5, -1 / 6), sum(-84, 39, -7, 0.5), sum(70, -34, 6.5, -0.5), sum(-20, 10, -2, 1 / 6)];
  }

  const periodOf = (model) => sources.get(model.loop.module).table.sample_time_s;

  const lastInputs = new Map(); // by purpose: the reference of the last run, its columns and the inputs

  // The columns of a reference and the inputs of a loop: those of the last run if they are the same.
  async function inputsOf({ model, reference, values }, ticks, period_s, pause, purpose) {
    const source = model.references[reference];
    if (!source) throw new Error(`reference ${reference} is not in this model`);
    const names = Object.keys(values).filter((name) => name.startsWith("reference."));
    const key = JSON.stringify([reference, ticks, ...names.map((name) => [name, values[name]])]);
    const last = lastInputs.get(purpose);
    if (last?.key === key && last.model === model) return last;
    const columns = await referenceColumns(source, values, ticks, period_s, pause, purpose);
    const inputs = model.wearer ? intervalColumns(source, columns, ticks, period_s) : [...columns];
    if (model.moment) inputs.push(sampledColumns(model.moment, ticks, period_s)[0]);
    lastInputs.set(purpose, { model, key, columns, inputs });
    return { columns, inputs };
  }

  // Prepare a run of a closed loop. Return its instance, the reference, and the changes by a push.
  async function prepare(request, pause, purpose) {
    const { model, values, duration_s, setup = 0 } = request;
    const { module } = model.loop;
    const instance = instanceOf(module, `${purpose} ${setup}`);
    const ticks = Math.max(1, Math.floor(duration_s / instance.table.sample_time_s + 1e-6));
    const period_s = instance.table.sample_time_s;
    const { columns, inputs } = await inputsOf(request, ticks, period_s, pause, `${purpose} ${setup}`);
    const all = { ...values, start_angle_rad: columns[0][0], start_rate_rad_s: columns[1][0] };
    const parameters = parametersOf(model.loop, all);
    instance.prepare(parameters, ticks);
    inputs.forEach((column, index) => instance.input(index).set(column));
    instance.keep(purpose === "run" && PUSH[0] in values ? { parameters, inputs } : null);
    return { instance, columns, changes: pushOf(model, all, period_s) };
  }

  // Run a closed loop and return its instance, the reference and the number of good rows.
  async function simulate(request, pause, purpose) {
    const { instance, columns, changes } = await prepare(request, pause, purpose);
    const rows = await instance.run(pause, changes);
    return { instance, columns, rows, end: instance.endAt(rows) };
  }

  // The parameters of a loop by the tick at which a push starts or ends, as Push in kneexo.systems.
  function pushOf(model, values, period_s) {
    const [torque, start, duration] = PUSH.map((name) => values[name]);
    if (!torque) return new Map();
    const pushed = { ...values, [KNEE_TORQUE]: values[KNEE_TORQUE] + torque };
    const tickAt = (time) => Math.ceil((time - model.criteria.samePushTimeS) / period_s);
    return new Map([[tickAt(start), parametersOf(model.loop, pushed)], [tickAt(start + duration), parametersOf(model.loop, values)]]);
  }

  // The answer to a request of kind "run": columns over time, metrics, and an early end with its reason.
  // ``send`` receives the parts of a long run, each from the start. The first part comes when the run
  // has passed the end of the time in view, or after a short time.
  async function run(request, pause, send) {
    const { reference, duration_s } = request;
    const model = modelOf(request);
    const values = valuesOf(model, reference, request.values);
    const { instance, columns, changes } = await prepare({ ...request, model, values }, pause, "run");
    const limits = limitsOf(model, values);
    const answerOf = (rows, end = null) => {
      const signals = signalsOf(instance, columns[0].slice(0, rows));
      const { time, rate, ...shown } = signals;
      const metrics = rows > 1 ? metricsOf(model, reference, values, limits, signals) : {};
      if (model.faults) metrics.protection = protectionMetrics(signals, model.faults, request.fault_s ?? Infinity);
      return { time, columns: shown, metrics, limits, end, free: freeOf(rows) };
    };
    // The curves without the push, if they are known.
    const freeOf = (rows) => {
      if (!changes.size || !instance.kept.isWhole) return null;
      const { angle, error, command, pressure } = signalsOf(instance, columns[0].slice(0, rows), instance.kept.outputs);
      return { angle, error, command, pressure };
    };
    const isDue = partsOf(instance, request.view_s ?? [0, duration_s]);
    const rows = await instance.run(async (tick) => {
      await pause();
      if (isDue(tick)) send({ unfinished: true, ...answerOf(tick + 1) });
    }, changes);
    const answer = answerOf(rows, instance.endAt(rows));
    if (!changes.size || answer.end) return answer;
    if (!instance.kept.outputs) send({ unfinished: true, ...answerOf(rows) });
    await instance.goOn(pause);
    answer.free ??= freeOf(rows);
    if (answer.free) answer.metrics.push = pushMetrics({ time: answer.time, angle: answer.columns.angle }, answer.free.angle, values[PUSH[1]], request.band_deg);
    return answer;
  }

  // Return a function that tells whether a part of a run that begins now is due at a tick.
  function partsOf(instance, [low, high]) {
    const { ticks, table: { sample_time_s: period_s } } = instance;
    const start = performance.now();
    let due = FIRST_PART_MS;
    let seen = false; // the end of the time in view
    return (tick) => {
      const passed = performance.now() - start;
      const isSeen = tick * period_s >= high;
      if (tick * period_s <= low || (passed * (ticks - tick)) / (tick - (instance.from ?? 0)) < SOON_MS) return false;
      if (passed < due && (seen || !isSeen)) return false;
      seen = isSeen;
      due = passed + NEXT_PART_MS;
      return true;
    };
  }

  // The signals of a run over time: the curves of a page, and those that only metrics need.
  function signalsOf(instance, reference, outputs = instance.outputs) {
    const rows = reference.length;
    const signal = (name) => instance.output(name, rows, outputs);
    const angle = signal("knee_angle_rad");
    const torque = signal("interaction_torque_n_m"); // null without a wearer
    const state = signal("safety_state"); // null without protection
    const arm = signal("moment_arm_m");
    const further = { cap: "cap_pressure_pa", rodSide: "rod_side_pressure_pa", current: "motor_current_a", winding: "winding_temperature_degc" };
    return {
      ...(state && { state, reason: signal("safety_reason"), speed: signal("motor_speed_rad_s") }),
      ...Object.fromEntries(Object.entries(further).map(([name, column]) => [name, signal(column)]).filter(([, column]) => column)),
      kneeTorque: signal("rod_force_n").map((force, tick) => -force * arm[tick]), // r = −dx/dθ, and x is the extension
      ...(torque && { torque, wearer: signal("wearer_angle_rad"), rate: signal("wearer_rate_rad_s") }),
      time: Float64Array.from({ length: rows }, (_, tick) => tick * instance.table.sample_time_s),
      angle,
      reference,
      error: reference.map((value, tick) => value - angle[tick]),
      command: signal("motor_speed_command_rad_s"),
      pressure: signal("load_pressure_pa"),
    };
  }

  // ------------------------------------------------------------------------------- metrics

  // Loops, because a function for each of 15,000 elements would take milliseconds.
  function largest(values) {
    let most = 0;
    for (let k = 0; k < values.length; k++) most = Math.max(most, Math.abs(values[k]));
    return most;
  }

  function share(values, holds) {
    let count = 0;
    for (let k = 0; k < values.length; k++) count += holds(Math.abs(values[k]));
    return count / values.length;
  }

  // The integral over time by the trapezoidal rule.
  function integral(values, period, term) {
    let sum = 0;
    for (let k = 1; k < values.length; k++) sum += term(values[k - 1]) + term(values[k]);
    return 0.5 * period * sum;
  }

  // The index of the first sample at or after a time.
  function indexAt(time, limit) {
    const index = time.findIndex((t) => t >= limit - 1e-9);
    return index < 0 ? time.length : index;
  }

  // The angles in degrees of the reference at both ends of a run and where it turns between them,
  // as run_range_deg in kneexo/systems/knee_reference.py.
  const TURNS = {
    sine(value, duration_s) {
      const [period, ramp_s] = [1 / value("frequency_hz"), value("ramp_s")];
      const grown = (time) => {
        const u = ramp_s > 0 ? Math.min(time / ramp_s, 1) : 1;
        return u ** 4 * (35 - 84 * u + 70 * u ** 2 - 20 * u ** 3);
      };
      const turns = Math.floor((2 * duration_s) / period);
      const times = [0, duration_s, ...[turns - 1, turns].filter((n) => n >= 0).map((n) => (n * period) / 2)];
      const from = Math.max(0, duration_s - period);
      if (duration_s < ramp_s + period) {
        for (let k = 0; k <= 100; k++) times.push(from + (k / 100) * (duration_s - from));
      }
      return times.map((time) => value("mean_deg")
        - grown(time) * value("amplitude_deg") * Math.cos((2 * Math.PI * time) / period));
    },
    step: (value, duration_s) => [value("start_deg"), value(duration_s > value("time_s") ? "end_deg" : "start_deg")],
    ramp(value, duration_s) {
      const [start, end] = [value("start_deg"), value("end_deg")];
      const way = Math.max(0, duration_s - value("time_s")) * value("rate_deg_s");
      return [start, start + Math.sign(end - start) * Math.min(way, Math.abs(end - start))];
    },
    samples(value, duration_s, source) {
      const angles = [];
      const add = (segment, time) => { angles.push((segmentAt(source, segment, time)[0] * 180) / Math.PI); };
      eachTick(source, 1, duration_s, (tick, segment) => add(segment, tick * duration_s));
      source.decoded[0].forEach((time, k) => { if (time >= 0 && time <= duration_s) add(k + 1, time); });
      return angles;
    },
  };

  // The smallest and the largest angle in degrees of a reference within a run.
  function rangeOf({ references }, reference, values, duration_s) {
    const angles = TURNS[reference]((name) => values[`reference.${name}`], duration_s, references[reference]);
    return [angles.reduce((a, b) => Math.min(a, b)), angles.reduce((a, b) => Math.max(a, b))];
  }

  // The largest error of a run that tracks: a share of the amplitude, or one count of the encoder.
  function errorBound(model, range) {
    const { errorShare, largestCountDeg } = model.criteria;
    const bound = (errorShare * (range[1] - range[0])) / 2;
    const counts = model.limits.encoder_count_knee_deg;
    if (!counts) return radians(bound);
    const last = counts.values.length - 1;
    const span = counts.high_deg - counts.low_deg;
    const at = (angle) => {
      const place = Math.min(Math.max(((angle - counts.low_deg) / span) * last, 0), last);
      // The cubic through four values: a straight line would be off by 3e-5.
      const index = Math.min(Math.max(Math.floor(place) - 1, 0), last - 3);
      const [t, v] = [place - index, counts.values.slice(index, index + 4)];
      return (v[3] * t - v[0] * (t - 3)) * (t - 1) * (t - 2) / 6
        + (v[1] * (t - 2) - v[2] * (t - 1)) * t * (t - 3) / 2;
    };
    const angles = Array.from({ length: 91 }, (_, i) => range[0] + (i / 90) * (range[1] - range[0]));
    return radians(Math.max(bound, Math.min(largestCountDeg, Math.max(...angles.map(at)))));
  }

  // The largest error of a run from a time on.
  function settledError({ time, error: all }, settled) {
    const first = indexAt(time, settled);
    const error = all.subarray(first);
    const size = largest(error);
    const worst = error.findIndex((value) => Math.abs(value) === size);
    return { largest_error_rad: size, max_error_time_s: time[first + worst] };
  }

  // The number of whole periods of a run, as periods_in in kneexo/analysis/signals.py. The last one may lack its
  // last sample.
  function periodsOf({ time }, period_s) {
    return period_s > 0 ? Math.floor((time[time.length - 1] + time[1]) / period_s + 1e-9) : 0;
  }

  function metricsOf(model, reference, values, limits, signals) {
    const period_s = reference === "sine" ? 1 / values["reference.frequency_hz"] : 0;
    const periods = periodsOf(signals, period_s);
    const main = settledError(signals, periods >= 2 ? period_s : 0); // as settled_s in signals.py
    const cycle = limitCycle(signals, model.criteria);
    const step = reference === "step" ? stepMetrics(signals, values, cycle, model.criteria) : null;
    const { time, cap, rodSide } = signals;
    const highest = cap?.map((value, tick) => Math.max(value, rodSide[tick]));
    const bound = errorBound(model, rangeOf(model, reference, values, time[time.length - 1]));
    return {
      ...main,
      ...(step ?? {}),
      limit_cycle: cycle,
      error_bound_rad: bound,
      tracks: signals.torque ? null : step ? step.settling_time_s !== null : main.largest_error_rad <= bound,
      saturated_share: share(signals.command, (value) => value >= limits.command_limit_rad_s * (1 - 1e-6)),
      peak_pressure_pa: largest(signals.pressure),
      relief_share: highest ? share(highest, (value) => value > limits.relief_pressure_pa) : null,
      ...interactionMetrics(signals, period_s, periods),
    };
  }

  // Return metrics of kneexo.analysis.tracking.interaction, of the whole periods after the first if there are any.
  function interactionMetrics({ time, torque, rate }, period_s, periods) {
    if (!torque) return {};
    const last = time.length - 1;
    const ends = periods < 2 ? [0, last] : [1, periods].map(
      (count) => Math.min(indexAt(time, count * period_s), last));
    const [power, torques] = [torque.map((value, k) => value * rate[k]), torque].map(
      (column) => column.subarray(ends[0], ends[1] + 1));
    const share = (time[1] - time[0]) / (time[ends[1]] - time[ends[0]]);
    return {
      periods: Math.max(periods - 1, 0),
      rms_torque_n_m: Math.sqrt(integral(torques, share, (value) => value * value)),
      peak_torque_n_m: largest(torques),
      power_from_wearer_w: integral(power, share, (value) => Math.max(value, 0)),
      power_to_wearer_w: integral(power, share, (value) => Math.max(-value, 0)),
    };
  }

  // The oscillation of the knee at the end of a run whose reference rests, or null; see limit_cycle
  // in kneexo/analysis/tracking/limit_cycle.py.
  function limitCycle({ time, reference, angle, pressure }, { smallestCycleDeg, restRad, sustained }) {
    const start = reference.findLastIndex((value) => Math.abs(value - reference[reference.length - 1]) > restRad) + 1;
    const half = (start + reference.length) >> 1;
    const rest = angle.subarray(half);
    if (rest.length < 4) return null;
    const cut = Math.ceil(rest.length / 2);
    const ends = (values) => values.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
    const [all, before, after] = [rest, rest.subarray(0, cut), rest.subarray(cut)].map(ends);
    const [amplitude, middle] = [(after[1] - after[0]) / 2, (all[0] + all[1]) / 2];
    if (amplitude < Math.max(radians(smallestCycleDeg), (sustained * (before[1] - before[0])) / 2)) return null;
    const crossings = [];
    let side = 0;
    rest.forEach((value, k) => {
      if (Math.abs(value - middle) <= amplitude / 2) return;
      if (side * (value - middle) < 0) crossings.push(half + k);
      side = value - middle;
    });
    const periods = Math.floor((crossings.length - 1) / 2);
    if (periods < 1) return null;
    const [low, high] = ends(pressure.subarray(half));
    return {
      start_s: time[start],
      amplitude_rad: amplitude,
      period_s: (time[crossings[2 * periods]] - time[crossings[0]]) / periods,
      lowest_pressure_pa: low,
      highest_pressure_pa: high,
    };
  }

  // How a push moves the knee, as push_response in kneexo/analysis/tracking/push_response.py.
  function pushMetrics({ time, angle }, freeAngle, start, band_deg) {
    const deviation = angle.map((value, k) => Math.abs(value - freeAngle[k]));
    const back = deviation.findLastIndex((value) => value > radians(band_deg)) + 1;
    return {
      largest_deviation_rad: largest(deviation),
      recovery_time_s: back < time.length ? Math.max(time[back] - start, 0) : null,
    };
  }

  // When and why the protection stopped the motor, when the knee was safe, and the largest error, turn and torque of
  // the knee until then. All count from the fault on, or from a stop before the fault. A signal at a sample shows the
  // state before the update at this sample, so the supervisor decided a sample before, as in
  // kneexo/analysis/tracking/stop.py.
  function protectionMetrics({ time, state, reason, speed, angle, error, kneeTorque }, { names, standstill_rad_s }, from_s) {
    const [stopped, released] = ["stopped", "released"].map((name) => names.indexOf(name));
    const stop = reason.findIndex((value) => value > 0);
    const first = Math.min(indexAt(time, from_s), stop < 0 ? Infinity : Math.max(stop - 1, 0));
    const safe = state.findIndex((value, k) => k >= first
      && (value === released || (value === stopped && Math.abs(speed[k]) < standstill_rad_s)));
    const end = safe < 0 ? time.length : safe + 1;
    return {
      stop: stop < 0 ? null : { time_s: time[Math.max(stop - 1, 0)], reason: reason[stop] },
      safe_time_s: safe < 0 ? null : time[Math.max(safe - 1, 0)],
      largest_error_rad: largest(error.subarray(first, end)),
      fault_s: time[first],
      turn_rad: largest(angle.subarray(first, end).map((value) => value - angle[first])),
      torque_n_m: largest(kneeTorque.subarray(first, end)),
      worst_time_s: first >= time.length ? null : Math.max(...[error, kneeTorque].map((all) => {
        const part = all.subarray(first, end);
        const size = largest(part);
        return time[first + part.findIndex((value) => Math.abs(value) === size)];
      })),
    };
  }

  // Rise time, overshoot, settling time and final error of a step. Null if the run does not reach the step.
  function stepMetrics({ time, angle }, values, cycle, { settlingBand }) {
    const [start, end] = ["start_deg", "end_deg"].map((name) => radians(values[`reference.${name}`]));
    const begin = values["reference.time_s"];
    const first = indexAt(time, begin);
    if (start === end || first >= time.length - 1) return null;
    const response = angle.subarray(first).map((value) => (value - start) / (end - start));
    const [low, high] = [0.1, 0.9].map((level) => response.findIndex((value) => value >= level));
    const settled = response.findLastIndex((value) => Math.abs(value - 1) >= settlingBand) + 1;
    const since = settled < response.length ? time[first + settled] - begin : Infinity;
    // A limit cycle that leaves the band goes on for ever, also if the run ends in the band.
    const latest = cycle ? (time[time.length - 1] - begin) / 2 : Number.MAX_VALUE;
    return {
      step_rad: end - start,
      rise_time_s: high < 0 ? null : time[first + high] - time[first + low],
      overshoot_percent: 100 * Math.max(0, response.reduce((a, b) => Math.max(a, b)) - 1),
      settling_time_s: since <= latest ? since : null,
      final_error_rad: end - angle[angle.length - 1],
    };
  }

  return { load, modelOf, periodOf, instanceOf, parametersOf, limitsOf, valuesOf, rangeOf, partsOf, protectionMetrics, simulate, run, radians };
})();
