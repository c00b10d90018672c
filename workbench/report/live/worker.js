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
    let noted = -Infinity;
    machine.note = note => {
      if (performance.now() - noted < 100) return;
      noted = performance.now();
      postMessage({ id, note });
    };
    newest = null;
    const began = performance.now();
    try {
      for (const stage of answer(asked)) {
        postMessage({ id, ...stage, took: performance.now() - began });
        await breath();
        if (newest) break;
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
    Object.assign(machine, data.machine, { modules });
  }
  if (data.id) {
    newest = data;
    if (!busy) work();
  }
};
