// The frequency response of the page: gain and phase, point by point as the sweep measures them.
"use strict";

const Bode = (() => {
  const { MINUS_3_DB, axis, colour, drawLine, element, fixed, painted } = Curves;
  const NAMES = ["a", "b"]; // of the colours
  const SATURATED = 0.01; // share of the time from which a point counts as limited by the motor
  const PLOTS = [
    { name: "gain", title: "Gain of the fundamental (dB)", height: 160 },
    { name: "phase", title: "Phase (deg)", height: 160 },
  ];

  /** The value of a point in a plot, or null. */
  function valueOf({ name }, point) {
    const value = name === "phase" ? point?.phase_deg : 20 * Math.log10(point?.gain);
    return Number.isFinite(value) ? value : null;
  }

  class BodePlots {
    constructor(parent) {
      this.parent = parent;
      this.points = [[], []];
      this.minus3db = [null, null];
      this.present = [null, null];
      this.plots = PLOTS.map((plot) => this.make(plot));
      new ResizeObserver(() => this.resize()).observe(parent);
    }

    make(plot) {
      const figure = element("figure", { class: "plot", "data-plot": plot.name, tabindex: "-1" });
      const box = element("div", { role: "img", "aria-label": plot.title });
      figure.append(element("figcaption", { class: "plot-title" }, plot.title), box);
      this.parent.append(figure);
      const chart = new uPlot(this.options(plot), [[0.1, 1], [null, null], [null, null]], box);
      return { ...plot, chart, box };
    }

    options(plot) {
      const line = (index) => ({
        stroke: painted(NAMES[index]), width: 1.75, dash: index ? [8, 3] : undefined, spanGaps: true,
        points: { show: false },
      });
      const range = plot.name === "gain"
        ? (_, low, high) => [Math.min(-12, (low ?? 0) - 1), Math.max(3, (high ?? 0) + 1)]
        : (_, low, high) => [Math.min(-90, 45 * Math.floor((low ?? 0) / 45)), Math.max(15, (high ?? 0) + 5)];
      return {
        width: 600, height: plot.height, legend: { show: false },
        padding: [6, 20, 0, 0], cursor: { sync: { key: "bode" }, drag: { x: false }, y: false },
        scales: { x: { time: false, distr: 3, range: (_, low, high) => [low * 0.9, high * 1.1] }, y: { range } },
        axes: [
          axis({ size: 30,
            values: (_, splits) => splits.map((value) => (value == null ? "" : `${value} Hz`)),
            splits: (chart) => decades(chart.scales.x) }),
          axis({ space: 24,
            incrs: plot.name === "phase" ? [45, 90, 180] : [3, 6, 12, 24],
            values: (_, splits) => splits.map((value) => String(value).replace("-", "−")) }),
        ],
        series: [{}, line(0), line(1)],
        hooks: { draw: [(chart) => this.annotate(chart, plot)] },
      };
    }

    /** Marks of a series: filled where the motor is at its limit, open elsewhere. */
    marks(chart, ctx, plot) {
      ctx.setLineDash([]);
      ctx.lineWidth = 1.75 * devicePixelRatio;
      for (const index of [1, 0]) {
        ctx.strokeStyle = colour(NAMES[index]);
        for (const point of this.points[index]) this.mark(chart, ctx, plot, index, point);
      }
    }

    mark(chart, ctx, plot, index, point) {
      const value = valueOf(plot, point);
      if (value === null) return;
      const x = chart.valToPos(point.frequency_hz, "x", true);
      const y = chart.valToPos(value, "y", true);
      if (y < chart.bbox.top || y > chart.bbox.top + chart.bbox.height) return;
      ctx.beginPath();
      const size = (index ? 5.5 : 3.5) * devicePixelRatio; // B stays visible behind A
      if (index === 0) ctx.arc(x, y, size, 0, 2 * Math.PI);
      else ctx.rect(x - size, y - size, 2 * size, 2 * size);
      ctx.fillStyle = colour(point.saturated_share > SATURATED ? NAMES[index] : "ground");
      ctx.fill();
      ctx.stroke();
    }

    /** The −3 dB line, its crossings, and the present frequency. */
    annotate(chart, plot) {
      const { ctx, bbox } = chart;
      ctx.save();
      ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
      if (plot.name === "gain") this.level(chart, ctx, bbox);
      ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
      this.minus3db.forEach((hz, index) => {
        const x = chart.valToPos(hz, "x", true);
        ctx.strokeStyle = colour(NAMES[index]);
        if (hz) drawLine(ctx, x, bbox.top, x, bbox.top + bbox.height);
      });
      this.marks(chart, ctx, plot);
      ctx.restore();
    }

    level(chart, ctx, bbox) {
      const y = chart.valToPos(MINUS_3_DB, "y", true);
      ctx.strokeStyle = colour("limit");
      ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
      drawLine(ctx, bbox.left, y, bbox.left + bbox.width, y);
      ctx.fillStyle = colour("soft");
      ctx.textAlign = "right";
      ctx.fillText("−3 dB", bbox.left + bbox.width - 4 * devicePixelRatio, y - 5 * devicePixelRatio);
    }

    clear(index, frequencies = this.frequencies) {
      const isEmpty = !this.points[index].length && this.minus3db[index] === null;
      if (isEmpty && this.frequencies === frequencies) return;
      this.points[index] = [];
      this.minus3db[index] = null;
      this.frequencies = frequencies;
      this.draw();
    }

    add(index, point) {
      this.points[index].push({ ...point });
      this.points[index].sort((a, b) => a.frequency_hz - b.frequency_hz);
      unwrap(this.points[index]);
      this.draw();
    }

    setMinus3db(index, hz) {
      this.minus3db[index] = Number.isFinite(hz) ? hz : null;
      this.draw();
    }

    draw() {
      const all = [...(this.frequencies ?? [0.1, 1]), ...this.points.flat().map((point) => point.frequency_hz)];
      const grid = [...new Set(all)].sort((a, b) => a - b);
      for (const { chart, name, box, title } of this.plots) {
        const values = this.points.map((points) => {
          const at = new Map(points.map((point) => [point.frequency_hz, point]));
          return grid.map((hz) => valueOf({ name }, at.get(hz)));
        });
        chart.setData([grid, ...values]);
        box.setAttribute("aria-label", `${title} over frequency. ${this.summary()}`);
      }
    }

    summary() {
      return this.points.map((points, index) => {
        if (!points.length) return "";
        const hz = this.minus3db[index];
        const name = this.points.every((other) => other.length) ? `${"AB"[index]}: ` : "";
        return `${name}${points.length} points, ${hz ? `−3 dB at ${fixed(hz)} Hz` : "no −3 dB point yet"}.`;
      }).join(" ");
    }

    resize(paper = 0) {
      const width = paper || Math.floor(this.plots[0].box.clientWidth);
      if (width < 50) return;
      for (const { chart, height } of this.plots) chart.setSize({ width, height });
    }
  }

  /** Add whole turns to the phases, so that no phase jumps by more than half a turn from the one before. */
  function unwrap(points) {
    let before = 0; // a knee follows a slow sine
    for (const point of points) {
      if (Number.isFinite(point.phase_deg)) {
        point.phase_deg -= 360 * Math.round((point.phase_deg - before) / 360);
        before = point.phase_deg;
      }
    }
  }

  /** Ticks at 1 and 3 of each decade within a scale. */
  function decades({ min, max }) {
    const ticks = [];
    for (let power = Math.floor(Math.log10(min)); power <= Math.ceil(Math.log10(max)); ++power) {
      for (const digit of [1, 3]) {
        const value = Number(`${digit}e${power}`);
        if (value >= min && value <= max) ticks.push(value);
      }
    }
    return ticks;
  }

  return { BodePlots, SATURATED };
})();
