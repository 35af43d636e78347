// Answers the requests of a page: load, run, linear, sweep and cancel. See Simulator, LinearLoop and
// SineSweep, which stand before this script in the worker.
"use strict";

(() => {
  const newest = new Map(); // kind and set-up: id of the newest request

  // Receive the waiting messages. Throw if a newer request replaces this one.
  async function pauseOf(place, id) {
    await new Promise((resolve) => {
      const { port1, port2 } = new MessageChannel();
      port1.onmessage = () => {
        port1.close();
        resolve();
      };
      port2.postMessage(null);
    });
    if (newest.get(place) !== id) throw Object.assign(new Error("cancelled"), { cancelled: true });
  }

  const answers = {
    load: (request) => (Simulator.load(request), {}),
    cancel: ({ id, setup, kinds }) => (kinds.forEach((kind) => newest.set(`${kind} ${setup}`, id)), {}),
    run: Simulator.run,
    linear: LinearLoop.linear,
    sweep: SineSweep.sweep,
  };

  const buffersOf = (answer) =>
    [answer, answer.columns ?? {}, answer.free ?? {}].flatMap(Object.values).filter(ArrayBuffer.isView).map((a) => a.buffer);

  const finite = (value) => (Number.isNaN(value) ? null : value);

  // Post an answer. A nan becomes null. Arrays are transferred, not copied.
  function post(id, answer) {
    const plain = Object.fromEntries(Object.entries(answer).map(([name, v]) => [name, finite(v)]));
    self.postMessage({ id, ...plain }, buffersOf(answer));
  }

  async function answerTo(request) {
    const { id, kind, setup = 0 } = request;
    const place = `${kind} ${setup}`;
    newest.set(place, id);
    const pause = () => pauseOf(place, id);
    try {
      if (!Object.hasOwn(answers, kind)) throw new Error(`kind ${kind} is unknown`);
      if (kind !== "load" && kind !== "cancel") await pause();
      post(id, await answers[kind](request, pause, (part) => post(id, part)));
    } catch (error) {
      post(id, error.cancelled ? { cancelled: true } : { error: error.message });
    }
  }

  self.addEventListener("message", ({ data }) => answerTo(data));
})();
