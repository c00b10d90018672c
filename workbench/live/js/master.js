// FMUs as modules for WebAssembly, coupled with fixed steps as cosim does it.

class Failure extends Error {}
// Sweeps of a repeated step, the change of an output in a sweep over its size below which it agrees, and the
// sweeps that are mixed: those of cosim/engine/iteration.py.
const [MOST_SWEEPS, AGREEMENT, MEMORY] = [50, 1e-12, 5];
// The square of what is left of a difference of residuals, over that of the difference, below which it is a
// combination of the others but for rounding.
const DEPENDENT = 1e-28;
const STATUS = ["OK", "Warning", "Discard", "Error", "Fatal", "Pending"];

// An instance of a module; docs/wasm.md says what it exports.
class Part {
  constructor(name, module) {
    this.name = name;
    this.flat = new WebAssembly.Instance(module).exports;
    this.flat._initialize();
    this.instance = this.flat.create();
    this.numbers = new Map();
  }

  // The messages of the instance since the last call.
  messages() {
    const bytes = new Uint8Array(this.flat.memory.buffer, this.flat.text());
    if (!bytes[0]) return "";
    const text = new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
    bytes[0] = 0;
    return text.replaceAll(/^i: /gm, "");
  }

  find(variable) {
    if (!this.numbers.has(variable)) {
      const name = new TextEncoder().encode(`${variable}\0`);
      new Uint8Array(this.flat.memory.buffer).set(name, this.flat.text());
      this.numbers.set(variable, this.flat.find());
    }
    const number = this.numbers.get(variable);
    if (number < 0) throw new Failure(`${this.name} has no variable ${variable}`);
    return number;
  }

  check(status) {
    if (status > 1) throw new Failure(`${this.name}: ${this.messages()}`);
  }

  set(variable, value) {
    this.check(this.flat.set(this.instance, this.find(variable), +value));
  }

  get(variable) {
    return this.flat.get(this.instance, this.find(variable));
  }
}

// Parts by name, in the sequence in which they step, and wires { from, to, factor, offset }.
class Network {
  constructor(modules, wires, sequence) {
    this.parts = Object.fromEntries(sequence.map((name) => [name, new Part(name, modules[name])]));
    this.sequence = sequence.map((name) => this.parts[name]);
    this.ends = new Map();
    this.wires = wires.map((wire) => ({
      ...wire,
      from: this.end(wire.from),
      to: this.end(wire.to),
    }));
  }

  // The part and the variable of a dotted name.
  end(name) {
    if (!this.ends.has(name)) {
      const part = this.sequence.find((other) => name.startsWith(`${other.name}.`));
      this.ends.set(name, { part, variable: name.slice(part.name.length + 1) });
    }
    return this.ends.get(name);
  }

  // All parts at t = 0 with start values by name; wired inputs then agree with their outputs.
  start(values) {
    for (const part of this.sequence) {
      part.messages();
      part.check(part.flat.reset(part.instance));
    }
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

  // The messages since the start, each sentence once.
  warnings() {
    const lines = this.sequence.flatMap((part) =>
      part
        .messages()
        .split("\n")
        .filter(Boolean)
        .map((line) => `${part.name}: ${line}`),
    );
    return [...new Set(lines)];
  }
}

// A run of a network that was started, in steps of h up to `stop`, by default without an end. A step has
// stages of turns [part, at, size] in shares of the step. With an `end_weight` above 0 it is repeated until the
// outputs at its end are those of which inputs take this share, and the rest of those at its beginning.
class Run {
  constructor(network, h, { stages, end_weight: weight }, stop = Infinity) {
    Object.assign(this, { network, h, weight, stop, n: 0, time: 0 });
    this.count = Math.max(1, Math.ceil(stop / h - 1e-6));
    const sources = network.wires.map(({ from }) => `${from.part.name}.${from.variable}`);
    this.cells = new Map(sources.map((name) => [name, cellOf(network.end(name))]));
    for (const { from, nominal, discrete } of network.wires) {
      const cell = this.cells.get(`${from.part.name}.${from.variable}`);
      Object.assign(cell, { nominal, discrete });
    }
    this.stages = stages.map((stage) => ({
      turns: stage.map(([name, ...rest]) => this.turn(network.parts[name], ...rest)),
      outputs: stage.flatMap(([name]) =>
        [...this.cells.values()].filter((x) => x.part.name === name),
      ),
    }));
    for (const cell of this.cells.values()) read(cell);
  }

  turn(part, at, size) {
    const links = this.network.wires
      .filter(({ to }) => to.part === part)
      .map(({ from, to, factor, offset }) => ({
        source: this.cells.get(`${from.part.name}.${from.variable}`),
        number: part.find(to.variable),
        factor,
        offset,
      }));
    return { part, at, size, links, flat: part.flat, instance: part.instance };
  }

