// The page to play with: joins controls, simulator, curves, numbers and the leg.
"use strict";

const Page = (() => {
  const { element } = Curves;
  const SWEEP_HZ = Array.from({ length: 17 }, (_, i) => Number((0.05 * 10 ** (i / 7)).toPrecision(3)));
  const REST_MS = 350; // margins and sweep start, and the address changes, after the values have not changed for this time
  const LONGEST_RUN_MS = 1000; // a slow stage stands still for so long after a change, or until the run is drawn
  const STAGE_REST_MS = 120; // and for so long after the run, because a slider that moves changes the values again
  const PAPER_PX = 680; // width of the curves on A4 and letter
  const ANNOUNCE_MS = 1500;
  const data = prepared(JSON.parse(document.getElementById("playground").textContent));
  const state = Setups.stateOf(data, location.hash);
  const results = [{}, {}];
  const byId = (id) => document.getElementById(id);
  const parts = { latest: [null, null], asked: [null, null], pinned: new Map(), remark: Setups.remarkOf(data, location.hash, state) };
  let drawing = false;
  let announcing = 0;

  const shownSetups = () => (state.compare ? [0, 1] : [0]);

  // ------------------------------------------------------------------------- requests

  function requestOf(setup) {
    const model = Setups.modelOf(data, setup);
    const values = { ...Setups.valuesOf(data, setup), ...Setups.moduleValues(data, setup) };
    return { model: model.key, reference: setup.reference, values, duration_s: values[data.duration.name], band_deg: data.recovery_band_deg,
      fault_s: Setups.thrownOf(data, setup)?.start_s, fault: Setups.thrownOf(data, setup), isProtected: setup.protection === "on" };
  }

  function change(index) {
    const setup = state.setups[index];
    complain();
    if (Setups.faultOf(data, setup) || !shownSetups().includes(index)) return;
    const request = { ...requestOf(setup), view_s: parts.plots.range };
    parts.latest[index] = request;
    results[index].fresh = false;
    parts.stage.rest(LONGEST_RUN_MS);
    parts.runs.request(index, request);
    if (Setups.hasWearer(data, setup)) {
      parts.asked[index] = null;
      parts.analyses.request(index, null);
      return;
    }
    const [linear, sweep] = [requestOf(calm(setup)), sweepOf(setup)];
    const asked = JSON.stringify([linear, sweep], (name, value) => (name.startsWith("push.") ? undefined : value));
    if (parts.asked[index] === asked) return;
    parts.asked[index] = asked;
    const near = results[index].near_hz; // the search is quicker beside the last result
    if (near) sweep.near_hz = near;
    parts.analyses.request(index, { linear, sweep, frequencies: SWEEP_HZ });
  }

  /** The request of a set-up's sweep. */
  function sweepOf(setup) {
    return requestOf({ ...calm(setup), reference: "sine" });
  }

  /** A set-up whose margins and sweep are those of another one. Fault, protection and push change neither. */
  const calm = (setup) => ({ ...setup, fault: "none", protection: "off" });

  function onRun(index, answer, request) {
    results[index].error = answer.error;
    if (answer.error) {
      tellEnds();
      return;
    }
    const fresh = !answer.unfinished && parts.latest[index] === request;
    results[index] = { ...results[index], ...resultOf(state.setups[index], answer, request), fresh };
    draw();
  }

  /** The result of a set-up's run, for curves and cards. */
  function resultOf(setup, answer, request) {
    if (!request.isProtected) { // these states act on nothing
      delete answer.columns.state;
      delete answer.columns.reason;
    }
    const { sample_time_s } = data.modules[Setups.modelOf(data, setup).loop.module].table;
    const end_s = answer.time.at(-1) ?? 0;
    return {
      hasWearer: Setups.hasWearer(data, setup), clauses: data.clauses, margins: data.margins, band_deg: data.recovery_band_deg,
      run: {
        ...answer, push: Setups.pushOf(request.values), fault: request.fault, faults: Setups.modelOf(data, setup).faults, isProtected: request.isProtected, duration_s: request.duration_s, reference: request.reference, step_s: request.values["reference.time_s"],
        part_s: answer.unfinished && request.duration_s - end_s > sample_time_s ? end_s : null,
      },
      frequency: request.reference === "sine" ? request.values["reference.frequency_hz"] : null,
      sample_time_s,
      reference_key: JSON.stringify([request.reference, Object.entries(request.values).filter(([name]) => name.startsWith("reference."))]),
    };
  }

  const handlers = {
    onStart(index) {
      delete results[index].linear;
      delete results[index].sweep;
      delete results[index].swept;
      parts.bode.clear(index, SWEEP_HZ);
      draw();
    },
    onLinear(index, answer) {
      results[index].linear = answer;
      draw();
    },
    onPoint(index, point) { parts.bode.add(index, point); },
    onSweep(index, answer) {
      results[index].sweep = answer;
      results[index].near_hz = answer.minus_3_db_hz ?? results[index].near_hz;
      parts.bode.setMinus3db(index, answer.minus_3_db_hz);
      draw();
    },
    onEnd(index) { results[index].swept = true; },
  };

  // -------------------------------------------------------------------------- drawing

  /** Draw at the next frame, once for all results that come before it. */
  function draw() {
    if (drawing) return;
    drawing = true;
    requestAnimationFrame(() => {
      drawing = false;
      drawNow();
    });
  }

  function drawNow() {
    const visible = shownSetups().map((index) => results[index]);
    if (visible.every((result) => result.run)) {
      const runs = visible.map(({ run }) => run);
      if (runs[1]) runs[1].same_reference = visible[0].reference_key === visible[1].reference_key;
      if (runs.some((run, index) => parts.drawn?.[index] !== run) || parts.drawn?.length !== runs.length) {
        chooseStage();
        parts.plots.chosen = state.curves;
        parts.plots.show(runs, pinnedResults());
        parts.safety.show(runs);
        runs.forEach((run, index) => showOnStage(index, run));
        parts.stage.rest(runs.some((run) => run.unfinished) ? LONGEST_RUN_MS : STAGE_REST_MS);
        parts.drawn = runs;
      }
      const newest = pinnedResults().at(-1);
      byId("numbers").style.setProperty("--pinned", `var(--pin-${newest?.slot})`);
      parts.board.show(visible, newest);
      showPins();
      showChoice();
      byId("pin").disabled = !isComplete(visible[0]) || state.pins.some((pin) => keyOf(pin) === keyOf(state.setups[0]));
      byId("save-csv").disabled = byId("save-png").disabled = runs.some((run) => run.unfinished);
      tellEnds();
      if (visible.every(({ run }) => !run.unfinished)) Numbers.writeSentences(byId("sentence"), visible);
      announce(visible);
    }
    caption();
    allowPush();
  }

  /** Let the user push the legs that have a push. */
  function allowPush() {
    const pushes = shownSetups().map((index) => Setups.quantitiesOf(data, state.setups[index]).find(({ name }) => name === "push.torque_n_m"));
    parts.stage.legs.forEach((leg, index) => { leg.canPush = pushes[index]?.high ?? 0; }); // the stage follows the drawn runs
    parts.stage.showPush(Boolean(pushes[parts.panel.index]));
  }

  /** Whether a result has all its numbers. */
  function isComplete({ fresh, hasWearer, linear, sweep }) {
    return fresh && (hasWearer || (linear && sweep));
  }

  // ---------------------------------------------------------------------- pinned runs

  const keyOf = ({ slot, ...setup }) => JSON.stringify(setup);

  /** The results of the pinned runs that are computed, the oldest first. */
  function pinnedResults() {
    return state.pins.flatMap((pin) => (parts.pinned.has(keyOf(pin)) ? [{ ...parts.pinned.get(keyOf(pin)), slot: pin.slot }] : []));
  }

  /** Keep the present run of set-up A behind the later ones. A page keeps `Setups.PINS` runs. */
  function pin() {
    if (state.pins.length === Setups.PINS) {
      parts.remark = `The oldest pinned run (${differencesOf(state.pins[0])}) is gone, because the page keeps ${Setups.PINS}.`;
      state.pins.shift();
    }
    const slots = Array.from({ length: Setups.PINS }, (_, slot) => slot);
    const slot = slots.find((one) => !state.pins.some((other) => other.slot === one));
    state.pins.push({ ...Setups.copied(state.setups[0]), slot });
    parts.pinned.set(keyOf(state.setups[0]), results[0]);
    pinsChanged();
  }

  function pinsChanged() {
    computePins();
    parts.trail.note(Setups.linkOf(data, state));
    parts.drawn = null;
    draw();
  }

  /** Forget the runs that are no longer pinned, and compute those of a link, one after the other. */
  function computePins() {
    for (const key of parts.pinned.keys()) {
      if (!state.pins.some((pin) => keyOf(pin) === key)) parts.pinned.delete(key);
    }
    parts.computing = (parts.computing ?? Promise.resolve()).then(async () => {
      const ask = (kind, message) => new Promise((resolve) => { parts.analyses.crew.ask({ kind, setup: "pin", ...message }, resolve); });
      for (const setup of [...state.pins]) {
        const request = requestOf(setup);
        if (parts.pinned.has(keyOf(setup))) continue;
        const answer = await ask("run", request);
        if (answer.error) continue;
        const result = resultOf(setup, answer, request);
        if (!result.hasWearer) Object.assign(result, { linear: await ask("linear", request), sweep: await ask("sweep", { ...sweepOf(setup), frequencies: [] }) });
        parts.pinned.set(keyOf(setup), result);
        parts.drawn = null;
        draw();
      }
    });
  }

  /** In what a pinned set-up differs from set-up A, as "ratio of the gear 4 (now 6)". */
  function differencesOf(pin) {
    const present = state.setups[0];
    const changes = [];
    const note = (label, [before, now], unit) => { if (before !== now) changes.push(`${label} ${before} (now ${now})${unit && ` ${unit}`}`); };
    for (const [label, words] of switchWords()) note(label, [pin, present].map(words), "");
    for (const quantity of Setups.quantitiesOf(data, pin)) {
      const now = Setups.quantitiesOf(data, present).find(({ name }) => name === quantity.name);
      if (now) note(quantity.label, [[pin, quantity], [present, now]].map(([setup, one]) => Controls.text(one, Setups.valueOf(data, setup, one))), Setups.display(quantity).unit);
    }
    const more = changes.length > 3 ? `, and ${changes.length - 3} more` : "";
    return changes.slice(0, 3).join(", ") + more || "the same values";
  }

  /** The legend of the pinned runs, each with a button that removes it. It stays while its words stay. */
  function showPins() {
    const words = state.pins.map((pin) => `${pin.slot} pinned: ${differencesOf(pin)}`);
    if (words.join("\n") === parts.pinWords) return;
    parts.pinWords = words.join("\n");
    byId("pins").replaceChildren(...state.pins.map((pin, place) => {
      const item = element("li", { class: `pin-${pin.slot}` }, words[place].slice(2));
      const button = element("button", { type: "button", "aria-label": `Remove the run ${words[place].slice(2)}` }, "✕");
      button.addEventListener("click", () => {
        state.pins.splice(place, 1);
        pinsChanged();
        byId("pin").focus();
      });
      item.append(button);
      return item;
    }));
  }

  // --------------------------------------------------------------------------- choices

  /** Fill the lists of curves: boxes to tick, and on a phone a choice of one. */
  function fillChoice() {
    for (const { name, title } of Curves.PLOTS) {
      byId("choose-plot").append(element("option", { value: name }, title));
      const box = element("input", { type: "checkbox", value: name });
      const label = element("label");
      label.append(box, title);
      byId("choose-curves").append(label);
      box.addEventListener("change", () => {
        const chosen = Curves.PLOTS.map((plot) => plot.name).filter((one) => (one === name ? box.checked : state.curves.includes(one)));
        if (chosen.length) state.curves = chosen;
        parts.trail.note(Setups.linkOf(data, state));
        parts.drawn = null;
        draw();
      });
    }
  }

  /** Offer the curves that the shown runs have. */
  function showChoice() {
    for (const place of parts.plots.plots) {
      const box = document.querySelector(`#choose-curves [value="${place.name}"]`);
      box.checked = state.curves.includes(place.name);
      box.parentElement.hidden = document.querySelector(`#choose-plot [value="${place.name}"]`).hidden = !parts.plots.has(place);
    }
  }

  /** Put two cursors into the shown part of the run, or remove them. */
  function toggleCursors() {
    parts.plots.measure(parts.plots.cursors ? null : parts.plots.quarters());
  }

  function showCursors(times) {
    byId("measure").setAttribute("aria-pressed", String(Boolean(times)));
    byId("cursors").hidden = !times;
    if (!times) return;
    times.forEach((time, k) => { byId(`cursor-${k + 1}`).value = Number(time.toFixed(4)); });
    const distance = times[1] - times[0];
    const rate = distance ? `, 1/Δt = ${Setups.shown(1 / Math.abs(distance))} Hz` : "";
    byId("cursor-distance").textContent = `Δt = ${Setups.shown(distance, 4)} s${rate}`;
  }

  /** Move the cursors to the times in their fields. A text that is not a number has no effect. */
  function typeCursors() {
    const typed = [1, 2].map((number) => Setups.parsed(byId(`cursor-${number}`).value));
    parts.plots.measure(typed.map((time, k) => time ?? parts.plots.cursors[k]));
  }

  /** Show a run on the stage. The first part of a run has no place there, because its end would stop the time. */
  function showOnStage(index, { time, columns, push, unfinished }) {
    if (unfinished) return;
    const { angle, reference, pressure, wearer, torque } = columns;
    parts.stage.setRun(index, { time, angle, reference, pressure, push, ...(torque && { wearer, torque }) });
    parts.stage.setName(index, nameOf(index));
  }

  function nameOf(index) {
    const setup = state.setups[index];
    const controller = Setups.CONTROLLER_NAMES[setup.controller] ?? setup.controller;
    const scenario = data.scenarios.length > 1 ? `${data.scenarios[setup.scenario].name}, ` : "";
    const { faults } = Setups.modelOf(data, setup);
    const protection = faults && setup.protection === "off" ? ", no protection" : "";
    return `${state.compare ? `${"AB"[index]}: ` : ""}${scenario}${controller}${protection}`;
  }

  function tellEnds() {
    const ends = shownSetups().flatMap((index) => {
      const { error, run } = results[index];
      const text = error || (run?.end && Numbers.endOf(run));
      return text ? [`${state.compare ? `${"AB"[index]}: ` : ""}${text}`] : [];
    });
    complain(ends);
  }

  /** Tell why set-ups cannot run, and how runs ended. The results of a set-up that cannot run are pale. */
  function complain(ends = []) {
    const faults = shownSetups().flatMap((index) => {
      const fault = Setups.faultOf(data, state.setups[index]);
      return fault ? [`${state.compare ? `Set-up ${"AB"[index]}: ` : ""}${fault}`] : [];
    });
    document.body.classList.toggle("stale", faults.length > 0);
    const notice = byId("notice");
    const text = [parts.remark, ...faults, ...ends].filter(Boolean).join(" ");
    if (notice.textContent !== text) notice.textContent = text;
    notice.hidden = !text;
  }

  function announce(visible) {
    clearTimeout(announcing);
    announcing = setTimeout(() => { byId("live").textContent = Numbers.sentence(visible); }, ANNOUNCE_MS);
  }

  function caption() {
    const sines = shownSetups().map((index) => sineOf(state.setups[index]));
    const same = new Set(sines).size === 1;
    const lines = same ? sines.slice(0, 1) : sines.map((text, index) => `${"AB"[index]}: ${text}`);
    const text = `${lines.join(" ")} At a filled mark the motor reaches its limit. At an open mark it stays below its limit.`;
    if (byId("bode-caption").textContent !== text) byId("bode-caption").textContent = text;
    byId("key").replaceChildren(...key());
    const wearers = shownSetups().map((index) => Setups.hasWearer(data, state.setups[index]));
    byId("bode").hidden = wearers.every(Boolean);
    byId("wearer-note").hidden = !wearers.some(Boolean);
  }

  /** The sines of a set-up's sweep in words. */
  function sineOf(setup) {
    const sine = { ...setup, reference: "sine" };
    const values = Setups.valuesOf(data, sine);
    const [amplitude, mean] = ["amplitude_deg", "mean_deg"].map((name) => Setups.shown(values[`reference.${name}`]));
    return `Measured with sines of ±${amplitude}° about ${mean}°.`;
  }

  function key() {
    const items = shownSetups().map((index) => element("li", { class: `of-${"ab"[index]}` }, nameOf(index)));
    const wearer = shownSetups().some((index) => Setups.hasWearer(data, state.setups[index]));
    const lines = [["of-reference", "reference"], ...(wearer ? [["of-wearer", "wearer's knee"]] : []), ["of-limit", "limit"],
      ...(shownSetups().some((index) => results[index].run?.free) ? [["of-free", "without the push"]] : [])];
    return [...items, ...lines.map(([name, text]) => element("li", { class: name }, text))];
  }

  // ---------------------------------------------------------------------------- parts

  /** Make the stage for the legs that are compared, unless it is there. A browser has few WebGL contexts, so only one stage exists. */
  function chooseStage() {
    const legs = shownSetups().map((index) => state.setups[index].scenario);
    if (parts.legs === legs.join(" ")) return;
    const playing = !parts.stage?.duration || parts.stage.playing;
    parts.stage?.remove();
    const box = element("div");
    byId("stage").append(box);
    parts.stage = new Stage(box, { legs: legs.map((scenario) => data.scenarios[scenario].leg), trace: false, playing, onPush });
    box.addEventListener("stagetime", ({ detail }) => {
      parts.plots.setTime(detail);
      if (!parts.plots.hovered) parts.safety.at(detail); // also at a time beyond the zoom
    });
    parts.legs = legs.join(" ");
    parts.drawn = null;
  }

  /** Push a set-up, or that of the panel with its torque, at the time of the leg. */
  function onPush(index, torque) {
    const { panel } = parts;
    if (index !== null && index !== panel.index) panel.select(index);
    const quantities = [...panel.rows.keys()];
    const [size, start, duration] = ["torque_n_m", "start_s", "duration_s"].map((name) => quantities.find((q) => q.name === `push.${name}`));
    const value = (quantity) => Setups.valueOf(data, panel.setup, quantity);
    const latest = value(data.duration) - value(duration);
    Setups.setValue(data, panel.setup, size, torque ?? (value(size) || size.high / 10));
    panel.refreshRow(size);
    panel.set(start, Math.max(0, Math.min(sampleTime(), latest)));
  }

  /** The time of the leg, rounded to a sample. */
  function sampleTime() {
    const { sample_time_s: period } = data.modules[Setups.modelOf(data, parts.panel.setup).loop.module].table;
    return Number((Math.round(parts.stage.time / period) * period).toFixed(9));
  }

  function showTime(time) {
    byId("cursor-time").textContent = time == null ? "" : `t = ${time.toFixed(2)} s`;
    if (time != null) parts.safety.at(time);
  }

  function onPanel(index) {
    parts.remark = "";
    parts.trail.note(Setups.linkOf(data, state));
    change(index);
  }

  function setCompare(compare) {
    state.compare = compare;
    byId("compare").setAttribute("aria-pressed", String(compare));
    document.body.classList.toggle("comparing", compare);
    if (!compare) {
      parts.panel.index = 0;
      parts.bode.clear(1);
      parts.asked[1] = null;
    }
    parts.panel.build();
    for (const index of shownSetups()) change(index);
    draw();
  }

  // ------------------------------------------------------------------------- history

  /** Show the values of the address, to which the browser has gone. */
  function restore(event) {
    Object.assign(state, Setups.stateOf(data, location.hash));
    parts.remark = Setups.remarkOf(data, location.hash, state);
    parts.trail.arrive(event.state);
    computePins();
    setCompare(state.compare);
  }

  function showSteps() {
    byId("undo").disabled = !parts.trail.canUndo;
    byId("redo").disabled = !parts.trail.canRedo;
  }

  function go(direction) {
    if (direction < 0 ? parts.trail.canUndo : parts.trail.canRedo) history.go(direction);
  }

  // --------------------------------------------------------------------- link and YAML

  /** Save a text or a picture as a file of the user. */
  function save(name, content) {
    const url = URL.createObjectURL(new Blob([content]));
    element("a", { href: url, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(url), 1000);
  }

  /** Show a text to copy. If it has the name of a file, the user can save it. */
  function showText(title, hint, text, file = "") {
    byId("save-text").hidden = !file;
    byId("save-text").dataset.file = file;
    byId("text-title").textContent = title;
    byId("text-hint").textContent = hint;
    byId("text-area").value = text;
    byId("text-dialog").showModal();
    byId("text-area").select();
    byId("text-area").scrollTop = 0;
    navigator.clipboard?.writeText(text).then(
      () => { byId("text-hint").textContent = `Copied. ${hint}`; }, () => {});
  }

  function showLink() {
    const [page] = location.href.split("#");
    showText("Link to these values", "The link opens this page with the values of the sliders.",
      `${page}#${Setups.linkOf(data, state)}`);
  }

  /** Name of a file of the set-up whose sliders are shown. */
  const fileOf = (name, type) => `${name}${state.compare ? `_${"AB"[parts.panel.index]}` : ""}.${type}`;

  /** Save the shown run of the set-up whose sliders are shown. */
  function saveCsv() {
    const { run } = results[parts.panel.index];
    save(fileOf("signals", "csv"), Curves.csvOf(run));
  }

  /** The values of a set-up that are not the defaults, in words. */
  function changesOf(index) {
    const setup = state.setups[index];
    const changed = Setups.quantitiesOf(data, setup).filter((q) => Setups.valueOf(data, setup, q) !== Setups.defaultOf(data, setup, q));
    const words = changed.map((q) => `${q.label} ${Controls.text(q, Setups.valueOf(data, setup, q))} ${Setups.display(q).unit}`.trim());
    return [nameOf(index), ...words].join(", ");
  }

  /** Save the curves as a picture, between the meaning of their lines and their values. */
  function savePng() {
    const items = Array.from(document.querySelectorAll("#key li, #pins li"), (item) => [item.className.replace("of-", ""), item.firstChild.textContent, getComputedStyle(item).color]);
    parts.plots.picture(items, [...shownSetups().map(changesOf), captionOfValues()]).toBlob((blob) => save("curves.png", blob));
  }

  function showYaml() {
    const { index } = parts.panel;
    const title = state.compare ? `Set-up ${"AB"[index]} as YAML` : "These values as YAML";
    const fault = Setups.faultOf(data, state.setups[index]);
    showText(title, fault ? `kneexo refuses this file. ${fault}`
      : "Save this text as FILE.yaml. The command kneexo simulate FILE.yaml --out run makes the same run.",
      Setups.yamlOf(data, state.setups[index]), fileOf("scenario", "yaml"));
  }

  // ---------------------------------------------------------------------------- print

  /** Table of all values, for paper. */
  function fillValues() {
    const table = element("table");
    const indices = shownSetups();
    const head = element("tr");
    head.append(...["Value", ...indices.map((i) => nameOf(i)), "Unit"].map((text) => element("th", { scope: "col" }, text)));
    table.append(element("caption", {}, captionOfValues()), head);
    const addRow = (label, words, unit = "") => {
      const row = element("tr");
      row.append(element("th", { scope: "row" }, label), ...indices.map((i) => element("td", {}, words(state.setups[i]))), element("td", {}, unit));
      table.append(row);
    };
    for (const [label, words] of switchWords()) addRow(label, words);
    const quantities = new Map(indices.flatMap((i) => Setups.quantitiesOf(data, state.setups[i])).map((q) => [q.name, q]));
    for (const quantity of quantities.values()) {
      addRow(quantity.label, (setup) => {
        const present = Setups.quantitiesOf(data, setup).find((q) => q.name === quantity.name);
        return present ? Controls.text(present, Setups.valueOf(data, setup, present)) : "–";
      }, Setups.display(quantity).unit);
    }
    byId("values").replaceChildren(table);
  }

  /** Version, date and link of the values on paper. A page in a notebook has no address. */
  function captionOfValues() {
    const [page] = location.href.split("#");
    const fragment = Setups.linkOf(data, state);
    const link = byId("copy-link").hidden ? "" : `, ${page}${fragment && "#"}${fragment}`;
    return `Values of this page: kneexo ${data.kneexo}, ${new Date().toISOString().slice(0, 10)}${link}`;
  }

  /** Names of the switches, and functions that return their choice in words. */
  function switchWords() {
    return [
      ["scenario", (setup) => data.scenarios[setup.scenario].name],
      ["controller", (setup) => Setups.CONTROLLER_NAMES[setup.controller] ?? setup.controller],
      ["load", (setup) => Setups.LOAD_NAMES[setup.load] ?? setup.load],
      ["reference", (setup) => Setups.REFERENCE_NAMES[setup.reference] ?? setup.reference],
      ["protection", (setup) => Setups.PROTECTION_NAMES[setup.protection]],
      ["fault", (setup) => Setups.thrownOf(data, setup)?.label ?? "none"],
    ];
  }

  function onPrint(printing) {
    if (printing) fillValues();
    document.documentElement.classList.toggle("printing", printing); // with the colours of light screens
    parts.plots.resize(printing ? PAPER_PX : 0);
    parts.bode.resize(printing ? PAPER_PX / 2 : 0);
  }

  // ---------------------------------------------------------------------------- start

  function listen() {
    const on = (id, action, event = "click") => byId(id).addEventListener(event, action);
    on("compare", () => {
      if (!state.compare) Setups.follow(data, state);
      setCompare(!state.compare);
      parts.trail.note(Setups.linkOf(data, state));
    });
    on("undo", () => go(-1));
    on("redo", () => go(1));
    addEventListener("keydown", (event) => {
      const direction = Addresses.directionOf(event);
      if (!direction) return;
      event.preventDefault();
      go(direction);
    });
    on("copy-link", showLink);
    on("copy-yaml", showYaml);
    on("save-csv", saveCsv);
    on("save-png", savePng);
    on("save-text", () => save(byId("save-text").dataset.file, byId("text-area").value));
    on("print", () => print());
    on("zoom-in", () => parts.plots.zoomBy(0.5));
    on("zoom-out", () => parts.plots.zoomBy(2));
    on("pin", pin);
    on("measure", toggleCursors);
    for (const id of ["cursor-1", "cursor-2"]) on(id, typeCursors, "change");
    on("zoom-all", () => parts.plots.zoomAll());
    on("choose-plot", () => {
      parts.plots.one = byId("choose-plot").value;
      parts.drawn = null;
      drawNow();
    }, "change");
    addEventListener("beforeprint", () => onPrint(true));
    addEventListener("afterprint", () => onPrint(false));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => onPrint(false)); // draws the curves anew
    addEventListener("popstate", restore); // also after a link to another fragment
  }

  function start() {
    if (typeof WebAssembly === "undefined") throw new Error("It has no WebAssembly.");
    document.body.classList.toggle("framed", self !== top);
    byId("copy-link").hidden = location.protocol === "about:"; // inside a notebook
    byId("scenario-name").textContent = data.scenarios.map(({ name }) => name).join(", ");
    byId("made-by").textContent = `kneexo ${data.kneexo} made this page. The page needs no network and sends no data.`;
    const text = JSON.parse(byId("worker").textContent);
    const source = `data:text/javascript,${encodeURIComponent(text)}`; // VS Code blocks blobs
    const models = { modules: data.modules, models: Object.fromEntries(data.scenarios.flatMap(({ models }) => models.map((model) => [model.key, model]))) };
    parts.trail = new Addresses.Trail(REST_MS, showSteps);
    byId("undo").hidden = byId("redo").hidden = !parts.trail.active;
    showSteps();
    parts.board = new Numbers.Board(byId("numbers"), byId("brief"));
    parts.safety = new Safety.Diagram(byId("safety"));
    parts.plots = new Curves.RunPlots(byId("plots"), showTime, (time) => parts.stage.seek(time), showCursors,
      (part, speed) => parts.stage.showPart(part, speed));
    parts.bode = new Bode.BodePlots(byId("bode-plots"));
    parts.runs = new Runner.Runs(new Runner.Crew(source, models), onRun);
    parts.analyses = new Runner.Analyses(new Runner.Crew(source, models), REST_MS, handlers);
    parts.panel = new Controls.Panel(byId("panel"), data, state, onPanel, sampleTime);
    fillChoice();
    listen();
    computePins();
    new ResizeObserver(() => document.documentElement.style.setProperty("--curves", `${byId("curves").offsetHeight}px`)).observe(byId("curves"));
    chooseStage();
    setCompare(state.compare);
  }

  /** Give each model a key from its place in the page, and the samples of the first model. */
  function prepared(page) {
    page.scenarios.forEach(({ models }, s) => models.forEach((model, m) => {
      model.key = `${s}/${m}`;
      const { samples } = models[0].references;
      if (samples) model.references.samples ??= samples;
    }));
    return page;
  }

  return { changesOf, data, draw, parts, results, start, state };
})();

try {
  Page.start();
} catch (error) {
  const notice = document.getElementById("notice");
  notice.textContent = `This browser cannot run the simulation. ${error.message}`;
  notice.hidden = false;
  for (const part of document.querySelectorAll("main, header .actions")) part.hidden = true;
  throw error;
}
