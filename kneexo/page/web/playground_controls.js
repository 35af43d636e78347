// The panel with switches and sliders of one set-up.
"use strict";

const Controls = (() => {
  const { element } = Curves;
  const STEPS = 500; // positions of a slider

  /** Position of a slider, 0…STEPS, for a value, linear or logarithmic. */
  function position(quantity, value) {
    const { low, high, scale } = quantity;
    const share = scale === "log"
      ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    return Math.round(STEPS * Math.min(1, Math.max(0, share)));
  }

  /** Value at a slider's position, rounded to three digits of the range. */
  function valueAt(quantity, at) {
    const { low, high, scale } = quantity;
    if (at <= 0) return low;
    if (at >= STEPS) return high;
    const { factor } = Setups.display(quantity);
    const share = at / STEPS;
    const value = scale === "log" ? low * (high / low) ** share : low + share * (high - low);
    const size = scale === "log" ? value : high - low;
    const unit = 10 ** (Math.floor(Math.log10(Math.abs(factor * size))) - 2);
    const rounded = Number((Math.round((factor * value) / unit) * unit).toPrecision(12));
    return Setups.clamped(quantity, rounded / factor);
  }

  /** Text of a value in the unit of the page, with all digits that matter. */
  function text(quantity, value) {
    const { factor } = Setups.display(quantity);
    return String(Number((factor * value).toPrecision(6)));
  }

  class Panel {
    /** `onChange(index)` is called after each change of set-up `index`. `now()` returns the time that the leg shows. */
    constructor(parent, data, state, onChange, now) {
      Object.assign(this, { parent, data, state, onChange, now, index: 0, opened: new Set() });
      this.build();
    }

    get setup() { return this.state.setups[this.index]; }

    get other() { return this.state.setups[1 - this.index]; }

    /** Build all controls again, after a switch has changed or the other set-up is chosen. */
    build() {
      const focused = document.activeElement?.id;
      this.rows = new Map();
      this.parent.dataset.setup = "ab"[this.index];
      this.hint = element("p", { id: "hint", "aria-hidden": "true" });
      this.parent.replaceChildren(this.head(), ...this.switches(), ...this.groups(), this.hint);
      if (focused && !document.activeElement?.id) document.getElementById(focused)?.focus();
      this.refresh();
    }

    head() {
      const bar = element("div", { class: "bar panel-head" });
      const title = element("h2", {}, "Change a value");
      const actions = element("span", { class: "actions" });
      actions.append(this.button("reset-all", "Reset all", () => this.reset()));
      bar.append(title, actions);
      if (!this.state.compare) return bar;
      const tabs = element("div", { class: "tabs", role: "group", "aria-label": "Set-up" });
      for (const index of [0, 1]) {
        const tab = this.button(`set-up-${"ab"[index]}`, `Set-up ${"AB"[index]}`, () => this.select(index));
        tab.className = `tab of-${"ab"[index]}`;
        tab.setAttribute("aria-pressed", String(index === this.index));
        tabs.append(tab);
      }
      actions.prepend(this.button("copy-a-b", this.index ? "Copy B to A" : "Copy A to B", () => this.copy()));
      bar.prepend(tabs);
      title.className = "unseen";
      return bar;
    }

    button(id, label, action) {
      const button = element("button", { type: "button", id }, label);
      button.addEventListener("click", action);
      return button;
    }

    select(index) {
      this.index = index;
      this.build();
    }

    reset() {
      const fresh = Setups.fresh(this.data, this.index);
      this.state.setups[this.index] = fresh;
      this.build();
      this.onChange(this.index);
    }

    copy() {
      this.state.setups[1 - this.index] = Setups.copied(this.setup);
      this.refresh();
      this.onChange(1 - this.index);
    }

    switches() {
      const { data, setup } = this;
      const all = (name) => [...Setups.choices(data, setup, name), ...Setups.missing(data, setup, name)];
      const lists = [
        ["scenario", "Scenario", data.scenarios.map((scenario, i) => [i, scenario.name])],
        ["controller", "Controller", names(all("controller"), Setups.CONTROLLER_NAMES)],
        ["load", "Load", names(all("load"), Setups.LOAD_NAMES)],
        ["reference", "Reference", names(Setups.references(data, setup), Setups.REFERENCE_NAMES)],
        ["protection", "Protection", Setups.modelOf(data, setup).faults ? Object.entries(Setups.PROTECTION_NAMES) : []],
        ["fault", "Throw a fault", Object.entries(Setups.faultNames(data, setup))],
      ];
      return lists.filter(([, , choices]) => choices.length > 1)
        .map(([name, title, choices]) => this.switch(name, title, choices));
    }

    switch(name, title, choices) {
      const { data, setup } = this;
      const field = element("fieldset", { class: `switch ${name}` });
      field.append(element("legend", {}, title));
      for (const [choice, text] of choices) {
        const id = `${name}-${choice}`;
        const input = element("input", { type: "radio", name, id });
        const refusal = Setups.missing(data, setup, name).includes(choice) ? "not on this page" : Setups.refusalOf(setup, name, choice);
        const label = element("label", { for: id, ...(refusal && { title: refusal }) }, text);
        input.disabled = Boolean(refusal);
        input.checked = this.setup[name] === choice;
        input.addEventListener("change", () => {
          Setups.choose(this.data, this.setup, name, choice);
          this.build();
          this.onChange(this.index);
        });
        field.append(input, label);
      }
      return field;
    }

    groups() {
      const quantities = Setups.quantitiesOf(this.data, this.setup);
      return this.data.groups.map((group) => {
        const inside = quantities.filter((q) => group.prefixes.some((prefix) => q.name.startsWith(prefix)));
        return inside.length ? this.group(group, inside.filter((q) => q.main), inside.filter((q) => !q.main)) : null;
      }).filter(Boolean);
    }

    group({ title }, main, rest) {
      const section = element("section", { class: "group", "aria-label": title });
      section.append(element("h3", {}, title), ...main.map((q) => this.row(q)));
      if (title === "Fault") section.append(this.button("throw-now", "Throw it at the time of the leg", () => this.throwNow(main)));
      if (!rest.length) return section;
      const more = element("details");
      more.open = this.opened.has(title) || !main.length;
      more.addEventListener("toggle", () => this.opened[more.open ? "add" : "delete"](title));
      more.append(element("summary", {}, `${rest.length} more ${rest.length > 1 ? "values" : "value"}`), ...rest.map((q) => this.row(q)));
      section.append(more);
      return section;
    }

    row(quantity) {
      const id = `q-${quantity.name}`;
      const { unit } = Setups.display(quantity);
      const row = element("div", { class: "row" });
      const label = element("label", { for: id, title: hint(quantity) }, quantity.label);
      const slider = element("input", {
        type: "range", id, min: 0, max: STEPS, step: 1, "aria-describedby": `${id}-hint` });
      const box = element("input", {
        type: "text", inputmode: "decimal", id: `${id}-value`, autocomplete: "off",
        "aria-label": `${quantity.label}${unit ? ` in ${unit}` : ""}` });
      const reset = this.button(`${id}-reset`, "↺", () => this.set(quantity, Setups.defaultOf(this.data, this.setup, quantity)));
      reset.setAttribute("aria-label", `Reset ${quantity.label}`);
      reset.className = "reset";
      const note = element("span", { class: "note", "aria-live": "off" });
      const described = element("span", { class: "unseen", id: `${id}-hint` }, hint(quantity));
      slider.addEventListener("input", () => this.slide(quantity, Number(slider.value)));
      box.addEventListener("change", () => this.type(quantity, box));
      row.append(label, slider, box, element("span", { class: "unit" }, unit), reset, note, described);
      let before; // a finger that scrolls the page sets the slider first
      slider.addEventListener("pointerdown", () => { before = Setups.valueOf(this.data, this.setup, quantity); });
      slider.addEventListener("pointercancel", () => this.set(quantity, before));
      for (const event of ["pointerenter", "focusin"]) row.addEventListener(event, () => this.tell(quantity));
      for (const event of ["pointerleave", "focusout"]) row.addEventListener(event, () => this.tell(null));
      this.rows.set(quantity, { row, slider, box, reset, note });
      return row;
    }

    /** Let the fault start at the time that the leg shows. */
    throwNow(quantities) {
      const start = quantities.find(({ name }) => name === "fault.start_s");
      this.set(start, this.now());
    }

    /** Show range and source of a quantity at the lower edge of the window. */
    tell(quantity) {
      this.hint.textContent = quantity ? `${quantity.label}: ${hint(quantity)}` : "";
    }

    type(quantity, box) {
      const number = Setups.parsed(box.value);
      const { factor } = Setups.display(quantity);
      const value = number === null ? null : number / factor;
      const slack = 1e-9 * (quantity.high - quantity.low);
      const inside = value !== null && value >= quantity.low - slack && value <= quantity.high + slack;
      box.setAttribute("aria-invalid", String(!inside));
      if (inside) this.set(quantity, value);
      else this.rows.get(quantity).note.textContent = `must be ${range(quantity)}`;
    }

    /** Set a rounded value. The slider keeps its exact position, so that each key press moves it. */
    slide(quantity, at) {
      this.set(quantity, valueAt(quantity, at));
      this.rows.get(quantity).slider.value = at;
    }

    set(quantity, value) {
      Setups.setValue(this.data, this.setup, quantity, value);
      this.refreshRow(quantity);
      this.onChange(this.index);
    }

    refresh() {
      for (const quantity of this.rows.keys()) this.refreshRow(quantity);
    }

    refreshRow(quantity) {
      const { row, slider, box, reset, note } = this.rows.get(quantity);
      const value = Setups.valueOf(this.data, this.setup, quantity);
      const { unit } = Setups.display(quantity);
      slider.value = position(quantity, value);
      slider.setAttribute("aria-valuetext", `${text(quantity, value)} ${unit}`);
      box.value = text(quantity, value);
      box.setAttribute("aria-invalid", "false");
      const changed = value !== Setups.defaultOf(this.data, this.setup, quantity);
      row.classList.toggle("changed", changed);
      reset.disabled = !changed;
      note.textContent = this.noteOf(quantity, value);
    }

    /** Return the value of the other set-up in a comparison, if the values differ. */
    noteOf(quantity, value) {
      if (!this.state.compare) return "";
      const same = Setups.quantitiesOf(this.data, this.other).find((q) => q.name === quantity.name);
      if (!same) return "";
      const there = Setups.valueOf(this.data, this.other, same);
      const name = "BA"[this.index];
      return there === value ? "" : `${name} has ${text(quantity, there)} ${Setups.display(quantity).unit}`;
    }
  }

  function names(choices, words) {
    return choices.map((choice) => [choice, words[choice] ?? choice]);
  }

  function range(quantity) {
    const { unit } = Setups.display(quantity);
    const { factor } = Setups.display(quantity);
    const [low, high] = [quantity.low, quantity.high].map((end) => Setups.shown(factor * end));
    return `${low} … ${high} ${unit}`.trim();
  }

  function hint(quantity) {
    return [range(quantity), quantity.help, quantity.source].filter(Boolean).join("; ");
  }

  return { Panel, position, text, valueAt };
})();
