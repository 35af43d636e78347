// The address of the page follows the values, so that reload, Back, undo and redo restore them.
"use strict";

const Addresses = (() => {
  /**
   * Writes the values into the address when they rest and no pointer is down, as a new entry of the
   * browser's history. So a drag is one entry.
   * `onChange` is called after each entry. In a frame or a notebook the history is that of the page
   * around the frame, and the address stays as it is.
   */
  class Trail {
    constructor(rest_ms, onChange) {
      Object.assign(this, { rest_ms, onChange, timer: 0, active: self === top });
      this.step = (this.active && history.state?.step) || 0;
      this.last = this.step;
      for (const type of ["pointerdown", "pointerup", "pointercancel"]) {
        addEventListener(type, () => {
          this.held = type === "pointerdown";
          if (!this.held && this.timer) this.note(this.fragment);
        });
      }
    }

    /** Write a fragment after a rest, unless the address has it. */
    note(fragment) {
      this.fragment = fragment;
      clearTimeout(this.timer);
      if (this.active) this.timer = setTimeout(() => this.held || this.write(fragment), this.rest_ms);
    }

    write(fragment) {
      this.timer = 0;
      if (location.hash.replace(/^#/, "") === fragment) return;
      this.step += 1;
      this.last = this.step;
      history.pushState({ step: this.step }, "", fragment ? `#${fragment}` : location.href.split("#")[0]);
      this.onChange();
    }

    /** Take the step of an entry to which the browser has gone. */
    arrive(state) {
      clearTimeout(this.timer);
      this.timer = 0;
      this.step = state?.step ?? 0;
      this.last = Math.max(this.last, this.step);
      this.onChange();
    }

    get canUndo() { return this.step > 0; }

    get canRedo() { return this.step < this.last; }
  }

  /** Whether keys in an element edit its text. */
  function editsText(element) {
    return element.matches("input[type=text], textarea");
  }

  /** -1 for the keys of undo, 1 for those of redo, else 0. */
  function directionOf(event) {
    const key = event.key.toLowerCase();
    if (!(event.ctrlKey || event.metaKey) || editsText(event.target)) return 0;
    if (key === "y") return 1;
    if (key !== "z") return 0;
    return event.shiftKey ? 1 : -1;
  }

  return { Trail, directionOf };
})();
