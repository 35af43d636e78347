"use strict";

/*
 * `new Stage(element, { legs, trace })` shows legs that move as in their runs. stage_leg in
 * kneexo/view/stage.py makes the data of the legs. `element` dispatches "stagetime" for each new time.
 */
const Stage = (() => {
  const HOME = { azimuth: 0.42, elevation: 0.12, zoom: 1 };
  const SIDE = { azimuth: 0, elevation: 0, zoom: 1 };
  const LONGEST_FRAME_MS = 45;
  const QUICK_FRAME_MS = 8; // such frames delay nothing
  const SMALL_PIXELS = 120_000; // a picture of this size is quick to draw
  const LEAST_SHARPNESS = 0.5;
  const MANY_LEGS = 3;
  const PAPER_PX = 600;
  const SHANK_M = [0.05, 0.46, 0.09]; // where a pointer grabs the shank: from, to, and half its width

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  class Stage {
    /**
     * Without `trace` there is no plot of the error, and with `flat` no WebGL. Without `playing` the
     * stage stands still until the user starts it. A leg with `canPush`, the torque in N·m of an arrow that is a
     * quarter turn, can be pushed: `onPush(index, torque)` gets the torque in N·m of a drag on its shank.
     */
    constructor(element, { legs, trace = true, flat = false, playing = true, onPush = null }) {
      this.element = element;
      this.legs = legs.map((data) => new StageModel.Leg(data));
      this.onPush = onPush;
      this.pull = null; // the push that the user draws: index of the leg, torque in N·m, and a pointer
      this._places = [];
      this.orbit = { ...HOME };
      this.time = 0;
      this.part = null;
      this.speed = 1;
      this.loop = true;
      this.playing = false;
      this._sharpness = 1;
      this._frame_ms = 0; // time that the last frame took
      this._restUntil = 0;
      this._hasPlayed = !playing;
      this._removed = new AbortController();
      this._build(trace);
      this._choose(flat);
      this._listen();
      this._update();
    }

    /** Numbers from the text that `pack` in kneexo/view/stage.py returns. */
    static unpack(text) {
      return StageModel.unpack(text);
    }

    /** End of the longest run in s. */
    get duration() {
      return Math.max(...this.legs.map((leg) => leg.end));
    }

    /**
     * Show a run {time, angle, reference, pressure} in s, rad, rad, Pa. A run with a wearer also has
     * the angle `wearer` in rad and the torque `torque` in N·m. For null the leg has no run.
     */
    setRun(index, run) {
      this.legs[index].run = run;
      this.time = Math.min(this.time, this.duration);
      this._trace?.show();
      this._explain();
      this._update();
      if (run && !this._hasPlayed && !matchMedia("(prefers-reduced-motion: reduce)").matches) {
        this.play();
      }
    }

    /** Play a part [low, high] in s of the runs alone, or for null the whole runs at speed 1. */
    showPart(part, speed = part ? this.speed : 1) {
      if (String(part) === String(this.part)) return;
      Object.assign(this, { part, speed });
      if (part && (this.time < part[0] || this.time > part[1])) this.time = part[0];
      this._bar.speed.value = speed;
      this._bar.repeated.textContent = part ? " Repeat this part" : " Repeat";
      this._update();
    }

    /** Show or hide the button that pushes. */
    showPush(isShown) {
      this._bar.push.hidden = !isShown;
    }

    setName(index, name) {
      this.legs[index].name = name;
      this._trace?.show();
      this._update();
    }

    play() {
      if (this.duration === 0) return;
      const [low, high] = this._played();
      if (!this.loop && this.time >= high) this.time = low;
      this._hasPlayed = true;
      this.playing = true;
      this._last = null;
      this._updateNow();
    }

    pause() {
      this.playing = false;
      this._updateNow();
    }

    seek(time) {
      this.time = clamp(time, 0, this.duration);
      this._updateNow();
    }

    /**
     * Draw nothing for a time in ms, if frames are so slow that other work on the page would wait. An
     * action of the user on the stage ends the rest.
     */
    rest(duration_ms) {
      if (this._frame_ms > QUICK_FRAME_MS) this._restUntil = performance.now() + duration_ms;
    }

    turn(azimuth, elevation) {
      this.orbit.azimuth += azimuth;
      this.orbit.elevation = clamp(this.orbit.elevation + elevation, -0.5, 1.4);
      this._updateNow();
    }

    /** The place of a pointer on a leg in the plane of the knee: angle in rad, and whether it is on the shank. */
    _placeOf(index, { offsetX, offsetY, target }) {
      const leg = this.legs[index];
      const [x, z, turn] = leg.pose("shank", leg.at(this.time).angle);
      const place = this._places[index];
      const pixels = target.width / target.clientWidth;
      const [[left, top], along, up] = [place(x, z), place(x + 0.1, z), place(x, z + 0.1)];
      const [a, b, c, d] = [along[0] - left, along[1] - top, up[0] - left, up[1] - top];
      const [right, down] = [offsetX * pixels - left, offsetY * pixels - top];
      const [u, v] = [(d * right - c * down), (a * down - b * right)].map((n) => (0.1 * n) / (a * d - b * c));
      const [ahead, aside] = [u * Math.cos(turn) + v * Math.sin(turn), v * Math.cos(turn) - u * Math.sin(turn)];
      return { angle: Math.atan2(aside, ahead), isOnShank: ahead > SHANK_M[0] && ahead < SHANK_M[1] && Math.abs(aside) < SHANK_M[2] };
    }

    /** Begin a push with a pointer on the shank. Return whether there is one. */
    grab(index, event) {
      if (!this.onPush || !this.legs[index].canPush || !this._places[index]) return false;
      const { angle, isOnShank } = this._placeOf(index, event);
      if (!isOnShank) return false;
      this.pause();
      this.pull = { index, torque: 0, pointer: event.pointerId, angle };
      return true;
    }

    /** Draw the push whose arrow ends at the pointer. */
    drag(event) {
      const { index, angle } = this.pull;
      const most = this.legs[index].canPush;
      this.pull.torque = Math.round(clamp((-2 / Math.PI) * (this._placeOf(index, event).angle - angle), -1, 1) * most);
      this._updateNow();
    }

    /** End the push, and make it unless the user takes it back. */
    release(isPushed) {
      const { pull } = this;
      this.pull = null;
      this._updateNow();
      if (pull && isPushed && pull.torque) this.onPush(pull.index, pull.torque);
    }

    enlarge(factor) {
      this.orbit.zoom = clamp(this.orbit.zoom * factor, 0.5, 8);
      this._updateNow();
    }

    resetView() {
      this.orbit = { ...HOME };
      this._updateNow();
    }

    /** Leave the page, and give the WebGL context back. */
    remove() {
      this._removed.abort();
      this.pause();
      this.element.remove();
      this._drawing.renderer?.forceContextLoss();
    }

    _build(trace) {
      const { element, legs } = this;
      this._figures = legs.map(() => StageElements.legFigure());
      const grid = StageElements.make("div", { className: "stage-legs" });
      if (legs.length > 1) grid.classList.add(legs.length > MANY_LEGS ? "many" : "two");
      grid.append(...this._figures.map((figure) => figure.element));
      this._bar = StageElements.playBar(this);
      this._trace = trace ? new StageElements.Trace(this) : null;
      element.classList.add("stage");
      element.append(grid, this._bar.element);
      if (trace) element.append(this._trace.element);
      this._explain();
    }

    /** Write the legend. Its arrow has the scale of the present runs. */
    _explain() {
      const quarterTurn = StageArrow.scaleOf(this.legs);
      if (quarterTurn === this._quarterTurn) return;
      this._quarterTurn = quarterTurn;
      const legend = StageElements.legend(this.legs, this._quarterTurn);
      if (this._legend) this._legend.replaceWith(legend);
      else this.element.append(legend);
      this._legend = legend;
    }

    /** Draw in three dimensions, or from the side if the browser has no WebGL. */
    _choose(flat) {
      this._drawing = flat ? new StageFlat(this.legs) : StageSolid.of(this.legs) ?? this._flatInstead();
      this._drawing.renderer?.domElement.addEventListener("webglcontextlost", () => {
        if (this._removed.signal.aborted) return;
        this._drawing = this._flatInstead();
        this._update();
      });
    }

    /** The drawing from the side, with a line that says why. */
    _flatInstead() {
      const textContent = "This browser has no WebGL, so the view shows the leg from the side only.";
      this.element.append(StageElements.make("p", { className: "stage-note", textContent }));
      return new StageFlat(this.legs);
    }

    _listen() {
      const { signal } = this._removed;
      StageElements.listenToKeys(this.element, this);
      this._figures.forEach(({ whole }, index) => StageElements.listenToGestures(whole, this, index));
      this._visible = new Set();
      const seen = new IntersectionObserver((entries) => {
        for (const { target, isIntersecting } of entries) {
          if (isIntersecting) this._visible.add(target);
          else this._visible.delete(target);
        }
        this._update();
      });
      for (const { element } of this._figures) seen.observe(element);
      new ResizeObserver(() => {
        this._trace?.resize();
        this._update();
      }).observe(this.element);
      window.addEventListener("beforeprint", () => {
        this._trace?.resize(PAPER_PX);
        this._draw(true);
      }, { signal });
      window.addEventListener("afterprint", () => this._trace?.resize(), { signal });
    }

    /** Draw at the next frame of the browser after the rest. */
    _update() {
      this._request ??= requestAnimationFrame((now) => this._frame(now));
    }

    _updateNow() {
      this._restUntil = 0;
      this._update();
    }

    _frame(now) {
      if (this._removed.signal.aborted) return;
      this._request = null;
      const rest = this._restUntil - performance.now();
      if (rest > 0) {
        clearTimeout(this._wake);
        this._wake = setTimeout(() => this._update(), rest);
        return;
      }
      if (this.playing) this._advance(now);
      const start = performance.now();
      this._draw(false);
      this._frame_ms = performance.now() - start;
      this._adapt(this._frame_ms);
      if (this.playing) this.rest(this._frame_ms); // half of the time is for the rest of the page
      if (this._announcedTime !== this.time) {
        this._announcedTime = this.time;
        this.element.dispatchEvent(new CustomEvent("stagetime", { detail: this.time }));
      }
      if (this.playing) this._update();
    }

    _advance(now) {
      const passed = this._last === null ? 0 : Math.min((now - this._last) / 1000, 0.25);
      this._last = now;
      const [low, high] = this._played();
      this.time += this.speed * passed;
      if (this.time < high) return;
      if (this.loop) this.time = low + ((this.time - high) % (high - low));
      else {
        this.time = high;
        this.playing = false;
      }
    }

    /** The times between which the legs play: those of the part, unless the user has gone to a time behind the part. */
    _played() {
      const [low, high] = this.part ?? [0, this.duration];
      return this.time <= high && low < this.duration ? [low, Math.min(high, this.duration)] : [0, this.duration];
    }

    /** Reduce the pixels while frames take too long. A still picture has all pixels. */
    _adapt(passed) {
      if (!this.playing) return;
      if (passed > LONGEST_FRAME_MS) {
        this._sharpness = Math.max(LEAST_SHARPNESS, 0.85 * this._sharpness);
      } else if (passed < 0.4 * LONGEST_FRAME_MS) {
        this._sharpness = Math.min(1, 1.1 * this._sharpness);
      }
    }

    _draw(all) {
      this._count = (this._count ?? 0) + 1;
      this._figures.forEach((figure, index) => {
        const leg = this.legs[index];
        this._drawing.pose(index, leg.at(this.time));
        if (all || this._visible.has(figure.element) || !figure.isDrawn) {
          figure.isDrawn = figure.whole.clientWidth > 0;
          this._paint(index, figure.whole, this.orbit, false);
          // The enlarged linkage may follow at half the rate where frames are slow.
          if (all || !this.playing || this._sharpness > 0.9 || this._count % 2 === 0) {
            this._paint(index, figure.joint, SIDE, true);
          }
        }
        this._write(figure, leg);
      });
      this._showTime();
      this._trace?.move();
    }

    _paint(index, canvas, orbit, onlyLinkage) {
      const { clientWidth: width, clientHeight: height } = canvas;
      if (width === 0 || height === 0) return;
      const still = Math.max(devicePixelRatio, this._drawing.stillPixels);
      const moving = this._sharpness * devicePixelRatio;
      const enough = Math.min(Math.sqrt(SMALL_PIXELS / (width * height)), devicePixelRatio);
      const pixels = Math.min(this.playing ? Math.max(moving, enough) : still, 2);
      const [columns, rows] = [Math.round(width * pixels), Math.round(height * pixels)];
      if (canvas.width !== columns || canvas.height !== rows) {
        Object.assign(canvas, { width: columns, height: rows });
      }
      const place = this._drawing.draw(index, canvas, orbit, onlyLinkage);
      const leg = this.legs[index];
      if (onlyLinkage) return;
      this._places[index] = place;
      const { torque: worn, angle } = leg.at(this.time);
      const torque = worn ?? (this.pull?.index === index ? this.pull.torque : leg.pushAt(this.time));
      const scale = worn === undefined ? leg.canPush : this._quarterTurn;
      if (torque) StageArrow.draw(canvas.getContext("2d"), leg.pose("shank", angle), torque, scale, place, columns / width);
    }

    _write(figure, leg) {
      const texts = StageModel.readout(leg, this.time);
      if (figure.name.textContent !== leg.name) figure.name.textContent = leg.name;
      for (const [name, element] of Object.entries(figure.values)) {
        element.parentElement.hidden = !(name in texts);
        element.textContent = leg.run ? texts[name] : "–";
      }
    }

    _showTime() {
      const { play, slider, clock } = this._bar;
      play.textContent = this.playing ? "❚❚ Pause" : "▶ Play";
      slider.max = this.duration;
      slider.value = this.time;
      clock.textContent = this.duration === 0 ? "computing …" : `${this.time.toFixed(2)} of ${this.duration.toFixed(1)} s`;
      slider.setAttribute("aria-valuetext", clock.textContent);
    }
  }

  return Stage;
})();
