"use strict";
// FMUs as modules for WebAssembly, coupled with fixed steps as cosim does it.

class Failure extends Error {}
const STATUS = ["OK", "Warning", "Discard", "Error", "Fatal", "Pending"];

// An instance of a module; `fmukit/fmu/native/wasm.c` says what it exports.
class Part {
  constructor(name, module) {
    this.name = name;
    this.flat = new WebAssembly.Instance(module).exports;
    this.flat._initialize();
    this.instance = this.flat.create();
    this.numbers = new Map();
  }

  // What the instance has said since it was last asked.
  words() {
    const bytes = new Uint8Array(this.flat.memory.buffer, this.flat.text());
    if (!bytes[0]) return "";
    const words = new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
    bytes[0] = 0;
    return words.replaceAll(/^i: /gm, "");
  }

  find(variable) {
    if (!this.numbers.has(variable)) {
      const name = new TextEncoder().encode(`${variable}\0`);
      new Uint8Array(this.flat.memory.buffer).set(name, this.flat.text());
      this.numbers.set(variable, this.flat.find());
    }
    if (this.numbers.get(variable) < 0) throw new Failure(`${this.name} has no variable ${variable}`);
    return this.numbers.get(variable);
  }

  check(status) { if (status > 1) throw new Failure(`${this.name}: ${this.words()}`); }
  set(variable, value) { this.check(this.flat.set(this.instance, this.find(variable), +value)); }
  get(variable) { return this.flat.get(this.instance, this.find(variable)); }
}

// Parts by name, in the sequence of their turns, and wires {from, to, factor, offset}.
class Network {
  constructor(modules, wires, sequence) {
    this.parts = Object.fromEntries(sequence.map(name => [name, new Part(name, modules[name])]));
    this.sequence = sequence.map(name => this.parts[name]);
    this.ends = new Map();
    this.wires = wires.map(wire => ({ ...wire, from: this.end(wire.from), to: this.end(wire.to) }));
  }

  // The part and the variable of a dotted name.
  end(name) {
    if (!this.ends.has(name)) {
      const part = this.sequence.find(part => name.startsWith(`${part.name}.`));
      this.ends.set(name, { part, variable: name.slice(part.name.length + 1) });
    }
    return this.ends.get(name);
  }

  // All parts at t = 0 with start values by name, those of wired inputs made to agree.
  start(values) {
    for (const part of this.sequence) { part.words(); part.check(part.flat.reset(part.instance)); }
    for (const [name, value] of Object.entries(values)) {
      const { part, variable } = this.end(name);
      part.set(variable, value);
    }
    for (const part of this.sequence) part.check(part.flat.enter(part.instance));
    for (let round = this.wires.length + 2, before = ""; ; round--) {
      const now = this.wires.map(({ from, to, factor, offset }) => {
        const value = factor * from.part.get(from.variable) + offset;
        to.part.set(to.variable, value);
        return value;
      });
      if (before === (before = now.join())) break;
      if (!round) throw new Failure("the start values of an algebraic loop were not found");
    }
    for (const part of this.sequence) part.check(part.flat.begin(part.instance));
  }

  // Turns in stages, each [part, at, size] in shares of a step.
  stages(algorithm) {
    const all = this.sequence.map(part => [part, 0, 1]), first = all.slice(0, -1);
    if (algorithm === "jacobi") return [all];
    if (algorithm === "gauss-seidel") return all.map(turn => [turn]);
    return [...first.map(([part]) => [[part, 0, 0.5]]), [last(all)],
      ...first.reverse().map(([part]) => [[part, 0.5, 0.5]])];
  }

  // What the parts have said since the start, each sentence once.
  heard() {
    const said = this.sequence.flatMap(part => part.words().split("\n").filter(Boolean).map(line => `${part.name}: ${line}`));
    return [...new Set(said)];
  }

  // The recorded columns by name, and time, in steps of h; a row at the start and after each.
  run(stop, h, algorithm, record) {
    const count = Math.max(1, Math.ceil(stop / h - 1e-6));
    const cell = name => {
      const { part, variable } = this.end(name);
      return { flat: part.flat, instance: part.instance, number: part.find(variable), value: 0 };
    };
    const cells = new Map(), look = new Map(this.sequence.map(part => [part, []]));
    for (const { from } of this.wires) {
      const name = `${from.part.name}.${from.variable}`;
      if (cells.has(name)) continue;
      cells.set(name, cell(name));
      look.get(from.part).push(cells.get(name));
    }
    const stages = this.stages(algorithm).map(stage => ({
      turns: stage.map(([part, at, size]) => ({
        part, at, size, flat: part.flat, instance: part.instance,
        links: this.wires.filter(({ to }) => to.part === part).map(({ from, to, factor, offset }) => ({
          source: cells.get(`${from.part.name}.${from.variable}`), number: part.find(to.variable), factor, offset,
        })),
      })),
      looks: stage.flatMap(([part]) => look.get(part)),
    }));
    const read = one => { one.value = one.flat.get(one.instance, one.number); };
    for (const one of cells.values()) read(one);
    const rows = record.map(name => ({ own: !cells.has(name), cell: cells.get(name) ?? cell(name),
      values: new Float64Array(count + 1) }));
    const time = new Float64Array(count + 1);
    const keep = n => {
      for (const { own, cell, values } of rows) {
        if (own) read(cell);
        values[n] = cell.value;
      }
    };
    keep(0);
    for (let n = 0; n < count; n++) {
      const t = n * h, step = n === count - 1 && t + h !== stop ? stop - t : h;
      for (const { turns, looks } of stages) {
        for (const { part, at, size, flat, instance, links } of turns) {
          for (const { source, number, factor, offset } of links)
            flat.set(instance, number, factor * source.value + offset);
          const status = flat.step(instance, t + at * step, size * step);
          if (status < 2) continue;
          const call = `doStep(t = ${written(t + at * step)} s, h = ${written(size * step)} s)`, [why] = part.words().trim().split("\n").slice(-1);
          throw new Failure(`${part.name}: ${call} returned ${STATUS[status]}: ${why}; stopped at t = ${written(t)} s, ${n + 1} rows kept`);
        }
        for (const one of looks) read(one);
      }
      time[n + 1] = n === count - 1 ? stop : (n + 1) * h;
      keep(n + 1);
    }
    return { time, ...Object.fromEntries(record.map((name, k) => [name, rows[k].values])) };
  }
}