  step() {
    const t = this.n * this.h;
    const last = this.n + 1 >= this.count;
    const step = last && t + this.h !== this.stop ? this.stop - t : this.h;
    if (this.weight) this.iterate(t, step);
    else this.sweep(t, step);
    this.n++;
    this.time = last ? this.stop : this.n * this.h;
  }

  // All stages of a step once.
  sweep(t, step) {
    for (const { turns, outputs } of this.stages) {
      for (const turn of turns) {
        const { at, size, flat, instance, links } = turn;
        for (const { source, number, factor, offset } of links) {
          flat.set(instance, number, factor * source.value + offset);
        }
        const status = flat.step(instance, t + at * step, size * step);
        if (status > 1) fail(turn, status, t, step);
      }
      for (const cell of outputs) read(cell);
    }
  }

  // A step that is repeated, from the same state, until its outputs agree.
  iterate(t, step) {
    const cells = [...this.cells.values()];
    const begin = cells.map(({ value }) => value);
    const states = this.network.sequence.map(({ flat, instance }) => flat.save(instance));
    const each = (act) =>
      this.network.sequence.forEach(({ flat, instance }, k) => flat[act](instance, states[k]));
    const [images, residuals] = [[], []];
    let supposed = begin;
    try {
      for (let sweep = 0; sweep < MOST_SWEEPS; sweep++) {
        if (sweep) each("restore");
        cells.forEach((cell, k) => {
          const share = cell.discrete ? 1 : this.weight;
          cell.value = share * supposed[k] + (1 - share) * begin[k];
        });
        this.sweep(t, step);
        const image = cells.map(({ value }) => value);
        const change = image.map((value, k) => value - supposed[k]);
        const agrees = ({ nominal }, k) =>
          Math.abs(change[k]) <= AGREEMENT * (nominal + Math.abs(image[k]));
        if (cells.every(agrees)) return;
        images.unshift(image);
        residuals.unshift(change.map((x, k) => (cells[k].discrete ? 0 : x)));
        supposed = mixed(images.slice(0, MEMORY), residuals.slice(0, MEMORY));
        cells.forEach(({ discrete }, k) => {
          if (discrete) supposed[k] = image[k];
        });
      }
    } finally {
      each("free");
    }
    throw new Failure(`no convergence in ${MOST_SWEEPS} sweeps from t = ${t} s`);
  }

  // Rows of columns by name, and time: one now and one after each of so many steps.
  rows(record, steps = this.count) {
    const cells = record.map((name) => this.cells.get(name) ?? cellOf(this.network.end(name)));
    const own = record.map((name) => !this.cells.has(name));
    const columns = record.map(() => new Float64Array(steps + 1));
    const time = new Float64Array(steps + 1);
    for (let n = 0; ; n++) {
      time[n] = this.time;
      for (let k = 0; k < cells.length; k++) {
        if (own[k]) read(cells[k]);
        columns[k][n] = cells[k].value;
      }
      if (n === steps) break;
      this.step();
    }
    return { time, ...Object.fromEntries(record.map((name, k) => [name, columns[k]])) };
  }
}

// The next guess z after images g(z) and residuals g(z) - z, the newest first: the mixture of images that leaves the
// least residual (Anderson, J. ACM 12, 1965), by Gram and Schmidt's method on the differences of residuals.
const mixed = (images, residuals) => {
  const minus = (x, y, factor = 1) => x.map((value, k) => value - factor * y[k]);
  const dot = (x, y) => x.reduce((sum, value, k) => sum + value * y[k], 0);
  const basis = [];
  let [next, rest] = [images[0], residuals[0]];
  for (let n = 1; n < images.length; n++) {
    let direction = minus(residuals[n - 1], residuals[n]);
    let step = minus(images[n - 1], images[n]);
    const before = dot(direction, direction);
    for (const [other, its_step, size] of basis) {
      const factor = dot(direction, other) / size;
      direction = minus(direction, other, factor);
      step = minus(step, its_step, factor);
    }
    const size = dot(direction, direction);
    if (!(size > DEPENDENT * before)) continue;
    basis.push([direction, step, size]);
    const factor = dot(rest, direction) / size;
    rest = minus(rest, direction, factor);
    next = minus(next, step, factor);
  }
  return next;
};

// An output that is read again and again.
const cellOf = ({ part, variable }) => {
  const { flat, instance } = part;
  return { part, flat, instance, number: part.find(variable), value: 0 };
};

const read = (cell) => {
  cell.value = cell.flat.get(cell.instance, cell.number);
};

const fail = ({ part, at, size }, status, t, step) => {
  const call = `doStep(t = ${t + at * step} s, h = ${size * step} s)`;
  const why = part.messages().trim().split("\n").at(-1);
  throw new Failure(`${part.name}: ${call} returned ${STATUS[status]}: ${why}`);
};
