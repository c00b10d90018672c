"use strict";
// Answers the newest request; what is asked meanwhile waits until the first of an answer is told.

const machine = {};
let newest = null, busy = false;

const breath = () => new Promise(resolve => {
  const { port1, port2 } = new MessageChannel();
  port1.onmessage = resolve;
  port2.postMessage(0);
});

const work = async () => {
  busy = true;
  while (newest) {
    const { id, ...asked } = newest;
    machine.note = note => postMessage({ id, note });
    newest = null;
    let told = false, rested = performance.now();
    const began = rested;
    try {
      for (const stage of answer(asked, machine.system)) {
        if (stage) {
          for (const figure of Object.values(stage.figures ?? {})) figure.text ??= text(figure);
          postMessage({ id, ...stage, took: performance.now() - began });
          told = true;
        }
        if (!stage && performance.now() - rested < 15) continue;
        await breath();
        rested = performance.now();
        if (newest && told) break;
      }
    } catch (error) {
      if (!(error instanceof Failure)) throw error;
      postMessage({ id, failure: error.message, done: true });
    }
  }
  busy = false;
};

onmessage = ({ data }) => {
  if (data.modules) {
    const modules = Object.fromEntries(Object.entries(data.modules).map(([part, bytes]) => [part, new WebAssembly.Module(bytes)]));
    Object.assign(machine, data.machine, { modules, system: new Network(modules, data.wires, data.sequence) });
  }
  if (data.id) {
    newest = data;
    if (!busy) work();
  }
};
