// Runs the worker of a page under Node. Each line of the input is a request of the page, or has a
// script to evaluate. Each line of the output is an answer.
"use strict";

const fs = require("node:fs");
const readline = require("node:readline");
const vm = require("node:vm");

const say = (answer) => process.stdout.write(`${JSON.stringify(answer, plain)}\n`);

let listener;
globalThis.self = {
  addEventListener: (_, listen) => (listener = listen),
  postMessage: (answer, buffers) => say(structuredClone(answer, { transfer: buffers })),
};

// JSON has no arrays of doubles, and no infinity.
function plain(_, value) {
  if (ArrayBuffer.isView(value)) return [...value];
  return typeof value === "number" && !Number.isFinite(value) ? `${value}` : value;
}

vm.runInThisContext(fs.readFileSync(process.argv[2], "utf8"));

readline.createInterface({ input: process.stdin }).on("line", async (line) => {
  const request = JSON.parse(line);
  if (request.script === undefined) listener({ data: request });
  else say({ id: request.id, value: await vm.runInThisContext(request.script) });
});
