// The safety state machine of the protection: its diagram, its states over time, and the mark of a fault.
"use strict";

const Safety = (() => {
  const { colour, drawLine, element } = Curves;
  const SVG = "http://www.w3.org/2000/svg";
  const [STEP, WIDTH, HEIGHT, LEFT, TOP] = [66, 96, 30, 58, 4]; // of the boxes, in px
  const [MIDDLE, RIGHT] = [LEFT + WIDTH / 2, LEFT + WIDTH];
  const WORDS = 2; // events in a line of text

  /** Number of the state of a run at a time. A sample shows the state before the update at this sample. */
  function rowAt({ time, columns: { state } }, t) {
    const row = Math.ceil(t / (time[1] - time[0]) - 1e-6);
    return Math.min(Math.max(row, 0), state.length - 1);
  }

  const stateAt = (run, t) => run.faults.names[run.columns.state[rowAt(run, t)]];

  /** The changes of the state of a run: time, states before and after, event, and name of a detector. */
  function changesOf({ time, columns: { state, reason, speed }, faults }) {
    const changes = [];
    let since = 0;
    for (let k = 1; k < state.length; ++k) {
      if (state[k] === state[k - 1]) continue;
      const [from, to] = [state[k - 1], state[k]].map((number) => faults.names[number]);
      const events = faults.transitions.filter(([a, , b]) => a === from && b === to).map(([, event]) => event);
      const cause = reason[k] && !reason[k - 1] ? faults.causes[reason[k]] : "";
      const overdue = events.includes("overdue") && time[k - 1] - since > faults.overdue_s - 1.5 * time[1];
      const stands = events.includes("standstill") && Math.abs(speed[k - 1]) < faults.standstill_rad_s;
      const other = stands ? "standstill" : events.find((one) => one !== "overdue");
      const event = events.includes(cause) ? cause : overdue ? "overdue" : other;
      changes.push({ time_s: time[k - 1], from, to, event, detector: cause ? faults.reasons[reason[k]] : "" });
      since = time[k - 1];
    }
    return changes;
  }

  /** A change of the state in words. */
  function sentence({ time_s, to, event, detector }) {
    const cause = detector && detector.split(" ")[0] !== event ? `${detector}, ${event}` : event;
    return `${Number(time_s.toFixed(4))} s ${to} (${cause})`;
  }

  // ---------------------------------------------------------------------------- curves

  /** Draw the faults of runs into a plot, and into the strip the states of the runs. A fault of both runs is one mark. */
  function drawRuns(chart, runs, plot) {
    const { ctx, bbox } = chart;
    const scale = devicePixelRatio;
    const x = (time) => Math.min(Math.max(chart.valToPos(time, "x", true), bbox.left), bbox.left + bbox.width);
    const marks = runs.map(({ fault }) => fault).filter(Boolean);
    const isSame = marks.length > 1 && ["label", "start_s", "end_s"].every((name) => marks[0][name] === marks[1][name]);
    ctx.save();
    ctx.font = `${11 * scale}px system-ui, sans-serif`;
    runs.forEach((run, index) => {
      if (plot.strip && run.columns.state) drawStates(chart, run, index, runs.length, x, scale);
      if (run.fault && !(isSame && index)) drawFault(chart, run.fault, index, isSame ? 1 : runs.length, plot, x, scale);
      if (run.push) drawFault(chart, run.push, index + (run.fault ? runs.length : 0), runs.length, plot, x, scale);
    });
    ctx.restore();
  }

  function drawStates(chart, run, index, count, x, scale) {
    const { ctx, bbox } = chart;
    const rows = Object.keys(run.faults.states);
    const row = bbox.height / rows.length;
    const height = (0.8 * row) / count;
    const end = run.time[run.time.length - 1];
    const changes = [{ time_s: 0, to: stateAt(run, 0) }, ...changesOf(run)];
    changes.forEach(({ time_s, to, detector }, k) => {
      const [left, right] = [time_s, changes[k + 1]?.time_s ?? end].map(x);
      const top = bbox.top + rows.indexOf(to) * row + 0.1 * row + index * height;
      ctx.fillStyle = colour(`state-${to}`);
      if (chart.scales.x.min <= (changes[k + 1]?.time_s ?? end) && time_s <= chart.scales.x.max) ctx.fillRect(left, top, Math.max(right - left, 2 * scale), height - scale);
      if (!detector || time_s < chart.scales.x.min || time_s > chart.scales.x.max) return;
      const words = `${count > 1 ? `${"AB"[index]}: ` : ""}${detector}`;
      const outside = right + 6 * scale + ctx.measureText(words).width > bbox.left + bbox.width;
      ctx.textAlign = outside ? "right" : "left";
      ctx.fillStyle = colour("ink");
      ctx.fillText(words, outside ? left - 4 * scale : Math.max(right, left + 2 * scale) + 4 * scale, top + 0.8 * height);
    });
  }

  function drawFault(chart, { label, start_s, end_s }, index, count, plot, x, scale) {
    if (start_s > chart.scales.x.max) return;
    const { ctx, bbox } = chart;
    const [left, right] = [start_s, end_s].map(x);
    const mark = colour(count > 1 ? "ab"[index % 2] : "bad");
    ctx.fillStyle = ctx.strokeStyle = mark;
    ctx.globalAlpha = 0.1;
    ctx.fillRect(left, bbox.top, right - left, bbox.height);
    ctx.globalAlpha = 1;
    if (start_s < chart.scales.x.min) return;
    ctx.lineWidth = scale;
    ctx.setLineDash([4 * scale, 3 * scale]);
    drawLine(ctx, left, bbox.top, left, bbox.top + bbox.height);
    if (plot.name !== "angle") return;
    const words = `${count > 1 ? `${"AB"[index % 2]}: ` : ""}${label}`;
    const outside = left + 6 * scale + ctx.measureText(words).width > bbox.left + bbox.width;
    ctx.textAlign = outside ? "right" : "left";
    ctx.fillText(words, left + (outside ? -4 : 4) * scale, bbox.top + (12 + 13 * index) * scale);
  }

  // --------------------------------------------------------------------------- diagram

  function drawn(tag, attributes, text) {
    const made = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text) made.textContent = text;
    return made;
  }

  /** Text in lines of a few events, around a height. */
  function lines(events, x, y, anchor) {
    const text = drawn("text", { "text-anchor": anchor });
    const rows = [];
    for (let k = 0; k < events.length; k += WORDS) rows.push(events.slice(k, k + WORDS));
    rows.forEach((row, k) => {
      const line = drawn("tspan", { x, y: y + 4 + 13 * (k - (rows.length - 1) / 2) });
      const words = row.map((event) => drawn("tspan", { class: "event", "data-event": event }, event));
      line.append(...words.flatMap((word, i) => (i ? [", ", word] : [word])), k < rows.length - 1 ? "," : "");
      text.append(line);
    });
    return text;
  }

  /** The diagram of a state machine and the changes of the shown runs. Both come from the table of the module. */
  class Diagram {
    constructor(parent) {
      this.parent = parent;
      this.runs = [];
      this.now = element("p", { class: "now" });
      this.log = element("ol", {});
      this.holder = element("div");
      parent.append(element("h2", {}, "Safety state machine"), this.holder, this.now, this.log);
    }

    /** Show runs. Hide the diagram if no run has the protection. */
    show(runs) {
      this.runs = runs.map((run, index) => ({ run, index })).filter(({ run }) => run.columns.state);
      this.parent.hidden = !this.runs.length;
      if (!this.runs.length) return;
      const [{ run: { faults } }] = this.runs;
      if (this.faults !== faults) this.build(faults);
      this.changes = this.runs.map(({ run }) => changesOf(run));
      const named = runs.length > 1;
      this.log.replaceChildren(...this.runs.flatMap(({ index }, k) => this.changes[k].map((change) =>
        element("li", { class: named ? `of-${"ab"[index]}` : "" }, `${named ? `${"AB"[index]}: ` : ""}${sentence(change)}`))));
      this.at(this.time ?? 0);
    }

    build(faults) {
      this.faults = faults;
      const states = Object.keys(faults.states);
      const edges = new Map();
      for (const [from, event, to] of faults.transitions) {
        const key = `${from} ${to}`;
        edges.set(key, { from, to, events: [...(edges.get(key)?.events ?? []), event] });
      }
      const svg = drawn("svg", { viewBox: `0 0 360 ${TOP + STEP * states.length - STEP + HEIGHT + 4}`, role: "img",
        "aria-label": `States ${states.join(", ")}; transitions ${[...edges.values()].map(({ from, to, events }) => `${from} to ${to} by ${events.join(" or ")}`).join("; ")}` });
      const arrow = drawn("marker", { id: "arrow", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 7, markerHeight: 7, markerUnits: "userSpaceOnUse", orient: "auto" });
      arrow.append(drawn("path", { d: "M0 0L8 4L0 8Z" }));
      svg.append(arrow);
      this.edges = new Map([...edges].map(([key, edge]) => [key, this.edge(svg, edge, states)]));
      this.boxes = new Map(states.map((state, row) => [state, this.box(svg, state, row, faults.states[state])]));
      this.holder.replaceChildren(svg);
    }

    box(svg, state, row, meaning) {
      const group = drawn("g", { class: "state" });
      group.style.setProperty("--state", `var(--state-${state})`); // the page allows no style in attributes
      group.append(drawn("title", {}, meaning), drawn("rect", { x: LEFT, y: TOP + STEP * row, width: WIDTH, height: HEIGHT, rx: 6 }),
        drawn("text", { x: MIDDLE, y: TOP + STEP * row + HEIGHT / 2 + 5, "text-anchor": "middle" }, state));
      svg.append(group);
      return group;
    }

    edge(svg, { from, to, events }, states) {
      const [i, j] = [from, to].map((state) => states.indexOf(state));
      const [start, end] = [i, j].map((row) => TOP + STEP * row);
      const middle = (start + end + HEIGHT) / 2;
      const far = 350 - 14 * i;
      const [line, ...label] = i === j ? [`M${RIGHT} ${start + 9}h22v12h-20`, RIGHT + 28, middle, "start"]
        : j === i + 1 ? [`M${MIDDLE} ${start + HEIGHT}V${end - 1}`, MIDDLE + 8, middle, "start"]
        : j > i ? [`M${RIGHT} ${start + 21}H${far}V${end + 9}H${RIGHT + 1}`, far - 6, start + 38, "end"]
        : [`M${LEFT} ${start + 15}H14V${end + 15}H${LEFT - 1}`, 18, middle, "start"];
      const group = drawn("g", { class: "edge" });
      group.append(drawn("title", {}, events.map((event) => `${event}: ${this.faults.events[event]}`).join("\n")),
        drawn("path", { d: line, "marker-end": "url(#arrow)" }), lines(events, ...label));
      svg.append(group);
      return group;
    }

    /** Light the states at a time, and the transitions that led to them. */
    at(time) {
      this.time = time;
      if (!this.runs.length) return;
      const present = this.runs.map(({ run }) => stateAt(run, time));
      const last = this.changes.map((changes) => changes.findLast(({ time_s }) => time_s < time));
      for (const [state, box] of this.boxes) box.classList.toggle("lit", present.includes(state));
      for (const [key, edge] of this.edges) {
        const events = last.filter((change) => change && key === `${change.from} ${change.to}`).map(({ event }) => event);
        edge.classList.toggle("lit", events.length > 0);
        for (const word of edge.querySelectorAll(".event")) word.classList.toggle("lit", events.includes(word.dataset.event));
      }
      this.now.textContent = this.runs.map(({ index }, k) => `${this.runs.length > 1 ? `${"AB"[index]}: ` : ""}${present[k]} – ${this.faults.states[present[k]]}`).join("; ");
    }
  }

  return { Diagram, changesOf, drawRuns, sentence, stateAt };
})();
