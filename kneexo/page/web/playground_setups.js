// The set-ups A and B of the page as plain data: models, values, links and YAML. No DOM.
"use strict";

const Setups = (() => {
  const CONTROLLER_NAMES = { smc: "sliding mode", pid: "PID", law: "your law",
    zero_torque: "zero torque", impedance: "impedance", assist: "assistance", assist_as_needed: "assist as needed" };
  const LOAD_NAMES = { none: "none", knee: "weight of the shank" };
  const REFERENCE_NAMES = { sine: "sine", step: "step", ramp: "ramp", samples: "samples" };
  const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
  const LINK_PREFIXES = ["a", "b"];
  const SWITCHES = ["scenario", "controller", "load", "reference", "fault", "protection"];
  const PROTECTION_NAMES = { on: "on", off: "off" };
  const VERSION = "kneexo"; // name of the version in a link
  const PINS = 4; // most pinned runs

  /** Unit and factor of a quantity on the page. Values, links and YAML have the unit of the scenario. */
  function display({ shown_unit: unit, shown_factor: factor }) {
    return { unit: unit === "1" ? "" : unit, factor };
  }

  /** Text of a number with `digits` significant digits, without needless zeros. */
  function shown(value, digits = 3) {
    if (!Number.isFinite(value)) return "–";
    const rounded = Number(value.toPrecision(digits));
    const size = Math.abs(rounded);
    if (rounded !== 0 && (size >= 1e6 || size < 1e-4)) return rounded.toExponential();
    return String(rounded).replace("-", "−");
  }

  /** A finite number from text, else null. */
  function parsed(text) {
    const plain = text.trim().replace("−", "-").replace(",", ".");
    if (!NUMBER.test(plain)) return null;
    const value = Number(plain);
    return Number.isFinite(value) ? value : null;
  }

  function modelsOf(data, setup) {
    return data.scenarios[setup.scenario].models;
  }

  /** The model of a set-up. The link parser and the switches choose only existing models. */
  function modelOf(data, setup) {
    return modelsOf(data, setup).find(
      (model) => model.controller === setup.controller && model.load === setup.load);
  }

  /** The choices of a switch that have a model with the present choice of the other switch. */
  function choices(data, setup, name) {
    const other = name === "controller" ? "load" : "controller";
    const all = modelsOf(data, setup);
    const existing = [...new Set(all.map((model) => model[name]))];
    return existing.filter((choice) =>
      all.some((model) => model[name] === choice && model[other] === setup[other]));
  }

  /** The choices of a switch that have no model with the present choice of the other switch. */
  function missing(data, setup, name) {
    const other = name === "controller" ? "load" : "controller";
    const pairs = Object.values(data.scenarios[setup.scenario].missing).flat();
    return pairs.map(([controller, load]) => ({ controller, load }))
      .filter((pair) => pair[other] === setup[other]).map((pair) => pair[name]);
  }

  /** Whether the loop of a set-up has a wearer. */
  function hasWearer(data, setup) {
    return modelOf(data, setup).wearer;
  }

  function references(data, setup) {
    return Object.keys(modelOf(data, setup).references);
  }

  /** All quantities that have an effect in a set-up, those of its reference first. */
  function quantitiesOf(data, setup) {
    const model = modelOf(data, setup);
    const task = model.references[setup.reference].quantities ?? [];
    const guarded = setup.protection === "on";
    const acting = model.quantities.filter(({ name }) => guarded || !name.startsWith("protection."));
    return [...task, data.duration, ...faultQuantities(model, setup, guarded), ...acting];
  }

  // ----------------------------------------------------------------------------- faults

  const hasFault = (setup) => setup.fault !== "none";

  function faultQuantities({ faults }, setup, guarded) {
    if (!faults || !hasFault(setup)) return [];
    const { quantity } = faults.choices[setup.fault];
    const clock = faults.quantities.filter(({ name }) => guarded || name !== "fault.reset_s");
    return [...(quantity ? [quantity] : []), ...clock];
  }

  /** Names of the faults that a set-up can have; empty if the model has no protection. */
  function faultNames(data, setup) {
    const { faults } = modelOf(data, setup);
    if (!faults) return {};
    const { reset, ...choices } = faults.choices;
    return { none: "none", ...Object.fromEntries(Object.entries(choices).map(([name, { label }]) => [name, label])) };
  }

  /** The fault of a set-up: label, start and end; null without a fault. */
  function thrownOf(data, setup) {
    const { faults } = modelOf(data, setup);
    if (!faults || !hasFault(setup)) return null;
    const values = valuesOf(data, setup);
    const { "fault.start_s": start_s, "fault.duration_s": duration_s, "fault.reset_s": reset_s = 0 } = values;
    const end_s = duration_s > 0 ? start_s + duration_s : Infinity;
    return { label: faults.choices[setup.fault].label, start_s, duration_s, end_s, reset_s };
  }

  /** The push of values: label, torque, start and end; null without a push. */
  function pushOf({ "push.torque_n_m": torque, "push.start_s": start_s, "push.duration_s": duration_s }) {
    return torque ? { label: `push, ${shown(torque)} N·m`, torque, start_s, end_s: start_s + duration_s } : null;
  }

  /** Values of the module that throw the fault of a set-up, and that put thresholds out of reach without protection. */
  function moduleValues(data, setup) {
    const { faults } = modelOf(data, setup);
    const thrown = thrownOf(data, setup);
    return {
      ...(faults && setup.protection === "off" ? faults.off : {}),
      ...(thrown && { [`fault.${setup.fault}.start_s`]: thrown.start_s }),
      ...(thrown?.duration_s && { [`fault.${setup.fault}.duration_s`]: thrown.duration_s }),
      ...(thrown?.reset_s && { "fault.reset.start_s": thrown.reset_s }),
    };
  }

  /** The list `faults` of a scenario file. */
  function faultsForYaml(data, setup) {
    const thrown = thrownOf(data, setup);
    if (!thrown) return [];
    const { choices } = modelOf(data, setup).faults;
    const entry = ({ place, kind, size }, start_s) => ({ place, kind, size, start_s });
    const chosen = entry(choices[setup.fault], thrown.start_s);
    const { quantity } = choices[setup.fault];
    if (quantity) chosen.size = valueOf(data, setup, quantity);
    if (thrown.duration_s) chosen.duration_s = thrown.duration_s;
    return [chosen, ...(thrown.reset_s ? [entry(choices.reset, thrown.reset_s)] : [])];
  }

  function durationDefault(data, setup) {
    return data.scenarios[setup.scenario].duration_s;
  }

  function defaultOf(data, setup, quantity) {
    return quantity === data.duration ? durationDefault(data, setup) : quantity.value;
  }

  function valueOf(data, setup, quantity) {
    return setup.values[quantity.name] ?? defaultOf(data, setup, quantity);
  }

  /** Values by name of all quantities that have an effect in a set-up. */
  function valuesOf(data, setup) {
    const quantities = quantitiesOf(data, setup);
    return Object.fromEntries(quantities.map((q) => [q.name, valueOf(data, setup, q)]));
  }

  function clamped(quantity, value) {
    return Math.min(quantity.high, Math.max(quantity.low, value));
  }

  /** Set a value within its range. A value equal to the default is not stored. */
  function setValue(data, setup, quantity, value) {
    const inside = clamped(quantity, value);
    if (inside === defaultOf(data, setup, quantity)) delete setup.values[quantity.name];
    else setup.values[quantity.name] = inside;
  }

  function fresh(data, index) {
    return { ...data.setups[index], values: { ...data.setups[index].values } };
  }

  function copied(setup) {
    return { ...setup, values: { ...setup.values } };
  }

  // For each prefix of names: why the scenario would refuse the values of a set-up, or an empty text.
  const CHECKS = { reference: faultOfReference, push: faultOfPush, fault: faultOfThrown };

  /** Why the scenario would refuse the values of a set-up, or an empty text. */
  function faultOf(data, setup) {
    const reasons = Object.values(CHECKS).map((check) => check(data, setup)).filter(Boolean);
    return reasons.length ? `${reasons[0]} The curves show the previous run.` : "";
  }

  function faultOfReference(data, setup) {
    const { knee_low_rad: low, knee_high_rad: high } = modelOf(data, setup).limits;
    const [least, most] = [low, high].map((angle) => Math.round((angle * 180e6) / Math.PI) / 1e6);
    const values = valuesOf(data, setup);
    const get = (name) => values[`reference.${name}`];
    const ends = {
      sine: () => [get("mean_deg") - get("amplitude_deg"), get("mean_deg") + get("amplitude_deg")],
      step: () => [get("start_deg"), get("end_deg")],
      ramp: () => [get("start_deg"), get("end_deg")],
    }[setup.reference]?.() ?? [];
    const wrong = ends.find((angle) => angle < least - 1e-9 || angle > most + 1e-9);
    if (wrong === undefined) return "";
    return `The reference would reach ${shown(wrong)}°, but the knee moves only from ${shown(least)}° to ${shown(most)}°. `
      + `Reduce ${setup.reference === "sine" ? "the amplitude, or change the mean" : "the step"}.`;
  }

  /** Why a run cannot contain the push of a set-up, or an empty text. */
  function faultOfPush(data, setup) {
    const values = valuesOf(data, setup);
    const duration_s = values[data.duration.name];
    const end = values["push.start_s"] + values["push.duration_s"];
    if (!values["push.torque_n_m"] || end <= duration_s) return "";
    return `The push ends at ${shown(end)} s, but the run lasts ${shown(duration_s)} s. Push earlier or for a shorter time, `
      + "or extend the run.";
  }

  /** Why a set-up cannot have a choice of a switch, or an empty text. Only the protection hears the emergency stop. */
  function refusalOf(setup, name = "fault", choice = setup.fault) {
    const { fault, protection } = { ...setup, [name]: choice };
    if (fault !== "emergency_stop" || protection !== "off") return "";
    return `The emergency stop acts through the protection. ${name === "fault" ? "Turn the protection on" : "Choose another fault"} first.`;
  }

  /** Why a run cannot contain the fault of a set-up, or an empty text. */
  function faultOfThrown(data, setup) {
    const thrown = thrownOf(data, setup);
    if (!thrown) return "";
    const refused = refusalOf(setup);
    if (refused) return refused;
    const run_s = valuesOf(data, setup)[data.duration.name];
    const last_s = run_s - data.modules[modelOf(data, setup).loop.module].table.sample_time_s;
    const { start_s, end_s, reset_s } = thrown;
    const late = start_s > last_s ? ["fault begins", start_s] : reset_s > last_s ? ["reset is pressed", reset_s]
      : Number.isFinite(end_s) && end_s > run_s ? ["fault ends", end_s] : null;
    return late ? `The ${late[0]} at ${shown(late[1])} s, but the run lasts ${shown(run_s)} s. Choose an earlier time, or extend the run.` : "";
  }

  // ------------------------------------------------------------------------------ links

  /**
   * Text for the fragment of a link: everything that differs from the page as it opens, and the
   * version of kneexo. Empty if nothing differs.
   */
  function linkOf(data, state) {
    const parameters = new URLSearchParams();
    if (state.compare !== data.compare) parameters.set("compare", state.compare ? "1" : "0");
    const write = (setup, prefix, start) => {
      for (const name of SWITCHES) {
        if (setup[name] !== start[name]) parameters.set(`${prefix}.${name}`, String(setup[name]));
      }
      for (const quantity of quantitiesOf(data, setup)) {
        const value = valueOf(data, setup, quantity);
        const before = start.values[quantity.name] ?? defaultOf(data, setup, quantity);
        if (value !== before) parameters.set(`${prefix}.${quantity.name}`, String(value));
      }
    };
    state.setups.forEach((setup, index) => write(setup, LINK_PREFIXES[index], data.setups[index]));
    for (const [name, text] of Object.entries(listsOf(state))) {
      if (text) parameters.set(name, text);
    }
    for (const pin of state.pins) write(pin, `p${pin.slot}`, data.setups[0]);
    if (parameters.size) parameters.set(VERSION, data.kneexo);
    return parameters.toString();
  }

  /** The lists of a link: slots of the pinned runs, the oldest first, and names of the curves unless they are those of the start. */
  function listsOf({ pins, curves }) {
    return { pins: pins.map(({ slot }) => slot).join(" "), curves: curves.join(" ") === Curves.START.join(" ") ? "" : curves.join(" ") };
  }

  /** What a user should know about a link that gave a state: another version, values without effect. */
  function remarkOf(data, fragment, state) {
    const parameters = new URLSearchParams(fragment.replace(/^#/, ""));
    const version = parameters.get(VERSION);
    parameters.delete(VERSION);
    parameters.delete("compare");
    const lost = [...parameters].filter(([path, text]) => !hasValue(data, state, path, text));
    const words = [];
    if (version !== null && version !== data.kneexo) words.push(`The link is of kneexo ${version.slice(0, 20)}, and this page of ${data.kneexo}.`);
    if (lost.length) words.push(`${lost.length === 1 ? "One value" : `${lost.length} values`} of the link ${lost.length === 1 ? "does" : "do"} not fit this page, which shows its own instead.`);
    return words.join(" ");
  }

  /** Whether a state has the value of a link at a path such as a.plant.pump.gear_ratio. */
  function hasValue(data, state, path, text) {
    if (path in listsOf(state)) return listsOf(state)[path] === text;
    const [prefix, ...names] = path.split(".");
    const setup = state.setups[LINK_PREFIXES.indexOf(prefix)] ?? state.pins.find(({ slot }) => `p${slot}` === prefix);
    const name = names.join(".");
    if (!setup) return false;
    if (SWITCHES.includes(name)) return String(setup[name]) === text;
    const quantity = quantitiesOf(data, setup).find((one) => one.name === name);
    return Boolean(quantity) && valueOf(data, setup, quantity) === parsed(text);
  }

  /** The state that a link describes. Unknown names and wrong values have no effect. */
  function stateOf(data, fragment) {
    const parameters = new URLSearchParams(fragment.replace(/^#/, ""));
    const comparing = parameters.get("compare");
    const compare = ["0", "1"].includes(comparing) ? comparing === "1" : data.compare;
    const setupAt = (prefix, index) => {
      const setup = fresh(data, index);
      const get = (name) => parameters.get(`${prefix}.${name}`);
      const scenario = /^\d{1,2}$/.test(get("scenario") ?? "") ? Number(get("scenario")) : -1;
      if (scenario in data.scenarios && scenario !== setup.scenario) choose(data, setup, "scenario", scenario);
      choosePair(data, setup, get("controller"), get("load"));
      if (references(data, setup).includes(get("reference"))) setup.reference = get("reference");
      if (get("fault") in faultNames(data, setup)) setup.fault = get("fault");
      if (modelOf(data, setup).faults && get("protection") in PROTECTION_NAMES) setup.protection = get("protection");
      for (const quantity of quantitiesOf(data, setup)) {
        const value = parsed(get(quantity.name) ?? "");
        if (value !== null && value >= quantity.low && value <= quantity.high) {
          setValue(data, setup, quantity, value);
        }
      }
      for (const [prefix, check] of Object.entries(CHECKS)) {
        if (!check(data, setup)) continue;
        for (const name of Object.keys(setup.values).filter((one) => one.startsWith(`${prefix}.`))) delete setup.values[name];
      }
      if (faultOfThrown(data, setup)) setup.fault = "none";
      return setup;
    };
    const listed = (name) => [...new Set((parameters.get(name) ?? "").split(" "))];
    const pins = listed("pins").filter((slot) => /^\d$/.test(slot) && slot < PINS).map((slot) => ({ ...setupAt(`p${slot}`, 0), slot: Number(slot) }));
    const chosen = listed("curves");
    const curves = Curves.PLOTS.map(({ name }) => name).filter((name) => chosen.includes(name));
    return { compare, setups: LINK_PREFIXES.map(setupAt), pins, curves: curves.length ? curves : Curves.START };
  }

  function choosePair(data, setup, controller, load) {
    const requested = { controller: controller ?? setup.controller, load: load ?? setup.load };
    const exists = modelsOf(data, setup).some(
      (model) => model.controller === requested.controller && model.load === requested.load);
    if (exists) Object.assign(setup, requested);
  }

  /** Change one switch of a set-up. The other switches keep their choices where these are possible. */
  function choose(data, setup, name, choice) {
    setup[name] = choice;
    if (name === "scenario") {
      setup.values = {};
      Object.assign(setup, data.scenarios[choice].start);
    }
    if (!references(data, setup).includes(setup.reference)) {
      [setup.reference] = references(data, setup);
    }
    if (!(setup.fault in faultNames(data, setup))) setup.fault = "none";
  }

  /**
   * Give set-up B the values of A, and a controller that A does not have. Only if B is as the page opens,
   * with the scenario of A: a user who compares controllers compares them in the same task.
   */
  function follow(data, state) {
    const [a, b] = state.setups;
    const isUntouched = JSON.stringify(b) === JSON.stringify(fresh(data, 1));
    if (!isUntouched || a.scenario !== b.scenario) return;
    const next = copied(a);
    const others = choices(data, next, "controller").filter((controller) => controller !== a.controller);
    if (others.length) choose(data, next, "controller", others.includes(b.controller) ? b.controller : others[0]);
    state.setups[1] = next;
  }

  // ------------------------------------------------------------------------------- YAML

  function yamlNumber(value) {
    const text = String(value);
    return text.includes("e") && !text.includes(".") ? text.replace("e", ".0e") : text;
  }

  function yamlScalar(value) {
    if (typeof value === "number") return yamlNumber(value);
    if (Array.isArray(value)) return `[${value.map(yamlScalar).join(", ")}]`;
    if (typeof value === "object" && value !== null) return `{${Object.entries(value).map(([name, one]) => `${name}: ${yamlScalar(one)}`).join(", ")}}`;
    return JSON.stringify(value);
  }

  function yamlLines(tree, indent) {
    return Object.entries(tree).flatMap(([name, value]) => {
      const nested = value !== null && typeof value === "object" && !Array.isArray(value);
      if (!nested) return [`${indent}${name}: ${yamlScalar(value)}`];
      const below = yamlLines(value, `${indent}  `);
      return below.length ? [`${indent}${name}:`, ...below] : [`${indent}${name}: {}`];
    });
  }

  function setPath(tree, path, value) {
    const names = path.split(".");
    const last = names.pop();
    let holder = tree;
    for (const name of names) {
      if (holder[name] === null || typeof holder[name] !== "object") holder[name] = {};
      holder = holder[name];
    }
    holder[last] = value;
  }

  /** The scenario file of a set-up. `kneexo simulate` of this file gives the numbers of this page. */
  function yamlOf(data, setup) {
    const model = modelOf(data, setup);
    const tree = structuredClone(model.scenario);
    if (setup.reference !== data.scenarios[setup.scenario].start.reference) {
      tree.reference = { kind: setup.reference };
    }
    for (const quantity of quantitiesOf(data, setup)) {
      const value = valueOf(data, setup, quantity);
      if (value !== defaultOf(data, setup, quantity) && !quantity.name.startsWith("fault.")) setPath(tree, quantity.name, value);
    }
    if (model.faults) {
      tree.faults = faultsForYaml(data, setup);
      if (setup.protection === "off") delete tree.protection;
      else tree.protection ??= {};
    }
    const table = data.modules[model.loop.module].table;
    if (table.rosenbrock_tolerance !== null) {
      setPath(tree, "simulation.integrator", "rosenbrock");
      setPath(tree, "simulation.tolerance", table.rosenbrock_tolerance);
    } else {
      setPath(tree, "simulation.integrator", "rk4");
      setPath(tree, "simulation.step_s", table.sample_time_s / table.rk4_steps_per_tick);
    }
    const title = `# From a page of kneexo ${data.kneexo}. Run it: kneexo simulate FILE.yaml --out run`;
    return `${[title, ...yamlLines(tree, "")].join("\n")}\n`;
  }

  return {
    CONTROLLER_NAMES, LOAD_NAMES, PINS, PROTECTION_NAMES, REFERENCE_NAMES, choices, choose, clamped, copied, defaultOf,
    display, faultNames, faultOf, follow, fresh, hasWearer, linkOf, missing, modelOf, moduleValues, parsed, pushOf, thrownOf, quantitiesOf, references, refusalOf, remarkOf, setValue, shown, stateOf,
    valueOf, valuesOf, yamlOf,
  };
})();
