// The curves of the page: plots over one time axis, and the frequency response.
"use strict";

const Curves = (() => {
  const DESIGN_PX = 900; // height of a window whose plots have the heights below
  const FONT = "12px system-ui, sans-serif";
  const EVENT_SPEED = 0.25; // of the leg after a step, fault or push
  const DEG = 180 / Math.PI;
  const RPM = 30 / Math.PI;
  const MINUS_3_DB = 20 * Math.log10(Math.SQRT1_2);

  // Extra lines of a plot: a column or a limit of the run, and the dashes of A and B. A line with a label has its value at the cursor.
  const REFERENCE = { of: "reference", label: "reference", stroke: "ink", width: 1.25, dash: [[6, 4], [2, 4]] };
  const WEARER = { of: "wearer", stroke: "wearer", width: 1.25, dash: [[10, 3, 2, 3], [10, 3, 2, 3]] };
  const limit = (of, sign, label) => ({ of, sign, label, stroke: "limit", width: 1, dash: [[2, 3], [2, 6]] });
  const CHAMBER = [limit("relief_pressure_pa", 1, "relief"), limit("pressure_rating_pa", 1, "rating")];

  // Each plot has a column of a run, the factor to the unit of its axis, and perhaps extra lines. A `further` plot is
  // shown if a user chooses it. Not each run has the column of an `optional` plot.
  const PLOTS = [
    { name: "angle", title: "Knee angle", unit: "deg", factor: DEG, height: 150, extra: [REFERENCE, WEARER] },
    { name: "state", title: "State of the protection", unit: "", factor: -1, height: 92, strip: true, optional: true },
    { name: "error", title: "Error, reference minus angle", unit: "deg", factor: DEG, height: 100 },
    { name: "torque", title: "Torque of the wearer on the exoskeleton", unit: "N·m", factor: 1, height: 110, optional: true },
    { name: "command", title: "Motor speed command", unit: "rpm", factor: RPM, height: 110,
      extra: [limit("command_limit_rad_s", 1), limit("command_limit_rad_s", -1)] },
    { name: "pressure", title: "Load pressure", unit: "bar", factor: 1e-5, height: 100 },
    { name: "kneeTorque", title: "Torque at the knee, positive flexes", unit: "N·m", factor: 1, height: 100, optional: true, further: true },
    { name: "cap", title: "Pressure on the cap side", unit: "bar", factor: 1e-5, height: 100, extra: CHAMBER, optional: true, further: true },
    { name: "rodSide", title: "Pressure on the rod side", unit: "bar", factor: 1e-5, height: 100, extra: CHAMBER, optional: true, further: true },
    { name: "current", title: "Motor current", unit: "A", factor: 1, height: 100, optional: true, further: true },
    { name: "winding", title: "Temperature of the winding", unit: "°C", factor: 1, height: 100, optional: true, further: true },
  ];
  const START = PLOTS.filter(({ further }) => !further).map(({ name }) => name); // curves of a page that opens
  const PINS = [[5, 4], [2, 3], [10, 3], [9, 3, 2, 3]]; // dashes of the pinned runs
  const FREE_DASH = [3, 3]; // without a push
  const DASHES = { free: FREE_DASH, reference: REFERENCE.dash[0], wearer: WEARER.dash[0], limit: CHAMBER[0].dash[0], ...Object.fromEntries(PINS.map((dash, slot) => [`pin-${slot}`, dash])) };

  /** The present colour of that name in the style sheet. On paper it is that of light screens. */
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  /** The same as a function, which uPlot calls for each picture. */
  const painted = (name) => () => colour(name);

  function element(tag, attributes = {}, text = "") {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text) made.textContent = text;
    return made;
  }

  function axis(more) {
    return {
      stroke: painted("soft"), font: FONT, size: 58, grid: { stroke: painted("grid"), width: 1 },
      ticks: { stroke: painted("grid"), width: 1 }, ...more,
    };
  }

  /** A column at the times of the longer run. The column is null where its run has no sample. */
  function onTime(run, column, time, factor) {
    const same = run.time.length < 2 || Math.abs(run.time[1] - time[1]) < 1e-12;
    const whole = same && run.time.length === time.length && multiplied(column, factor);
    if (whole) return whole;
    const values = new Array(time.length).fill(null);
    const end = run.time[run.time.length - 1];
    let at = 0;
    for (let i = 0; i < time.length && time[i] <= end + 1e-9; ++i) {
      if (same) at = i;
      else while (at + 1 < run.time.length && run.time[at + 1] <= time[i] + 1e-12) ++at;
      if (Number.isFinite(column[at])) values[i] = factor * column[at];
    }
    return values;
  }

  /** A column times a factor, or null if an element is not finite. */
  function multiplied(column, factor) {
    const values = new Float64Array(column.length);
    for (let i = 0; i < values.length; ++i) {
      if (!Number.isFinite(column[i])) return null;
      values[i] = factor * column[i];
    }
    return values;
  }

  // Columns of a run, with the names that signals.csv of kneexo simulate has for them.
  const CSV = {
    knee_angle_rad: "angle", knee_reference_rad: "reference", motor_speed_command_rad_s: "command",
    load_pressure_pa: "pressure", cap_pressure_pa: "cap", rod_side_pressure_pa: "rodSide", motor_current_a: "current",
    winding_temperature_degc: "winding", safety_state: "state", safety_reason: "reason", wearer_angle_rad: "wearer", interaction_torque_n_m: "torque",
  };

  /** The curves of a run as the text of a CSV file in SI units. */
  function csvOf({ time, columns }) {
    const names = Object.keys(CSV).filter((name) => columns[CSV[name]]);
    const lines = Array.from(time, (t, row) =>
      [Number(t.toFixed(9)), ...names.map((name) => columns[CSV[name]][row])].join(","));
    return `${["time_s", ...names].join(",")}\n${lines.join("\n")}\n`;
  }

  class RunPlots {
    /**
     * Plots in `parent`, those with the names `chosen`. `onSeek(t)` gets the time that a click chooses. While two cursors
     * measure, a click moves the nearer one, and `onMeasure([t1, t2])` gets their times. `onPart([low, high], speed)`
     * gets the part of the run in view, or null for the whole run, and the speed of an event.
     */
    constructor(parent, onCursor, onSeek, onMeasure, onPart) {
      Object.assign(this, { parent, onCursor, onSeek, onMeasure, onPart, cursors: null, range: null, hovered: false, chosen: START });
      Object.assign(this, { runs: [], pinned: [], shown: [], states: [], one: "angle" }); // rows of the strip, and the plot of a phone
      this.plots = PLOTS.map((plot) => this.make(plot));
      this.arrange();
      new ResizeObserver(() => this.resize()).observe(parent);
      addEventListener("resize", () => this.resize()); // of the height
    }

    make(plot) {
      const figure = element("figure", { class: "plot", "data-plot": plot.name, tabindex: "-1" });
      const caption = element("figcaption");
      const title = element("span", { class: "plot-title" }, titleOf(plot));
      const values = element("span", { class: "plot-values number", "aria-hidden": "true" });
      caption.append(title, values);
      const box = element("div", { role: "img", "aria-label": plot.title });
      figure.append(caption, box);
      this.parent.append(figure);
      const chart = new uPlot(this.options(plot), this.series(plot).map(() => []), box);
      const head = element("div", { class: "playhead" });
      chart.over.append(head);
      chart.over.addEventListener("pointerenter", () => { this.hovered = true; });
      chart.over.addEventListener("pointerleave", () => { this.hovered = false; });
      chart.over.addEventListener("click", () => {
        const time = chart.posToVal(chart.cursor.left, "x");
        if (!(time >= 0 && Number.isFinite(time))) return;
        if (this.cursors) this.measure(this.withNearest(time));
        else this.onSeek(time);
      });
      return { ...plot, chart, box, figure, values, head };
    }

    /** Series in the order of the columns: time, A, B, their extra lines, both without a push, the pinned runs. */
    series(plot) {
      const main = ["a", "b"].map((name) => ({ stroke: painted(name), width: 1.75, ...(plot.strip && { paths: () => null }) }));
      const extra = [0, 1].flatMap((index) => {
        return (plot.extra ?? []).map(({ stroke, width, dash }) => ({ stroke: painted(index ? "b" : stroke), width, dash: dash[index] }));
      });
      const free = ["a", "b"].map((name) => ({ stroke: painted(name), width: 1, dash: FREE_DASH }));
      const pinned = PINS.map((dash, slot) => ({ stroke: painted(`pin-${slot}`), width: 1.5, dash }));
      return [{}, ...[...main, ...extra, ...free, ...pinned].map((line) => ({ ...line, points: { show: false } }))];
    }

    /** Whether a plot has the labels of the time axis: the first and the last one, so that they stay in view. */
    hasTimes({ name }) {
      return this.shown.at(0)?.name === name || this.shown.at(-1)?.name === name;
    }

    options(plot) {
      return {
        width: 600, height: plot.height, legend: { show: false },
        padding: [6, 16, 0, 0],
        cursor: { sync: { key: "run" }, drag: { x: true, y: false, setScale: true }, y: false },
        scales: { x: { time: false }, y: { range: (_, low, high) => (plot.strip ? [0.5 - this.states.length, 0.5] : padded(low, high)) } },
        axes: [
          axis({ size: () => (this.hasTimes(plot) ? 30 : 6), values: (_, splits) =>
            splits.map((value) => (this.hasTimes(plot) ? `${tick(value)} s` : "")) }),
          plot.strip ? axis({ splits: () => this.states.map((_, row) => -row), values: () => this.states, gap: 2,
            font: "11px system-ui, sans-serif", ticks: { show: false }, grid: { show: false } })
            : axis({ space: 20, values: (_, splits) => splits.map(tick) }),
        ],
        series: this.series(plot),
        hooks: {
          setScale: [(chart, key) => key === "x" && this.follow(chart)],
          setCursor: [(chart) => this.read(chart)],
          draw: [(chart) => Safety.drawRuns(chart, this.runs, plot), () => this.moveHeads(),
            (chart) => this.cursors?.forEach((time, k) => drawCursor(chart, time, `${k + 1}`))],
        },
      };
    }

    /**
     * Show one or two runs, and pinned ones: objects with slot and run. The zoom stays the same if duration and kinds of
     * reference stay the same, unless the first part of a run has set the zoom.
     */
    show(runs, pinned = []) {
      const longest = runs.reduce((a, b) => (b.time.length > a.time.length ? b : a));
      const time = longest.time;
      const end = Math.max(...runs.map((run) => run.duration_s));
      const kind = runs.map((run) => `${run.reference} ${run.fault ? `${run.fault.label} ${run.fault.start_s}` : ""}${run.push ? ` push ${run.push.start_s}` : ""}`).join(" ");
      this.states = Object.keys(runs.find((run) => run.columns.state)?.faults.states ?? {});
      const again = this.end === end && this.kind === kind && this.range !== null;
      const unfinished = runs.some((run) => run.unfinished);
      const keeps = again && (unfinished || !this.isFirst);
      Object.assign(this, { runs, pinned, end, kind, showing: true, isFirst: unfinished && (!again || this.isFirst) });
      const empty = new Array(time.length).fill(null);
      this.arrange();
      for (const plot of this.shown) {
        plot.data = this.columns(plot, time, empty);
        plot.data.forEach((column, index) => { plot.chart.series[index].show = column !== empty; }); // saves time
        plot.chart.setData(plot.data, false);
        plot.chart.series[1].width = runs.length > 1 ? 3.5 : 1.75; // A stays visible behind B
        describe(plot, runs);
      }
      this.showing = false;
      this.parent.classList.remove("waiting");
      const event = keeps ? null : eventOf(runs);
      this.zoom(keeps ? this.range : event ?? [0, end], event ? EVENT_SPEED : undefined);
      if (this.cursors) this.measure(keeps ? this.cursors : this.quarters());
    }

    /** Lay out the chosen plots that the runs have. A phone shows one plot at a time. The others cost nothing. */
    arrange() {
      const before = this.shown;
      const wanted = this.single ? [this.one] : this.chosen;
      const shown = this.plots.filter((plot) => this.has(plot) && wanted.includes(plot.name));
      this.shown = shown.length ? shown : this.plots.slice(0, 1);
      for (const plot of this.plots) plot.figure.hidden = !this.shown.includes(plot);
      if (this.shown.length !== before.length || this.shown.some((plot, k) => plot !== before[k])) this.resize();
    }

    has({ name, optional }) {
      return !optional || this.runs.some((run) => run.columns[name]);
    }

    /** Measure between two times in s, or no longer if `times` is null. */
    measure(times) {
      this.cursors = times && times.map((time) => Math.min(Math.max(time, 0), this.end ?? 0));
      for (const { chart } of this.shown) {
        chart.redraw(false);
        this.read(chart);
      }
      this.onMeasure(this.cursors);
    }

    /** The times at a quarter and at three quarters of the shown part of the run. */
    quarters() {
      const [low, high] = this.range ?? [0, 0];
      return [0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high];
    }

    /** The cursors after the nearer one has moved to a time. */
    withNearest(time) {
      const [first, second] = this.cursors;
      return Math.abs(time - first) <= Math.abs(time - second) ? [time, second] : [first, time];
    }

    /** The columns of the series of a plot at the times: `empty` for a series that the runs do not have. */
    columns(plot, time, empty) {
      const column = (run, name, factor) => {
        if (Number.isFinite(run?.limits?.[name])) return new Array(time.length).fill(factor * run.limits[name]);
        return run?.columns[name] ? onTime(run, run.columns[name], time, factor) : empty;
      };
      const [a, b] = this.runs;
      const main = [a, b].map((run) => column(run, plot.name, plot.factor));
      const extra = [a, b].flatMap((run) => {
        return (plot.extra ?? []).map(({ of, sign = 1 }) => (of === "reference" && run?.same_reference ? empty : column(run, of, sign * plot.factor)));
      });
      const free = [a, b].map((run) => column(run?.free && { time: run.time, columns: run.free }, plot.name, plot.factor));
      const pinned = PINS.map((_, slot) => column(this.pinned.find((pin) => pin.slot === slot)?.run, plot.name, plot.factor));
      return [time, ...main, ...extra, ...free, ...pinned];
    }

    follow(chart) {
      if (this.showing || chart.scales.x.min == null) return;
      const { min, max } = chart.scales.x;
      if (this.range && this.range[0] === min && this.range[1] === max) return;
      this.zoom([min, max]);
    }

    zoom([low, high], speed) {
      const most = this.end ?? 1;
      const width = Math.min(most, Math.max(high - low, most / 1000));
      const start = Math.min(Math.max(low, 0), most - width);
      this.range = [start, start + width];
      this.showing = true;
      for (const { chart } of this.shown) chart.setScale("x", { min: start, max: start + width });
      this.showing = false;
      this.onPart(width < most ? this.range : null, speed);
    }

    zoomBy(factor) {
      if (!this.range) return; // before the first run
      const [low, high] = this.range;
      const middle = Math.min(high, Math.max(low, this.time ?? (low + high) / 2));
      const width = factor * (high - low);
      this.zoom([middle - width / 2, middle + width / 2]);
    }

    zoomAll() { if (this.range) this.zoom([0, this.end]); }

    /** Put the playheads at the time of the stage. */
    moveHeads() {
      for (const { chart, head } of this.shown) {
        const left = chart.valToPos(this.time ?? 0, "x");
        head.hidden = !(left >= 0 && left <= chart.over.clientWidth);
        head.style.left = `${left}px`;
      }
    }

    /** Show the time of the stage, and put the cursor there unless a pointer reads the curves. */
    setTime(time) {
      this.time = time;
      this.moveHeads();
      if (this.hovered || !this.runs.length) return;
      const [{ chart }] = this.shown;
      const left = chart.valToPos(time, "x");
      const inside = left >= 0 && left <= chart.over.clientWidth;
      chart.setCursor({ left: inside ? left : -10, top: 0 });
    }

    read(chart) {
      const index = chart.cursor.idx;
      const plot = this.plots?.find((other) => other.chart === chart);
      if (!plot?.data) return;
      if (this.cursors) plot.values.replaceChildren(...this.differences(plot));
      else this.readAt(plot, index);
      if (chart === this.shown[0].chart) this.onCursor(index == null ? null : plot.data[0][index]);
    }

    /** The column of a pinned run in a plot. */
    pinnedColumn(plot, slot) {
      return plot.data.at(slot - PINS.length);
    }

    /** The difference of each run between both cursors, and if a run is alone its values there. */
    differences(plot) {
      const rows = this.cursors.map((time) => nearest(plot.data[0], time));
      const columns = [...this.runs.map((_, run) => [`of-${"ab"[run]}`, "AB"[run], plot.data[run + 1]]),
        ...this.pinned.map(({ slot }) => [`pin-${slot}`, "", this.pinnedColumn(plot, slot)])];
      return columns.map(([name, label, column]) => {
        const [first, second] = rows.map((row) => column[row]);
        if (first == null || second == null) return element("span", { class: name }, "–");
        return element("span", { class: name }, 
          `${columns.length > 1 ? label : `${fixed(first)} → ${fixed(second)},`} Δ ${signed(second - first)}`.trim());
      });
    }

    readAt(plot, index) {
      const named = ["A", "B"].slice(0, this.runs.length);
      if (plot.strip) {
        plot.values.textContent = index == null ? "" : this.runs.filter((run) => run.columns.state).map((run) => Safety.stateAt(run, plot.data[0][index])).join(", ");
        return;
      }
      plot.values.replaceChildren(...(index == null ? [] : named.map((name, run) => {
        const value = plot.data[run + 1][index];
        const text = `${this.runs.length > 1 ? `${name} ` : ""}${value == null ? "–" : fixed(value)}`;
        return element("span", { class: `of-${name.toLowerCase()}` }, text);
      })));
      if (index == null) return;
      (plot.extra ?? []).forEach(({ label }, k) => {
        const value = plot.data[3 + k][index];
        if (label && value != null) plot.values.prepend(element("span", { class: "of-reference" }, `${label} ${fixed(value)}`));
      });
      for (const { slot } of this.pinned) {
        const pinned = this.pinnedColumn(plot, slot)[index];
        const now = plot.data[1][index];
        const change = now == null || this.pinned.length > 1 ? "" : ` (${signed(now - pinned)})`;
        if (pinned != null) plot.values.append(element("span", { class: `pin-${slot}` }, `pinned ${fixed(pinned)}${change}`));
      }
    }

    /** A canvas with all shown plots and their titles, below a legend of [name, words, colour] and above lines of text. */
    picture(words, lines) {
      const { shown } = this;
      const scale = devicePixelRatio;
      const line = 24 * scale;
      const { width } = shown[0].chart.ctx.canvas;
      const ruler = element("canvas").getContext("2d");
      ruler.font = `${13 * scale}px system-ui, sans-serif`;
      const places = [];
      let [right, rows] = [8 * scale, 1];
      for (const [name, text, style] of words) {
        const size = 32 * scale + ruler.measureText(text).width;
        if (right + size > width && right > 8 * scale) [right, rows] = [8 * scale, rows + 1];
        places.push([name, text, style, right, rows]);
        right += size + 16 * scale;
      }
      const height = shown.reduce((sum, { chart }) => sum + line + chart.ctx.canvas.height, (rows + lines.length) * line);
      const canvas = Object.assign(element("canvas"), { width, height });
      const ctx = canvas.getContext("2d");
      ctx.fillStyle = colour("ground");
      ctx.fillRect(0, 0, width, height);
      const write = (text, style, weight, y, x = 8 * scale) => {
        ctx.font = `${weight} ${13 * scale}px system-ui, sans-serif`;
        ctx.fillStyle = style;
        ctx.fillText(text, x, y, width - 16 * scale);
      };
      for (const [name, text, style, x, row] of places) {
        Object.assign(ctx, { strokeStyle: style, lineWidth: 2 * scale });
        ctx.setLineDash((DASHES[name] ?? []).map((length) => length * scale));
        drawLine(ctx, x, (row - 0.5) * line, x + 26 * scale, (row - 0.5) * line);
        write(text, style, 400, (row - 0.3) * line, x + 32 * scale);
      }
      let y = rows * line;
      for (const { chart, title, unit } of shown) {
        write(titleOf({ title, unit }), colour("ink"), 600, y + 0.7 * line);
        ctx.drawImage(chart.ctx.canvas, 0, y + line);
        y += line + chart.ctx.canvas.height;
      }
      lines.forEach((text, k) => write(text, colour("soft"), 400, y + (k + 0.7) * line));
      return canvas;
    }

    /** Fit the plots to the window, or to `paper` px, until it is 0. A phone shows one plot at a time. */
    resize(paper = this.paper ?? 0) {
      this.paper = paper;
      const width = paper || Math.floor(this.parent.clientWidth);
      if (width < 50) return;
      const single = !paper && getComputedStyle(this.parent).getPropertyValue("--single").trim() === "1";
      if (single !== Boolean(this.single)) {
        this.single = single;
        if (this.runs.length) this.show(this.runs, this.pinned);
        else this.arrange();
      }
      const tall = paper || single ? 1 : Math.max(1, innerHeight / DESIGN_PX);
      for (const plot of this.shown) plot.chart.setSize({ width, height: Math.round(tall * plot.height) + (this.hasTimes(plot) ? 24 : 0) });
    }
  }

  function padded(low, high) {
    if (low == null || high == null) return [-1, 1];
    const room = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1e-3;
    return [low - room, high + room];
  }

  function tick(value) {
    return String(Number(value.toPrecision(6))).replace("-", "−");
  }

  function fixed(value) {
    const digits = Math.abs(value) >= 1000 ? 0 : Math.abs(value) >= 100 ? 1 : Math.abs(value) >= 1 ? 2 : 3;
    return value.toFixed(digits).replace("-", "−");
  }

  const titleOf = ({ title, unit }) => (unit ? `${title} (${unit})` : title);

  /**
   * The times around the faults or steps of all runs, or null if a run does not settle after a step. A run with
   * a fault that never is safe shows its largest error and torque too, so that it looks no better than it is.
   */
  function eventOf(runs) {
    const faulty = runs.filter(({ fault, metrics }) => fault && metrics.protection.worst_time_s !== null);
    if (faulty.length) {
      const start = Math.min(...faulty.map(({ fault }) => fault.start_s));
      const end = Math.max(...faulty.map(({ metrics: { protection: { safe_time_s: safe, worst_time_s: worst } } }) => safe ?? worst));
      const width = Math.max(end - start, 0.1);
      return [start - width, end + 2 * width];
    }
    const pushes = runs.filter(({ push }) => push);
    if (pushes.length) return aroundPushes(pushes);
    const ends = runs.map(({ step_s: start, metrics: { settling_time_s: settling, push } }) =>
      (settling > 0 && !push ? [start, start + 3 * settling] : null));
    if (!ends.every(Boolean)) return null;
    const [first, last] = [Math.min(...ends.map(([start]) => start)), Math.max(...ends.map(([, end]) => end))];
    return [first - 0.15 * (last - first), last];
  }

  /** The times around pushes, until all knees are back. */
  function aroundPushes(runs) {
    const start = Math.min(...runs.map(({ push }) => push.start_s));
    const end = Math.max(...runs.map(({ push, metrics }) => Math.max(push.end_s, push.start_s + (metrics.push?.recovery_time_s ?? 1))));
    return [start - 0.3 * (end - start), end + 0.7 * (end - start)];
  }

  function drawLine(ctx, x, y, toX, toY) {
    ctx.beginPath();
    ctx.moveTo(x, y);
    ctx.lineTo(toX, toY);
    ctx.stroke();
  }

  /** A line with a number at a time of a plot. */
  function drawCursor(chart, time, number) {
    const { ctx, bbox } = chart;
    const x = chart.valToPos(time, "x", true);
    if (x < bbox.left - 1 || x > bbox.left + bbox.width + 1) return;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = colour("ink");
    ctx.setLineDash([]);
    ctx.textAlign = "left";
    ctx.lineWidth = devicePixelRatio;
    drawLine(ctx, x, bbox.top, x, bbox.top + bbox.height);
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.fillText(number, x + 3 * devicePixelRatio, bbox.top + 10 * devicePixelRatio);
    ctx.restore();
  }

  /** The row of the time that is nearest to a time. */
  function nearest(times, time) {
    const period = times[1] - times[0];
    return Math.min(Math.max(Math.round((time - times[0]) / period), 0), times.length - 1);
  }

  /** A difference, with its sign. */
  function signed(value) {
    return `${value < 0 ? "" : "+"}${fixed(value)}`;
  }

  /** Label a plot with its extremes for a screen reader. */
  function describe(plot, runs) {
    const parts = runs.map((run, index) => {
      let low = Infinity;
      let high = -Infinity;
      for (const value of run.columns[plot.name] ?? []) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
      const name = runs.length > 1 ? `${"AB"[index]} ` : "";
      if (plot.strip && run.columns.state) return `${name}${Safety.changesOf(run).map(Safety.sentence).join(", ")}`;
      if (low > high) return `${name}no values`;
      return `${name}from ${fixed(plot.factor * low)} to ${fixed(plot.factor * high)} ${plot.unit}`;
    });
    plot.box.setAttribute("aria-label", `${plot.title} over time: ${parts.join("; ")}`);
  }

  return { MINUS_3_DB, PLOTS, RunPlots, START, axis, colour, csvOf, drawLine, element, fixed, onTime, painted };
})();
