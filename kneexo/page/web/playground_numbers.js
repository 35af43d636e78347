// The numbers of the page, each with a verdict in words.
"use strict";

const Numbers = (() => {
  const { element } = Curves;
  const { shown } = Setups;
  const DEG = 180 / Math.PI;
  const LEAST_SHARE = 0.01; // of the rating: a smaller pressure, as of a knee without weight, tells nothing

  // Each verdict is [words, class]. The classes are good, fair, bad and plain.
  function ofError({ end, metrics }) {
    if (end) return ["the run ended early", "bad"];
    if (metrics.settling_time_s !== undefined) return metrics.tracks ? ["to within 2 % of the step", "good"] : ["does not settle", "bad"];
    return [`${metrics.tracks ? "follows" : "does not follow"} (bound ${shown(metrics.error_bound_rad * DEG)}°)`, metrics.tracks ? "good" : "bad"];
  }

  const hasStep = (result) => !isThrown(result) && result.run.metrics.settling_time_s !== undefined; // null if the knee does not settle

  const isPushed = ({ run }) => Boolean(run.metrics.push);

  function ofRecovery({ run, band_deg: band }) {
    if (run.metrics.push.recovery_time_s === null) return [`not back within ±${shown(band)}°`, "bad"];
    return [`from the start of the push until within ±${shown(band)}° of the run without it`, "good"];
  }

  function ofCycle({ period_s: period, lowest_pressure_pa: low, highest_pressure_pa: high }) {
    return [`hunts every ${shown(period)} s, ${shown(1e-5 * low, 2)} … ${shown(1e-5 * high, 2)} bar`, "fair"];
  }

  function ofShare({ metrics: { saturated_share: share }, limits }) {
    const words = share === 0 ? "never" : share > 0.5 ? "saturated most of the time" : share < 0.05 ? "seldom" : "the motor limits the knee";
    return [`${words}; the limit of the command is ${shown((limits.command_limit_rad_s * 30) / Math.PI, 4)} rpm`, share === 0 ? "good" : share < 0.05 ? "fair" : "bad"];
  }

  function ofBandwidth(result, frequency) {
    if (!result) return ["computing", "plain"];
    const hz = result.minus_3_db_hz;
    if (result.error || result.failure) return [result.error ?? result.failure, "plain"];
    if (!Number.isFinite(hz)) return ["no −3 dB point", "plain"];
    if (!frequency) return ["−3 dB at the sine's amplitude", "plain"];
    const ratio = hz / frequency;
    return ratio > 1
      ? [`−3 dB, ${shown(ratio, 2)} × the sine's frequency`, "good"]
      : [`−3 dB, below the sine's ${shown(frequency)} Hz`, "bad"];
  }

  function ofMargin(linear, value, [least, enough], words = () => null) {
    if (!linear) return ["computing", "plain"];
    if (linear.failure || linear.error) return [linear.failure ?? linear.error, "plain"];
    if (!linear.stable) return ["unstable", "bad"];
    if (value == null || value === Infinity) return ["no limit", "good"];
    if (value >= enough) return [words(value) ?? "large", "good"];
    return value >= least ? [words(value) ?? "sufficient", "fair"] : [words(value) ?? "too small", "bad"];
  }

  /** Return the part of the run to which the metrics of the interaction belong. */
  function ofPeriods({ metrics: { periods } }) {
    const time = periods ? `${periods} ${periods > 1 ? "periods" : "period"} after the first` : "whole run";
    return [`of the wearer, ${time}`, "plain"];
  }

  /** Which part of a run a number of an unfinished run belongs to. */
  function ofPart({ part_s: part, duration_s: duration }) {
    return [part === null ? "computing" : `first ${shown(part, 2)} s of ${shown(duration)} s`, "plain"];
  }

  function ofPressure(run) {
    const peak = run.metrics.peak_pressure_pa;
    const rating = run.limits.pressure_rating_pa;
    const share = peak / rating;
    const { relief_share: relief } = run.metrics;
    const valves = relief > 0 ? `; relief valves open for ${shown(100 * relief, 2)} % of the run` : "";
    const text = `${shown(100 * share, 2)} % of the rating, ${shown(rating * 1e-5)} bar${valves}`;
    return [text, relief > 0 ? "bad" : share <= 0.8 ? "good" : share <= 1 ? "fair" : "bad"];
  }

  function margin(linear, name, factor) {
    if (!linear || !linear.stable) return "–";
    const value = linear[name];
    return value == null || value === Infinity ? "∞" : shown(factor * value);
  }

  const decibels = (gain) => `${shown(20 * Math.log10(gain), 2)} dB`;

  /** The margins of the loop in one line, beside a fault or a push, for which they do not hold. */
  function ofLoop({ linear }) {
    const [phase, gain, delay] = [["phase_margin_deg", 1], ["gain_margin", 1], ["delay_margin_s", 1e3]].map((one) => margin(linear, ...one));
    return [`without fault or push; margins ${phase}°, ${gain}, ${delay} ms`, "plain"];
  }

  const isThrown = ({ run }) => Boolean(run.fault || run.metrics.protection?.stop);

  const isPlain = (result) => !isThrown(result) && !isPushed(result);

  const hasPressure = ({ run }) => run.metrics.peak_pressure_pa > LEAST_SHARE * run.limits.pressure_rating_pa;

  /** Milliseconds from the start of the fault to a time of the run, or nan. */
  function sinceFault({ fault }, time_s) {
    return fault && time_s != null && time_s >= fault.start_s - 1e-9 ? 1e3 * (time_s - fault.start_s) : NaN;
  }

  function ofDetection({ fault, faults, isProtected, metrics: { protection: { stop } } }) {
    if (!isProtected) return ["no protection", "plain"];
    if (!stop) return ["no detector has tripped", "bad"];
    const text = `by ${faults.reasons[stop.reason]} at ${shown(stop.time_s, 5)} s`;
    return Number.isFinite(sinceFault({ fault }, stop.time_s)) ? [text, "good"] : [`false alarm ${text}`, "bad"];
  }

  function ofSafety({ isProtected, faults, metrics: { protection: { stop, safe_time_s: time } } }) {
    if (!isProtected) return ["no protection", "plain"];
    if (time !== null) return [faults.safe, "good"];
    return [stop ? "not within the run" : "the motor is not stopped", "bad"];
  }

  /** The part of a run for which the largest values count. */
  function ofReach({ metrics: { protection: { stop, fault_s, safe_time_s: safe_s } } }) {
    return [`largest from the ${stop?.time_s === fault_s ? "stop" : "fault"} on${safe_s === null ? ", until the end" : ""}`, "plain"];
  }

  // If a row has `wearer`, it is only for set-ups with a wearer (true) or without a wearer (false).
  // If a row has `when`, it is only for results for which this function is true. A row of an `analysis`
  // does not have its number from the run.
  const ROWS = [
    { name: "rms-torque", label: "Torque, rms", unit: "N·m", wearer: true,
      value: ({ run }) => shown(run.metrics.rms_torque_n_m), word: ({ run }) => ofPeriods(run) },
    { name: "peak-torque", label: "Largest torque", unit: "N·m", wearer: true,
      value: ({ run }) => shown(run.metrics.peak_torque_n_m), word: ({ run }) => ofPeriods(run) },
    { name: "power-from-wearer", label: "Wearer gives", unit: "W", wearer: true,
      value: ({ run }) => shown(run.metrics.power_from_wearer_w), word: () => ["mean power", "plain"] },
    { name: "power-to-wearer", label: "Wearer gets", unit: "W", wearer: true,
      value: ({ run }) => shown(run.metrics.power_to_wearer_w), word: () => ["mean power", "plain"] },
    { name: "detected", when: isThrown, label: "Detected after", unit: "ms",
      value: ({ run }) => shown(sinceFault(run, run.metrics.protection.stop?.time_s), 4), word: ({ run }) => ofDetection(run) },
    { name: "safe", when: isThrown, label: "Safe after", unit: "ms",
      value: ({ run }) => shown(sinceFault(run, run.metrics.protection.safe_time_s), 4), word: ({ run }) => ofSafety(run) },
    { name: "fault-error", when: isThrown, label: "Error until safe", unit: "deg",
      value: ({ run }) => shown(run.metrics.protection.largest_error_rad * DEG), word: ({ run }) => ofReach(run) },
    { name: "fault-torque", when: isThrown, label: "Torque until safe", unit: "N·m",
      value: ({ run }) => shown(run.metrics.protection.torque_n_m), word: ({ run }) => ofReach(run) },
    { name: "settling", wearer: false, when: hasStep, label: "Settling time", unit: "s",
      value: ({ run }) => shown(run.metrics.settling_time_s), word: ({ run }) => ofError(run) },
    { name: "rise", wearer: false, when: hasStep, label: "Rise time", unit: "s",
      value: ({ run }) => shown(run.metrics.rise_time_s), word: () => ["from 10 to 90 % of the step", "plain"] },
    { name: "overshoot", wearer: false, when: hasStep, label: "Overshoot", unit: "%",
      value: ({ run }) => shown(run.metrics.overshoot_percent), word: () => ["of the step", "plain"] },
    { name: "final-error", wearer: false, when: hasStep, label: "Final error", unit: "deg",
      value: ({ run }) => shown(run.metrics.final_error_rad * DEG, 2), word: () => ["at the end of the run", "plain"] },
    { name: "cycle", when: ({ run }) => Boolean(run.metrics.limit_cycle), label: "Motion at rest", unit: "deg",
      value: ({ run }) => `±${shown(run.metrics.limit_cycle.amplitude_rad * DEG, 2)}`,
      word: ({ run }) => ofCycle(run.metrics.limit_cycle) },
    { name: "error", wearer: false, when: (result) => !hasStep(result) && !isThrown(result), label: "Largest error", unit: "deg",
      value: ({ run }) => shown(run.metrics.largest_error_rad * DEG), word: ({ run }) => ofError(run) },
    { name: "deviation", wearer: false, when: isPushed, label: "Push deviation", unit: "deg",
      value: ({ run }) => shown(run.metrics.push.largest_deviation_rad * DEG),
      word: () => ["largest, from the run without a push", "plain"] },
    { name: "recovery", wearer: false, when: isPushed, label: "Back after", unit: "s",
      value: ({ run }) => shown(run.metrics.push.recovery_time_s), word: ofRecovery },
    { name: "pressure", when: hasPressure, label: "Peak pressure", unit: "bar",
      value: ({ run }) => shown(1e-5 * run.metrics.peak_pressure_pa), word: ({ run }) => ofPressure(run) },
    { name: "saturated", label: "Time at the limit", unit: "%",
      value: ({ run }) => shown(100 * run.metrics.saturated_share), word: ({ run }) => ofShare(run) },
    { name: "bandwidth", analysis: true, wearer: false, when: isPlain, label: "Bandwidth", unit: "Hz",
      value: ({ sweep }) => shown(sweep?.minus_3_db_hz),
      word: ({ sweep, frequency }) => ofBandwidth(sweep, frequency) },
    { name: "phase", analysis: true, wearer: false, when: isPlain, label: "Phase margin", unit: "deg",
      value: ({ linear }) => margin(linear, "phase_margin_deg", 1),
      word: ({ linear, margins }) => ofMargin(linear, linear?.phase_margin_deg, margins.phase_deg) },
    { name: "gain", analysis: true, wearer: false, when: isPlain, label: "Gain margin", unit: "",
      value: ({ linear }) => margin(linear, "gain_margin", 1),
      word: ({ linear, margins }) => ofMargin(linear, linear?.gain_margin, margins.gain, decibels) },
    { name: "delay", analysis: true, wearer: false, when: isPlain, label: "Delay margin", unit: "ms",
      value: ({ linear }) => margin(linear, "delay_margin_s", 1e3),
      word: ({ linear, margins, sample_time_s: sample }) => ofMargin(linear, linear?.delay_margin_s,
        margins.delay_samples.map((count) => count * sample), (value) => `${Math.floor(value / sample)} samples`) },
    { name: "linear", analysis: true, wearer: false, when: (result) => !isPlain(result), label: "Bandwidth", unit: "Hz",
      value: ({ sweep }) => shown(sweep?.minus_3_db_hz), word: ofLoop },
  ];

  // Rows that a phone shows beside the sliders.
  const BRIEF = ["rms-torque", "settling", "overshoot", "error", "recovery", "detected", "safe", "fault-torque", "saturated", "phase"];

  /** Cards of numbers. Each card has a value and a verdict for each set-up. `brief` shows a few of them. */
  class Board {
    constructor(parent, brief) {
      this.brief = brief;
      this.cells = ROWS.map((row) => {
        const card = element("div", { class: "card", "data-number": row.name, hidden: "" });
        const values = [0, 1].map((index) => {
          const line = element("p", { class: `value of-${"ab"[index]}` });
          const word = element("p", { class: "word" });
          card.append(line, word);
          return { line, word };
        });
        const pinned = element("p", { class: "pinned", hidden: "" });
        card.prepend(element("h3", {}, row.label));
        card.append(pinned);
        parent.append(card);
        return { card, row, values, pinned };
      });
    }

    /**
     * Show the results of the set-ups: objects with run, linear, sweep, frequency, sample_time_s.
     * A pinned result is a line with its number, and with the difference of A from it. While a run is
     * unfinished, the same cards stay.
     */
    show(results, pinned = null) {
      const unfinished = results.some(({ run }) => run.unfinished) && this.cells.some(({ card }) => !card.hidden);
      for (const { card, row, values, pinned: line } of this.cells) {
        const has = (result) => Boolean(result?.run) && (row.wearer ?? result.hasWearer) === result.hasWearer
          && (row.when?.(result) ?? true);
        if (!unfinished) card.hidden = !results.some(has);
        line.hidden = !has(pinned);
        if (has(pinned)) line.textContent = `pinned ${row.value(pinned)}${has(results[0]) ? changeFrom(row, pinned, results[0]) : ""}`;
        values.forEach(({ line, word }, index) => {
          const result = results[index];
          if (!unfinished || !result) line.hidden = word.hidden = !has(result);
          if (line.hidden) return;
          const isPart = Boolean(result.run.unfinished) && !row.analysis;
          const [text, kind] = isPart ? ofPart(result.run) : row.word(result);
          const name = results.length > 1 ? element("span", { class: "name" }, "AB"[index]) : "";
          line.replaceChildren(name, element("span", { class: "number" }, has(result) ? row.value(result) : "–"),
            element("span", { class: "unit" }, row.unit));
          line.classList.toggle("part", isPart);
          word.textContent = text;
          word.dataset.kind = kind;
        });
      }
      this.brief.replaceChildren(...this.cells.filter(({ card, row }) => !card.hidden && BRIEF.includes(row.name)).map(inBrief));
    }
  }

  /** A card on one line: label, and number, unit and mark of each set-up. */
  function inBrief({ row, values }) {
    const line = element("span", {}, `${row.label} `);
    for (const { line: value, word } of values.filter((one) => !one.line.hidden)) {
      const mark = element("span", { class: "word", "data-kind": word.dataset.kind });
      line.append(...[...value.children].map((child) => child.cloneNode(true)), mark);
    }
    return line;
  }

  /** The difference of the numbers that two results show, in parentheses, or an empty text. */
  function changeFrom(row, pinned, result) {
    const [before, now] = [pinned, result].map((one) => Setups.parsed(row.value(one).replace("±", "")));
    if (before === null || now === null) return "";
    return now === before ? " (same)" : ` (${now < before ? "" : "+"}${shown(now - before)})`;
  }

  // The plot and the card of a number of a sentence.
  const LINKS = {
    max_error_deg: ["error", "error"], settling_time_s: ["angle", "settling"], rise_time_s: ["angle", "rise"],
    overshoot_percent: ["angle", "overshoot"], final_error_deg: ["error", "final-error"], amplitude_deg: ["angle", "cycle"],
    largest_deviation_deg: ["angle", "deviation"], bandwidth_hz: ["bode", "bandwidth"],
    rms_torque_n_m: ["torque", "rms-torque"], peak_torque_n_m: ["torque", "peak-torque"],
    stop_ms: ["state", "detected"], safe_ms: ["state", "safe"], turn_deg: ["angle", "fault-error"], torque_n_m: ["kneeTorque", "fault-torque"],
  };

  /** A clause of kneexo/analysis/tracking/clauses.py with its numbers, as texts and [number and unit, plot, card]. */
  function filled(clause, numbers) {
    return clause.split(/(\{\w+:\.\dg\} ?[^\s.,;]+)/).map((part) => {
      const [, name, digits, unit] = part.match(/^\{(\w+):\.(\d)g\}(.+)/) ?? [];
      if (!name) return part.replace("{cause}", numbers.cause);
      const text = shown(numbers[name], digits) + unit;
      return LINKS[name] ? [text, ...LINKS[name]] : text;
    });
  }

  /** What a run shows first, in the clauses that kneexo simulate prints; see `filled`. */
  function sentenceOf(result) {
    const { run, sweep, clauses, hasWearer } = result;
    const { limit_cycle: cycle, push, protection, tracks, ...metrics } = run.metrics;
    if (run.end) return [`${endOf(run)}.`];
    const { stop, safe_time_s: safe_s, fault_s } = protection ?? {};
    const [stop_ms, safe_ms] = [stop?.time_s, safe_s].map((time_s) => 1e3 * (time_s - fault_s));
    const angles = { max_error: metrics.largest_error_rad, error_bound: metrics.error_bound_rad, step: Math.abs(metrics.step_rad),
      final_error: metrics.final_error_rad, amplitude: cycle?.amplitude_rad, largest_deviation: push?.largest_deviation_rad, turn: protection?.turn_rad };
    const numbers = { ...metrics, ...cycle, ...protection, ...stop, stop_ms, safe_ms, cause: run.faults?.stopped_by[stop?.reason], bandwidth_hz: sweep?.minus_3_db_hz,
      ...Object.fromEntries(Object.entries(angles).map(([name, angle]) => [`${name}_deg`, angle * DEG])) };
    const after = stop_ms > 0 ? " after the fault" : "";
    const first = hasWearer ? ["wearer"]
      : stop ? ["stopped", after && "after the fault", safe_s === null ? "not safe" : `safe${after}`, "until safe"]
        : metrics.settling_time_s === undefined ? [tracks ? "tracks" : "does not track"]
          : [tracks ? "settles" : "does not settle", metrics.rise_time_s === null ? "does not rise" : "rises", "overshoots"];
    const sentences = [first, cycle && ["hunts"], push && ["push"], numbers.bandwidth_hz && !isThrown(result) && ["bandwidth"]];
    return sentences.filter(Boolean).flatMap((names, k) =>
      [k ? " " : "", ...names.filter(Boolean).flatMap((name) => filled(clauses[name], numbers)), "."]);
  }

  const endOf = ({ end }) => `The run ended at ${shown(end.time_s)} s: ${end.reason}`;

  /** The sentences of the set-ups as one text. */
  function sentence(results) {
    const texts = results.map((result) => sentenceOf(result).map((part) => (typeof part === "string" ? part : part[0])).join(""));
    return texts.map((text, index) => (results.length > 1 ? `${"AB"[index]}: ${text}` : text)).join(" ");
  }

  /** Write the sentences, in which each number is a button that shows its curve, or its card. */
  function writeSentences(parent, results) {
    const text = sentence(results);
    if (parent.dataset.text === text) return; // the focus stays
    parent.dataset.text = text;
    parent.replaceChildren(...results.map((result, index) => {
      const line = element("p", { class: `of-${"ab"[index]}` }, results.length > 1 ? `${"AB"[index]}: ` : "");
      for (const part of sentenceOf(result)) line.append(typeof part === "string" ? part : linked(part));
      return line;
    }));
  }

  function linked([text, plot, card]) {
    const button = element("button", { type: "button", class: "number" }, text);
    button.addEventListener("click", () => {
      const curve = document.querySelector(plot === "bode" ? "#bode" : `[data-plot="${plot}"]:not([hidden])`);
      const shownAt = curve?.checkVisibility() ? curve : document.querySelector(`[data-number="${card}"]:not([hidden])`) ?? document.getElementById("numbers");
      shownAt.scrollIntoView({ block: "nearest" });
      shownAt.animate([{ background: "#ffb00066" }, {}], 1500);
    });
    return button;
  }

  return { Board, endOf, sentence, writeSentences };
})();
