"use strict";
// FMUs as modules for WebAssembly, coupled with fixed steps as cosim does it.

class Failure extends Error {}

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
    const end = name => {
      const [part] = sequence.filter(part => name.startsWith(`${part}.`));
      return { part: this.parts[part], variable: name.slice(part.length + 1) };
    };
    this.end = end;
    this.wires = wires.map(wire => ({ ...wire, from: end(wire.from), to: end(wire.to) }));
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
          if (status > 1) part.check(status);
        }
        for (const one of looks) read(one);
      }
      time[n + 1] = n === count - 1 ? stop : (n + 1) * h;
      keep(n + 1);
    }
    return { time, ...Object.fromEntries(record.map((name, k) => [name, rows[k].values])) };
  }
}

// Whole revolutions on a steady orbit, as workbench/orbit.py finds it: `start` makes start values of
// the states. A generator that yields after every run; throws Failure where there is no orbit.
function* steady(system, start, states, angle, speed, steps, record, algorithm) {
  const names = Object.keys(states), count = names.length + 1, h = TURN / (speed * steps);
  const columns = [...new Set([angle, ...names, ...record])];
  const scale = names.map(name => Math.max(Math.abs(states[name]), 1e-3 * speed));
  const ends = range(count + 1, k => TURN * k);
  let at = names.map(name => states[name]), pace = 1, moved = Infinity, safe = null, known = null;
  for (let round = 0; round < 16; round++) {
    const number = Math.ceil(count * steps * 1.02 / pace) + 8;
    system.start({ ...start, ...Object.fromEntries(names.map((name, k) => [name, at[k]])) });
    const rows = system.run(number * h, h, algorithm, columns), phi = rows[angle];
    yield;
    if (phi.some((x, k) => k && !(x > phi[k - 1]))) {
      if (safe === null) throw new Failure("the crank does not turn all the way");
      at = at.map((x, k) => (x + safe[k]) / 2);
      continue;
    }
    if (last(phi) < TURN * count) {
      pace = last(phi) / (TURN * count) * pace / 1.02;
      if (pace < 0.05) {
        const turns = six(last(phi) / last(rows.time), 3);
        throw new Failure(`the crank turns at ${turns} rad/s instead of ${six(speed)} rad/s`);
      }
      continue;
    }
    const [times, ...sections] = atAngles(phi, [rows.time, ...names.map(name => rows[name])], ends);
    const points = ends.map((_, k) => sections.map((values, j) => values[k] / scale[j]));
    points[0] = at.map((x, j) => x / scale[j]);
    const moves = range(count, k => points[k + 1].map((x, j) => x - points[k][j]));
    const before = moved, final = moves[count - 1];
    moved = most(final, Math.abs);
    if (known === null || most(moves.flat(), Math.abs) > 1e-6) known = returnMap(moves);
    const { map, left } = known, far = moved * Math.max(left / Math.max(1 - left, 1e-12), 1);
    if (far < 3e-9 || (far < 1e-6 && moved > 0.3 * before)) {
      if (left >= 1) throw new Failure("the orbit is not stable: deviations from it grow");
      const window = back => [searchsorted(phi, ends[count - 1 - back]), searchsorted(phi, ends[count - back]) + 1];
      return { rows, phi, ends, times, window, remains: x => x * Math.max(left / (1 - left), 0.1) };
    }
    const gap = map.map((row, i) => row.map((x, j) => +(i === j) - x));
    const ahead = lstsq(gap, final.map(x => [x]), 1e-12).map(([x]) => x);
    safe = points[count].map((x, j) => x * scale[j]);
    at = safe.map((x, i) => x + map[i].reduce((sum, m, j) => sum + m * ahead[j], 0) * scale[i]);
  }
  throw new Failure(`after ${16 * count} revolutions the orbit still moves by ${six(moved, 1)} of itself`);
}

// The linear map that takes each move between sections to the next, and its largest rate.
const returnMap = moves => {
  const size = moves[0].map((_, j) => Math.max(most(moves, move => Math.abs(move[j])), 1e-300));
  const of = rows => rows.map(row => row.map((x, j) => x / size[j]));
  const found = lstsq(of(moves.slice(0, -1)), of(moves.slice(1)), 5e-3);
  return { map: found.map((_, i) => found.map((row, j) => row[i] * size[i] / size[j])),
    left: radius(found) };
};

// Columns at wanted angles, on polynomials through eight rows.
const atAngles = (phi, columns, wanted) => {
  const found = columns.map(() => []);
  for (const angle of wanted) {
    const first = Math.min(Math.max(searchsorted(phi, angle) - 4, 0), phi.length - 8);
    const cut = values => Array.from(values.subarray(first, first + 8)), near = cut(phi);
    columns.forEach((values, k) => found[k].push(through(near, cut(values))(angle)));
  }
  return found;
};
