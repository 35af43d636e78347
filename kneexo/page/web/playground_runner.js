// Requests to the workers of the page. A newer request replaces an older one, and the page never waits.
"use strict";

const Runner = (() => {
  /** A worker with the simulator. It answers a request with one message, a sweep and a long run with several. */
  class Crew {
    constructor(source, models) {
      this.worker = new Worker(source);
      this.waiting = new Map();
      this.count = 0;
      this.worker.addEventListener("message", (event) => this.hear(event.data));
      this.worker.addEventListener("error", (event) => this.fail(event.message));
      this.worker.postMessage({ id: 0, kind: "load", ...models });
    }

    hear(answer) {
      const request = this.waiting.get(answer.id);
      if (!request) return;
      if (answer.point || answer.unfinished) {
        request.onPart(answer);
        return;
      }
      this.waiting.delete(answer.id);
      request.onAnswer(answer);
    }

    fail(message) {
      const requests = [...this.waiting.values()];
      this.waiting.clear();
      for (const request of requests) request.onAnswer({ error: message || "the simulator stopped" });
    }

    ask(message, onAnswer, onPart = () => {}) {
      const id = ++this.count;
      this.waiting.set(id, { onAnswer, onPart });
      this.worker.postMessage({ id, ...message });
      return id;
    }

    /** End all work of these kinds for a set-up, and forget the requests. */
    cancel(setup, kinds, ids) {
      for (const id of ids) this.waiting.delete(id);
      this.worker.postMessage({ id: ++this.count, kind: "cancel", setup, kinds });
    }
  }

  /**
   * Runs of A and B. A newer request replaces the older one, but only after the older one has shown
   * something. So the curves follow a slider that never rests.
   */
  class Runs {
    constructor(crew, onRun) {
      Object.assign(this, { crew, onRun, present: [null, null], next: [null, null], isHeard: [true, true] });
    }

    request(index, message) {
      this.next[index] = message;
      if (this.isHeard[index]) this.send(index);
    }

    send(index) {
      const message = this.next[index];
      if (!message) return;
      this.next[index] = null;
      this.present[index] = message;
      this.isHeard[index] = false;
      const hear = (answer) => {
        if (this.present[index] !== message) return; // replaced
        this.isHeard[index] = true;
        this.onRun(index, answer, message);
        this.send(index);
      };
      this.crew.ask({ kind: "run", setup: index, ...message }, hear, hear);
    }
  }

  /** Margins and sweeps. They start when the values rest. A newer request replaces an older one. */
  class Analyses {
    constructor(crew, rest_ms, handlers) {
      Object.assign(this, { crew, rest_ms, handlers, timers: [0, 0], ids: [[], []] });
    }

    /** Request margins and sweep of a set-up. If `messages` is null, the set-up has neither. */
    request(index, messages) {
      clearTimeout(this.timers[index]);
      if (this.ids[index].length) this.crew.cancel(index, ["linear", "sweep"], this.ids[index]);
      this.ids[index] = [];
      this.handlers.onStart(index);
      if (messages) this.timers[index] = setTimeout(() => this.send(index, messages), this.rest_ms);
    }

    /** Ask for the margins, then the −3 dB frequency, then the points of the sweep. */
    send(index, { linear, sweep, frequencies }) {
      const { onLinear, onPoint, onSweep, onEnd } = this.handlers;
      const ask = (message, onAnswer) => {
        this.ids[index].push(this.crew.ask(message, onAnswer, ({ point }) => onPoint(index, point)));
      };
      ask({ kind: "linear", setup: index, ...linear }, (answer) => onLinear(index, answer));
      ask({ kind: "sweep", setup: index, ...sweep, frequencies: [] }, (answer) => {
        onSweep(index, answer);
        ask({ kind: "sweep", setup: index, ...sweep, frequencies }, () => onEnd(index));
      });
    }
  }

  return { Analyses, Crew, Runs };
})();
