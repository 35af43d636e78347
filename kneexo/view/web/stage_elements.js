"use strict";

/* The elements around the legs of a stage: boxes, play bar, legend, error trace, gestures. */
const StageElements = (() => {
  const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#b3508a", "#3a8fc4", "#000000"];
  const DASHES = [[], [8, 4], [2, 3]];
  const READOUTS = ["knee angle", "reference", "error", "pressure", "wearer's knee", "wearer's torque"];
  const TITLES = {
    error: "reference minus knee angle",
    "wearer's torque": "on the exoskeleton; a positive torque flexes the knee",
  };

  const ERROR_AXIS = {
    label: "error (deg)",
    size: 60,
    space: 24,
    values: (_, ticks) => ticks.map((tick) => String(tick).replace("-", "−")),
  };

  /** A new element with properties and children, which may be texts. */
  function make(tag, properties = {}, children = []) {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  }

  function box(className, label) {
    const canvas = make("canvas", { tabIndex: 0 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", label);
    return { canvas, element: make("div", { className: `stage-box ${className}` }, [canvas]) };
  }

  /** Name, leg, linkage and numbers of one leg. */
  function legFigure() {
    const name = make("span", { className: "name" });
    const enlarged = make("span", { className: "joint", textContent: "four-bar linkage, enlarged" });
    const caption = make("figcaption", {}, [name, enlarged]);
    const whole = box("whole", "the leg; drag to turn it, space plays, arrows move the time");
    const joint = box("joint", "the four-bar linkage, enlarged");
    const values = {};
    const rows = READOUTS.map((text) => {
      values[text] = make("dd");
      const title = TITLES[text] ?? "";
      return make("div", { title, className: text === "pressure" ? "wide" : "" }, [make("dt", { textContent: text }), values[text]]);
    });
    const boxes = make("div", { className: "stage-boxes" }, [whole.element, joint.element]);
    const numbers = make("dl", { className: "stage-readout" }, rows);
    const element = make("figure", { className: "stage-leg" }, [caption, boxes, numbers]);
    return { element, name, whole: whole.canvas, joint: joint.canvas, values };
  }

  /** Button, slider and choices for the time of a stage. */
  function playBar(stage) {
    const play = make("button", { type: "button", className: "play" });
    play.addEventListener("click", () => (stage.playing ? stage.pause() : stage.play()));
    const slider = make("input", { type: "range", min: 0, max: 0, step: 0.01, value: 0 });
    slider.setAttribute("aria-label", "time");
    slider.addEventListener("input", () => stage.seek(Number(slider.value)));
    const clock = make("output");
    const options = SPEEDS.map((speed) =>
      make("option", { value: speed, textContent: `${speed} ×`, selected: speed === 1 }),
    );
    const speed = make("select", {}, options);
    speed.addEventListener("change", () => (stage.speed = Number(speed.value)));
    const loop = make("input", { type: "checkbox", checked: true });
    loop.addEventListener("change", () => (stage.loop = loop.checked));
    const repeated = make("span", { textContent: " Repeat" });
    const view = make("button", { type: "button", textContent: "Reset view" });
    view.addEventListener("click", () => stage.resetView());
    const push = make("button", { type: "button", textContent: "Push here", hidden: true, title: "push at this time (P), or drag the shank" });
    push.addEventListener("click", () => stage.onPush(null));
    const element = make("div", { className: "stage-bar" }, [
      play,
      slider,
      clock,
      make("label", {}, ["Speed ", speed]),
      make("label", {}, [loop, repeated]),
      push,
      view,
    ]);
    return { element, push, play, slider, clock, speed, repeated };
  }

  /** A small canvas with the drawing of `draw`. */
  function swatch(width, draw) {
    const canvas = make("canvas", { width: 2 * width, height: 28 });
    canvas.style.width = `${width}px`;
    canvas.style.height = "14px";
    const context = canvas.getContext("2d");
    context.scale(2, 2);
    draw(context);
    return canvas;
  }

  const css = ([red, green, blue]) => `rgb(${255 * red} ${255 * green} ${255 * blue})`;

  function pressureScale(leg) {
    return swatch(140, (context) => {
      const gradient = context.createLinearGradient(0, 0, 140, 0);
      leg.data.pressure_colours.forEach((colour, k) => gradient.addColorStop(k / 2, css(colour)));
      context.fillStyle = gradient;
      context.fillRect(0, 0, 140, 14);
    });
  }

  function line(colour, width, dash = []) {
    return swatch(28, (context) => {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.setLineDash(dash);
      context.strokeRect(-5, 7, 40, 40);
    });
  }

  /** The meaning of colours and lines, with the scales of the pressure and of the wearer's torque. */
  function legend(legs, quarterTurn) {
    const [leg] = legs;
    const equal = legs.every((other) => other.data.rating_pa === leg.data.rating_pa);
    const full = equal ? StageModel.pressureText(leg.data.rating_pa, leg.data.pressure_unit) : "rating";
    const colour = (name) => css(leg.data.parts.find((part) => part.name === name).colour);
    const item = (children, className = "") => make("li", { className }, children);
    const wearer = [
      item([line(StageArrow.COLOUR, 4), `arrow: torque of the wearer on the exoskeleton, `
        + `a quarter turn is ${quarterTurn} N·m`], "wearer"),
      item(["the limb is the wearer's; brace and bars are the exoskeleton"]),
    ];
    return make("ul", { className: "stage-legend" }, [
      item(["cylinder: load pressure −", full, pressureScale(leg), `+${full}`]),
      item([line("#15181c", 2), "outline: reference"]),
      item([line(colour("link_2"), 7), "link 2, flat"]),
      item([line(colour("link_4"), 7), "link 4, round"]),
      item([line(colour("thigh_plate"), 7), "plate of the thigh"]),
      item([line(colour("shank_plate"), 7), "plate of the shank"]),
      ...leg.data.centre_paths.map((path) => item([line(path.colour, 2), path.label])),
      ...(quarterTurn > 0 ? wearer : []),
    ]);
  }

  /** The error of the runs over time, with a cursor at the time of the stage. */
  class Trace {
    constructor(stage) {
      this.stage = stage;
      this.element = make("div", { className: "stage-trace" });
      this.cursor = make("div", { className: "stage-cursor" });
    }

    /** Draw the runs again. */
    show() {
      const runs = this.stage.legs.filter((leg) => leg.run);
      this.plot?.destroy();
      this.plot = null;
      if (runs.length === 0) return;
      const tables = runs.map(({ run }) => [
        Array.from(run.time),
        Array.from(run.angle, (angle, k) => ((run.reference[k] - angle) * 180) / Math.PI),
      ]);
      const data = tables.length > 1 ? uPlot.join(tables) : tables[0];
      this.plot = new uPlot(this._options(runs), data, this.element);
      this.plot.over.append(this.cursor);
      this.plot.over.addEventListener("click", (event) => {
        this.stage.seek(this.plot.posToVal(event.offsetX, "x"));
      });
      this.move();
    }

    _options(runs) {
      return {
        ...this._size(),
        legend: { show: runs.length > 1, live: false },
        cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
        scales: { x: { time: false } },
        axes: [{ label: "time (s)", size: 32, labelSize: 20 }, ERROR_AXIS],
        series: [
          {},
          ...runs.map((leg, k) => ({
            label: leg.name,
            stroke: COLOURS[k % COLOURS.length],
            dash: DASHES[Math.floor(k / COLOURS.length) % DASHES.length],
            width: 1.5,
            spanGaps: true,
            points: { show: false },
          })),
        ],
      };
    }

    _size(width = this.element.clientWidth) {
      return { width: Math.max(width, 240), height: 200 };
    }

    /** Fit the curve to its element, or to a width in CSS pixels. */
    resize(width) {
      this.plot?.setSize(this._size(width));
    }

    move() {
      if (!this.plot) return;
      const x = this.plot.valToPos(this.stage.time, "x");
      this.cursor.style.transform = `translateX(${x}px)`;
    }
  }

  /** A drag on the shank pushes it, another drag turns the legs. Two fingers, or Ctrl and the wheel, enlarge them. Other gestures scroll. */
  function listenToGestures(canvas, stage, index) {
    const pointers = new Map();
    const gap = () => {
      const [a, b] = [...pointers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (pointers.size > 1) stage.release(false);
      else stage.grab(index, event);
    });
    canvas.addEventListener("touchstart", (event) => stage.pull && event.preventDefault(), { passive: false }); // no scrolling
    canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const before = pointers.size > 1 ? gap() : 0;
      const next = { x: event.clientX, y: event.clientY };
      pointers.set(event.pointerId, next);
      if (stage.pull?.pointer === event.pointerId) stage.drag(event);
      else if (pointers.size > 1) stage.enlarge(gap() / (before || 1));
      else stage.turn(0.008 * (last.x - next.x), 0.008 * (next.y - last.y));
    });
    for (const type of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(type, (event) => {
        pointers.delete(event.pointerId);
        if (stage.pull?.pointer === event.pointerId) stage.release(type === "pointerup");
      });
    }
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      stage.enlarge(Math.exp(-0.005 * event.deltaY));
    });
    canvas.addEventListener("dblclick", () => stage.resetView());
  }

  /** Whether an element uses the keys of a stage for itself. */
  function usesKey(element, key) {
    if (element.matches("select, input[type=text], input[type=number]")) return true;
    if (key === " ") return element.matches("button, input[type=checkbox]");
    return element.matches("input[type=range]");
  }

  /** Space plays, arrows move the time, Shift and arrows turn the legs, + and − change their size. */
  function listenToKeys(element, stage) {
    const turns = {
      ArrowLeft: [-0.1, 0],
      ArrowRight: [0.1, 0],
      ArrowUp: [0, 0.1],
      ArrowDown: [0, -0.1],
    };
    const actions = {
      " ": () => (stage.playing ? stage.pause() : stage.play()),
      ArrowLeft: () => stage.seek(stage.time - 0.1),
      ArrowRight: () => stage.seek(stage.time + 0.1),
      Home: () => stage.seek(0),
      End: () => stage.seek(stage.duration),
      "+": () => stage.enlarge(1.15),
      "-": () => stage.enlarge(1 / 1.15),
      0: () => stage.resetView(),
      Escape: () => stage.release(false),
      p: () => stage._bar.push.checkVisibility() && stage.onPush(null),
    };
    element.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      if (usesKey(event.target, event.key)) return;
      const turn = event.shiftKey ? turns[event.key] : undefined;
      const action = turn ? () => stage.turn(...turn) : actions[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    });
  }

  return { make, legFigure, playBar, legend, Trace, listenToGestures, listenToKeys };
})();
