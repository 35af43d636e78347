// Guided steps: what limits the speed of the knee. The numbers come from the runs.
"use strict";

const Tour = (() => {
  const { shown } = Setups;
  const DEG = 180 / Math.PI;
  const GEAR = "plant.pump.gear_ratio";
  const AMPLITUDE = "reference.amplitude_deg";
  const FREQUENCY = "reference.frequency_hz";
  const LAMBDA = "controller.lambda_per_s";

  const percent = (run) => shown(100 * Numbers.shareOf(run), 2);
  const follows = (run) => `The knee ${run.metrics.tracks ? "follows" : "does not follow"}`;
  const error = (run) => shown(run.metrics.largest_error_rad * DEG, 2);

  // `values(v)` returns the changed values of a step from the first values `v`.
  const STEPS = [
    { title: "The sine of the scenario", target: '[data-plot="angle"]', values: () => ({}),
      text: ({ run, value }) => `${follows(run)} the sine of ${shown(value(FREQUENCY))} Hz. The largest error is `
        + `${error(run)}°, and the motor is at its limit ${percent(run)} % of the time.` },
    { title: "A faster sine", target: '[data-plot="command"]', values: (v) => ({ [FREQUENCY]: 4 * v[FREQUENCY] }),
      text: ({ run, value }) => `At ${shown(value(FREQUENCY))} Hz the error is ${error(run)}°. The command is at its limit ${percent(run)} % of the time.`
        + (Numbers.shareOf(run) > 0.5
          ? " The rod moves out and in at its highest speed, so the sine becomes a triangle." : "") },
    { title: "A stronger controller?", target: '[data-plot="error"]',
      values: (v) => ({ [FREQUENCY]: 4 * v[FREQUENCY], [LAMBDA]: 2 * v[LAMBDA] }),
      text: ({ run, before, value }) => `λ is now ${shown(value(LAMBDA))} per second. `
        + `The error was ${before ? error(before) : "–"}° before, and is ${error(run)}° now. `
        + "No controller can command more than the motor's highest speed." },
    { title: "A smaller motion", target: '[data-plot="angle"]',
      values: (v) => ({ [FREQUENCY]: 4 * v[FREQUENCY], [AMPLITUDE]: v[AMPLITUDE] / 5 }),
      text: ({ run, value }) => `An amplitude of ${shown(value(AMPLITUDE))}° needs less speed. ${follows(run)} this motion. The error is `
        + `${error(run)}°, and the motor is at its limit ${percent(run)} % of the time.` },
    { title: "A smaller gear ratio", target: "#bode", values: (v) => ({ [FREQUENCY]: 4 * v[FREQUENCY], [GEAR]: v[GEAR] / 2 }),
      text: ({ sweep, first, value, start }) => {
        const [now, then] = [sweep?.minus_3_db_hz, first?.minus_3_db_hz];
        const speed = `A gear ratio of ${shown(value(GEAR))} gives the pump ${shown(start[GEAR] / value(GEAR), 3)} times the speed.`;
        if (!Number.isFinite(now)) return `${speed} The sweep is running.`;
        const ratio = Number.isFinite(then) ? `, ${shown(now / then, 3)} times the ${shown(then)} Hz of the first step` : "";
        return `${speed} The bandwidth is ${shown(now)} Hz${ratio}.`
          + (now / then > 1.5 ? " The speed of motor and pump limits this knee." : "");
      } },
  ];

  class Guide {
    /** `page` has the results and values of set-up A, begin(), apply(values), save(), restore() and choosePlot(name). */
    constructor(page) {
      Object.assign(this, { page, at: -1 });
      this.box = document.getElementById("tour");
      const on = (id, action) => document.getElementById(id).addEventListener("click", action);
      on("tour-start", () => this.start());
      on("tour-back", () => this.go(this.at - 1));
      on("tour-next", () => (this.at === STEPS.length - 1 ? this.close() : this.go(this.at + 1)));
      on("tour-close", () => {
        this.close();
        this.page.restore();
      });
    }

    start() {
      if (this.at < 0) this.page.save();
      this.saved = this.page.begin();
      this.answers = STEPS.map(() => ({})); // run and sweep of each step, once they are computed
      this.box.hidden = false;
      this.go(0);
    }

    go(index) {
      if (index < 0 || index >= STEPS.length) return;
      this.at = index;
      this.page.apply(STEPS[index].values(this.saved));
      document.getElementById("tour-count").textContent = `Step ${index + 1} of ${STEPS.length}`;
      document.getElementById("tour-title").textContent = STEPS[index].title;
      document.getElementById("tour-text").textContent = "";
      document.getElementById("tour-back").disabled = index === 0;
      document.getElementById("tour-next").textContent = index === STEPS.length - 1 ? "Finish" : "Next";
      this.point(STEPS[index].target);
      document.getElementById("tour-title").focus();
    }

    /** Write the sentences of the present step again. The page calls this after each result. */
    tell() {
      if (this.at < 0) return;
      const { run, sweep, fresh } = this.page.results();
      if (!run || !fresh) return;
      this.answers[this.at] = { run, sweep: sweep ?? this.answers[this.at].sweep };
      const before = this.answers[this.at - 1]?.run;
      const first = this.answers[0].sweep;
      const text = STEPS[this.at].text({ run, sweep, before, first, value: this.page.value, start: this.saved });
      document.getElementById("tour-text").textContent = text;
    }

    point(selector) {
      for (const marked of document.querySelectorAll(".pointed")) marked.classList.remove("pointed");
      const target = selector && document.querySelector(selector);
      if (!target) return;
      if (target.dataset.plot) this.page.choosePlot(target.dataset.plot);
      target.classList.add("pointed");
      target.scrollIntoView({ block: "nearest", behavior: Page.calm() ? "auto" : "smooth" });
    }

    close() {
      this.at = -1;
      this.box.hidden = true;
      this.point(null);
      document.getElementById("tour-start").focus();
    }
  }

  return { Guide, STEPS };
})();
