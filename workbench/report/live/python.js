"use strict";
// What translated Python runs on: its operators, and by their own names what is used of its library,
// numpy, scipy and cosim. Numbers, texts, lists and None are those of JavaScript.

class Raised extends Failure {}
class StopIteration extends Raised {}

const py = (() => {
  class Complex { constructor(re, im) { this.re = re; this.im = im; } }

  // A NamedTuple: it unpacks, compares and counts as its fields.
  class Record {
    _replace(words) { return Object.assign(Object.create(Object.getPrototypeOf(this)), this, words); }
  }
  class Tuple extends Record {
    *[Symbol.iterator]() { for (const name of this.constructor.fields) yield this[name]; }
    _asdict() { return new Dict(this.constructor.fields.map(name => [name, this[name]])); }
    get length() { return this.constructor.fields.length; }
  }

  // What stands between brackets with commas.
  class Key { constructor(keys) { this.keys = keys; } }

  const keyed = key => key instanceof Key ? keyed(key.keys) : Array.isArray(key) || key instanceof Tuple ? `\0${JSON.stringify([...key])}` : key;
  class Dict {
    constructor(pairs = []) {
      this.held = new Map();
      for (const [key, value] of pairs) this.set(key, value);
    }
    set(key, value) { this.held.set(keyed(key), [key, value]); }
    has(key) { return this.held.has(keyed(key)); }
    item(key) {
      if (!this.has(key)) throw new Raised(`KeyError: ${key}`);
      return this.held.get(keyed(key))[1];
    }
    get(key, other = null) { return this.has(key) ? this.item(key) : other; }
    items() { return [...this.held.values()]; }
    keys() { return this.items().map(([key]) => key); }
    values() { return this.items().map(([, value]) => value); }
    pop(key, other) {
      const value = other === undefined ? this.item(key) : this.get(key, other);
      this.held.delete(keyed(key));
      return value;
    }
    setdefault(key, value) { if (!this.has(key)) this.set(key, value); return this.item(key); }
    update(other) { for (const [key, value] of pairs(other)) this.set(key, value); return null; }
    plain() { return Object.fromEntries(this.items()); }
    [Symbol.iterator]() { return this.keys()[Symbol.iterator](); }
  }
  const pairs = it => it instanceof Dict ? it.items() : iter(it);

  class Slice {
    constructor(start, stop, step) { Object.assign(this, { start, stop, step }); }
    // The first place and the one after the last, of steps of 1.
    ends(length) {
      const end = (x, other) => x === null ? other : Math.max(0, Math.min(x < 0 ? x + length : x, length));
      const first = end(this.start, 0);
      return [first, Math.max(first, end(this.stop, length))];
    }
    of(length) {
      const step = this.step ?? 1, down = step < 0, low = down ? -1 : 0, high = down ? length - 1 : length;
      const end = (x, other) => x === null ? other : Math.min(Math.max(x < 0 ? x + length : x, low), high);
      const first = end(this.start, down ? high : low), until = this.stop === null ? (down ? -1 : length) : end(this.stop, 0);
      return range(Math.max(0, Math.ceil((until - first) / step)), k => first + k * step);
    }
  }

  const iter = it => {
    if (it === null || it === undefined || !it[Symbol.iterator]) throw new Raised(`${it} has no items`);
    return it;
  };
  const truth = it => {
    if (it === null || it === undefined || it === false || it === 0 || it === "") return false;
    if (Array.isArray(it)) return it.length > 0;
    if (it instanceof ND) return it.size === 1 ? it.re[0] !== 0 : fail("the truth of an array");
    if (it instanceof Dict) return it.held.size > 0;
    if (it instanceof Set) return it.size > 0;
    return true;
  };
  const fail = text => { throw new Raised(text); };

  const call = (f, args, words) => {
    if (f.bound) return call(f.bound.f, [...f.bound.args, ...args], { ...f.bound.words, ...words });
    if (f.called) return f.called(...args);
    if (words && f.words) return f.words(args, words);
    args = placed(f, args, words);
    return f.fields || f.prototype instanceof Failure ? new f(...args) : f(...args);
  };
  const placed = (f, args, words) => {
    if (!words) return args;
    const names = f.fields ?? f.params ?? fail(`${f.name} takes no names`);
    args = [...args];
    for (const [name, value] of Object.entries(words)) {
      const k = names.indexOf(name);
      if (k < 0) fail(`${f.name} has no parameter ${name}`);
      args[k] = value;
    }
    return args;
  };
  const named = (f, names) => Object.assign(f, { params: names.split(" ") });
  const lambda = (f, params) => Object.assign(f, { params });

  const STRINGS = {
    join: (it, parts) => [...iter(parts)].join(it), partition: (it, cut) => {
      const k = it.indexOf(cut);
      return k < 0 ? [it, "", ""] : [it.slice(0, k), cut, it.slice(k + cut.length)];
    },
    replace: (it, old, other) => it.split(old).join(other), strip: (it, letters = null) =>
      letters === null ? it.trim() : STRINGS.rstrip([...it].reverse().join("") && STRINGS.lstrip(it, letters), letters),
    lstrip: (it, letters = " \n") => { while (it && letters.includes(it[0])) it = it.slice(1); return it; },
    rstrip: (it, letters = " \n") => { while (it && letters.includes(it.at(-1))) it = it.slice(0, -1); return it; },
    capitalize: it => it.slice(0, 1).toUpperCase() + it.slice(1).toLowerCase(), split: (it, cut) => it.split(cut),
    removeprefix: (it, start) => it.startsWith(start) ? it.slice(start.length) : it,
    removesuffix: (it, end) => end && it.endsWith(end) ? it.slice(0, -end.length) : it,
    startswith: (it, starts) => [starts].flat().some(start => it.startsWith(start)),
    endswith: (it, ends) => [ends].flat().some(end => it.endsWith(end)), splitlines: it => it.split("\n"), count: (it, part) => it.split(part).length - 1,
    lower: it => it.toLowerCase(), upper: it => it.toUpperCase(), format: fail,
  };
  const LISTS = {
    append: (it, one) => { it.push(one); return null; }, extend: (it, more) => { it.push(...iter(more)); return null; },
    insert: (it, k, one) => { it.splice(k, 0, one); return null; }, pop: (it, k = -1) => it.splice(k, 1)[0],
    index: (it, one) => it.findIndex(other => eq(one, other)), count: (it, one) => it.filter(other => eq(one, other)).length,
    copy: it => [...it],
  };
  const method = (it, name, args, words) => {
    if (typeof it === "string") return STRINGS[name](it, ...args);
    if (Array.isArray(it)) return LISTS[name](it, ...args);
    if (typeof it === "number") return name === "conj" || name === "item" ? it : np[name](it, ...args);
    if (it instanceof Record && name === "_replace") return it._replace(words);
    if (name === "send") return next(it, args[0]);
    const f = it[name] ?? fail(`${it?.constructor?.name} has no ${name}`);
    if (f.bound || f.fields || f.called) return call(f, args, words);
    return f.apply(it, placed(f, args, words));
  };
  // The next item of a generator, which is sent a value.
  const next = (it, sent) => {
    const { done, value } = it.next(sent);
    if (done) throw Object.assign(new StopIteration("StopIteration"), { value });
    return value;
  };
  // What a getter tells the first time.
  const kept = (it, name, f) => {
    const value = f.call(it);
    Object.defineProperty(it, name, { value });
    return value;
  };
  const attribute = (it, name) => {
    if (typeof it === "number" && name !== "__name__") return { real: it, imag: 0, size: 1, shape: [] }[name];
    if (it instanceof Complex) return { real: it.re, imag: it.im }[name];
    return name === "__name__" ? it.name : it[name];
  };

  const item = (it, k) => {
    if (it instanceof ND) return it.item(k);
    if (it instanceof Tuple) it = [...it];
    if (Array.isArray(it) || typeof it === "string") {
      if (k instanceof Slice) {
        const found = k.of(it.length).map(n => it[n]);
        return typeof it === "string" ? found.join("") : found;
      }
      const n = k < 0 ? it.length + +k : +k;
      return n in Object(it) ? it[n] : fail("IndexError: there is no such item");
    }
    return it.item(k);
  };
  const store = (it, k, value) => {
    if (it instanceof ND) it.store(k, value);
    else if (it instanceof Dict) it.set(k, value);
    else it[k < 0 ? it.length + k : k] = value;
  };
  const unpacked = (it, before, after) => {
    const all = [...iter(it)];
    return [...all.slice(0, before), all.slice(before, all.length - after), ...all.slice(all.length - after)];
  };

  const listed = it => Array.isArray(it) || it instanceof Tuple;
  const arrays = (a, b) => a instanceof ND || b instanceof ND;
  const order = (a, b) => {
    if (listed(a) && listed(b)) {
      const [first, other] = [[...a], [...b]];
      for (let k = 0; k < Math.min(first.length, other.length); k++)
        if (!eq(first[k], other[k])) return order(first[k], other[k]);
      return first.length - other.length;
    }
    return a < b ? -1 : a > b ? 1 : a === b ? 0 : NaN;
  };
  const eq = (a, b) => {
    if (a === b) return true;
    if (arrays(a, b)) return each(a, b, (x, y) => +(x === y), null, true);
    if (listed(a) && listed(b)) {
      const [first, other] = [[...a], [...b]];
      return first.length === other.length && first.every((x, k) => eq(x, other[k]));
    }
    if (a instanceof Complex && b instanceof Complex) return a.re === b.re && a.im === b.im;
    if (a instanceof Set && b instanceof Set) return a.size === b.size && [...a].every(x => b.has(x));
    return typeof a === "boolean" || typeof b === "boolean" ? +a === +b && typeof (a ?? "") !== "string" : false;
  };
  const comparison = (number, list) => (a, b) => {
    if (typeof a === "number" && typeof b === "number") return number(a, b);
    return arrays(a, b) || (listed(a) !== listed(b)) ? each(a, b, (x, y) => +number(x, y), null, true) : list(order(a, b));
  };
  const has = (one, it) => {
    if (it instanceof Dict || it instanceof Set) return it.has(one);
    return typeof it === "string" ? it.includes(one) : [...iter(it)].some(other => eq(one, other));
  };

  // Of complex numbers a + i b and c + i d: the real part is returned, the other one is left here.
  const other = new Float64Array(1);
  const pair = (re, im) => { other[0] = im; return re; };
  const complex = re => new Complex(re, other[0]), parts = it => it instanceof Complex ? [it.re, it.im] : [+it, 0];
  const arithmetic = (f, g) => (a, b) => typeof a === "number" && typeof b === "number" ? f(a, b) : each(a, b, f, g);
  const product = (a, b, c, d) => pair(a * c - b * d, a * d + b * c);
  const quotient = (a, b, c, d) => {
    const size = c * c + d * d;
    return pair((a * c + b * d) / size, (b * c - a * d) / size);
  };
  const whole = (a, b, n) => {
    if (Number.isInteger(n) && n > 0 && n <= 4) {
      let re = a, im = b;
      for (let k = 1; k < n; k++) { re = product(re, im, a, b); im = other[0]; }
      return pair(re, im);
    }
    const size = Math.hypot(a, b) ** n, angle = Math.atan2(b, a) * n;
    return pair(size * Math.cos(angle), size * Math.sin(angle));
  };
  const numbers = {
    add: arithmetic((a, b) => a + b, (a, b, c, d) => pair(a + c, b + d)),
    sub: arithmetic((a, b) => a - b, (a, b, c, d) => pair(a - c, b - d)),
    mul: arithmetic((a, b) => a * b, product),
    div: arithmetic((a, b) => a / b, quotient),
    floordiv: arithmetic((a, b) => Math.floor(a / b)),
    mod: arithmetic((a, b) => { const rest = a % b; return rest !== 0 && (rest < 0) !== (b < 0) ? rest + b : rest; }),
    pow: arithmetic((a, b) => b === 2 ? a * a : a ** b, whole),
  };

  // Numbers over a grid of a shape, row by row; `im` is there if they are complex.
  class ND {
    constructor(shape, re, im = null, flags = false) { Object.assign(this, { shape, re, im, flags }); }
    get size() { return this.re.length; }
    get length() { return this.shape[0]; }
    get real() { return new ND(this.shape, this.re); }
    get imag() { return new ND(this.shape, this.im ?? new Float64Array(this.size)); }
    get T() { return this.transpose(); }
    // Where flags are set.
    set() {
      const found = [];
      for (let k = 0; k < this.size; k++) if (this.re[k]) found.push(k);
      return found;
    }
    at(k) { return this.im ? new Complex(this.re[k], this.im[k]) : this.flags ? this.re[k] !== 0 : this.re[k]; }
    *[Symbol.iterator]() { for (let k = 0; k < this.shape[0]; k++) yield this.item(k); }

    // The numbers at places, and the shape that a key leaves: [shape, places].
    picked(key) {
      const keys = key instanceof Key ? key.keys : [key];
      const shape = [], picks = [];
      let axis = 0;
      for (const one of keys) {
        const long = this.shape[axis];
        if (one === null) { shape.push(1); continue; }
        if (typeof one === "number") {
          const k = one < 0 ? one + long : one;
          if (!(k >= 0 && k < long)) fail("IndexError: there is no such row");
          picks.push([k]);
        } else {
          const found = one instanceof Slice ? one.of(long) : one instanceof ND && one.flags ? one.set()
            : [...iter(one)].map(k => k < 0 ? k + long : k);
          picks.push(found);
          shape.push(found.length);
        }
        axis++;
      }
      for (; axis < this.shape.length; axis++) { picks.push(range(this.shape[axis])); shape.push(this.shape[axis]); }
      let places = [0];
      picks.forEach((found, n) => {
        const wide = this.shape.slice(n + 1).reduce((a, b) => a * b, 1), before = places;
        places = new Array(before.length * found.length);
        let at = 0;
        for (const place of before) for (const k of found) places[at++] = place + k * wide;
      });
      return [shape, places];
    }
    item(key) {
      if (typeof key === "number" && this.shape.length === 1) {
        const k = key < 0 ? key + this.size : key;
        return k >= 0 && k < this.size ? this.at(k) : fail("IndexError: there is no such row");
      }
      if (!(key instanceof Key) && key !== null && typeof key !== "number") return this.rows(key);
      if (key instanceof Key && this.shape.length === 2 && !this.im && typeof key.keys[1] === "number" && key.keys[0] instanceof Slice)
        return this.column(key.keys[1] < 0 ? key.keys[1] + this.shape[1] : key.keys[1]).item(key.keys[0]);
      const [shape, places] = this.picked(key), take = from => {
        const out = from && new Float64Array(places.length);
        if (from) for (let k = 0; k < places.length; k++) out[k] = from[places[k]];
        return out;
      };
      if (!shape.length) return this.at(places[0]);
      return new ND(shape, take(this.re), take(this.im), this.flags);
    }
    // Rows along the first axis.
    rows(key) {
      const [long, ...rest] = this.shape, wide = rest.reduce((a, b) => a * b, 1);
      const ends = key instanceof Slice && (key.step ?? 1) === 1 ? key.ends(long) : null;
      const list = ends ? null : key instanceof Slice ? key.of(long) : key instanceof ND ? (key.flags ? key.set() : key.re) : [...iter(key)];
      const take = from => {
        if (!from) return null;
        if (ends) return from.slice(ends[0] * wide, ends[1] * wide);
        const out = new Float64Array(list.length * wide);
        for (let k = 0; k < list.length; k++) {
          const row = (list[k] < 0 ? list[k] + long : list[k]) * wide;
          for (let n = 0; n < wide; n++) out[k * wide + n] = from[row + n];
        }
        return out;
      };
      return new ND([ends ? ends[1] - ends[0] : list.length, ...rest], take(this.re), take(this.im), this.flags);
    }
    column(k) {
      const [long, wide] = this.shape, out = new Float64Array(long);
      for (let n = 0; n < long; n++) out[n] = this.re[n * wide + k];
      return new ND([long], out, null, this.flags);
    }
    store(key, value) {
      const [shape, places] = this.picked(key), from = spread(value, shape);
      places.forEach((place, k) => { this.re[place] = from(k); });
    }
    tolist() { return this.shape.length > 1 ? [...this].map(row => row.tolist()) : range(this.size, k => this.at(k)); }
    reshape(...shape) {
      shape = shape.flat();
      const known = shape.reduce((a, b) => b < 0 ? a : a * b, 1);
      return new ND(shape.map(x => x < 0 ? this.size / known : x), this.re, this.im, this.flags);
    }
    ravel() { return this.reshape(this.size); }
    transpose() {
      const { shape } = this, n = shape.length;
      if (n < 2) return this;
      const [rows, wide] = shape, turn = from => {
        const out = from && new Float64Array(from.length);
        if (from) for (let i = 0; i < rows; i++) for (let j = 0; j < wide; j++) out[j * rows + i] = from[i * wide + j];
        return out;
      };
      return new ND([wide, rows], turn(this.re), turn(this.im), this.flags);
    }
    copy() { return new ND(this.shape, this.re.slice(), this.im?.slice() ?? null, this.flags); }
    astype() { return this.im ? this : new ND(this.shape, this.re); }
    conj() { return this.im ? new ND(this.shape, this.re, this.im.map(x => -x)) : this; }
    round(digits = 0) { return each1(this, x => rounding(x, digits)); }

    // Along an axis, or of all numbers: what `f` makes of each row of them.
    along(axis, f, flags = false) {
      const made = (re, im) => f(im ? range(re.length, k => new Complex(re[k], im[k])) : re);
      if (axis === null || axis === undefined || this.shape.length === 1) {
        const value = made(this.re, this.im);
        return flags ? Boolean(value) : value;
      }
      if (axis < 0) axis += this.shape.length;
      const { shape } = this, long = shape[axis], inner = shape.slice(axis + 1).reduce((a, b) => a * b, 1);
      const rest = shape.filter((_, k) => k !== axis), out = new Float64Array(this.size / long);
      for (let k = 0; k < out.length; k++) {
        const first = Math.floor(k / inner) * inner * long + k % inner;
        const row = new Float64Array(long);
        for (let n = 0; n < long; n++) row[n] = this.re[first + n * inner];
        out[k] = f(row);
      }
      return new ND(rest, out, null, flags);
    }
    max(axis, initial) { return this.along(axis, x => Math.max(initial ?? -Infinity, most(x))); }
    min(axis, initial) { return this.along(axis, x => Math.min(initial ?? Infinity, -most(x, y => -y))); }
    sum(axis) { return this.along(axis, total); }
    prod(axis) { return this.along(axis, x => x.reduce((a, b) => a * b, 1)); }
    mean(axis) { return this.along(axis, x => numbers.div(total(x), x.length)); }
    any(axis) { return this.along(axis, x => +x.some(y => y), true); }
    all(axis) { return this.along(axis, x => +x.every(y => y), true); }
    argmax() { return this.re.reduce((best, x, k) => x > this.re[best] ? k : best, 0); }
    argmin() { return this.re.reduce((best, x, k) => x < this.re[best] ? k : best, 0); }
    // Of all before, along the last axis.
    cumprod() {
      const wide = this.shape.at(-1), { re, im } = this.copy();
      for (let k = 0; k < re.length; k++) if (k % wide) {
        const [a, b] = [re[k - 1], im ? im[k - 1] : 0], c = re[k];
        if (!im) re[k] = a * c; else { re[k] = a * c - b * im[k]; im[k] = a * im[k] + b * c; }
      }
      return new ND(this.shape, re, im);
    }
    cumsum() { let sum = 0; return new ND(this.shape, this.re.map(x => sum += x)); }
  }
  for (const [name, names] of Object.entries({ max: "axis initial", min: "axis initial", sum: "axis", mean: "axis", prod: "axis",
    any: "axis", all: "axis", cumprod: "axis" })) ND.prototype[name].params = names.split(" ");

  // Sums as numpy does them, in pairs of halves.
  const total = x => {
    const sum = (first, end) => {
      if (end - first <= 128) { let all = 0; for (let k = first; k < end; k++) all = numbers.add(all, x[k]); return all; }
      const middle = (first + end) >> 1;
      return numbers.add(sum(first, middle), sum(middle, end));
    };
    return sum(0, x.length);
  };

  const nd = it => {
    if (it instanceof ND) return it;
    if (typeof it === "number" || typeof it === "boolean") return new ND([], Float64Array.of(+it), null, typeof it === "boolean");
    if (it instanceof Complex) return new ND([], Float64Array.of(it.re), Float64Array.of(it.im));
    if (it === null) return new ND([], Float64Array.of(NaN));
    if (it instanceof Float64Array) return new ND([it.length], it);
    if (typeof it === "string") fail(`${it} is no number`);
    const list = Array.isArray(it) ? it : [...iter(it)];
    if (list.every(x => typeof x === "number")) return new ND([list.length], new Float64Array(list));
    const rows = list.map(nd), [first] = rows;
    const size = first.size, im = rows.some(row => row.im), re = new Float64Array(size * rows.length);
    const more = im ? new Float64Array(re.length) : null;
    rows.forEach((row, k) => { re.set(row.re, k * size); if (row.im) more.set(row.im, k * size); });
    return new ND([rows.length, ...first.shape], re, more, rows.every(row => row.flags));
  };
  const bare = it => it.shape.length ? it : it.at(0);

  const common = shapes => {
    const [first] = shapes, n = Math.max(...shapes.map(shape => shape.length));
    if (shapes.every(shape => shape.length === n && shape.every((long, k) => long === first[k]))) return first;
    return range(n, k => {
      const sizes = shapes.map(shape => shape[k - n + shape.length] ?? 1), long = sizes.find(x => x !== 1) ?? 1;
      return sizes.every(x => x === 1 || x === long) ? long : fail(`shapes ${shapes.join(" and ")} do not fit`);
    });
  };
  // The place in an array of each place in a larger shape.
  const places = (shape, wide) => {
    const size = wide.reduce((a, b) => a * b, 1), out = new Int32Array(size), n = wide.length, step = new Array(n).fill(0);
    for (let k = n - 1, by = 1; k >= 0; k--) {
      const long = shape[k - n + shape.length] ?? 1;
      step[k] = long === 1 ? 0 : by;
      by *= long;
    }
    const at = new Array(n).fill(0);
    for (let k = 0, place = 0; k < size; k++) {
      out[k] = place;
      for (let axis = n - 1; axis >= 0; axis--) {
        place += step[axis];
        if (++at[axis] < wide[axis]) break;
        place -= step[axis] * wide[axis];
        at[axis] = 0;
      }
    }
    return out;
  };
  const spread = (value, shape) => {
    const from = nd(value), at = places(from.shape, shape);
    return k => from.re[at[k]];
  };
  // What an array holds over a larger shape, no values being zeros, and which bits of a place there count.
  const NOUGHT = new Float64Array(1);
  const wide = (values, { size: own, shape: narrow }, shape, size) => {
    if (!values || own === 1) return [values ?? NOUGHT, 0];
    return [own === size ? values : Float64Array.from(places(narrow, shape), k => values[k]), -1];
  };
  // f of numbers, g of complex ones, over all of a and b.
  const each = (a, b, f, g = null, flags = false) => {
    if (a instanceof Complex || b instanceof Complex) {
      if (!arrays(a, b) && !listed(a) && !listed(b)) return complex(g(...parts(a), ...parts(b)));
    } else if (!arrays(a, b) && !listed(a) && !listed(b)) return f(+a, +b);
    const p = nd(a), q = nd(b), shape = p.shape.length ? q.shape.length ? common([p.shape, q.shape]) : p.shape : q.shape;
    const size = shape.reduce((x, y) => x * y, 1), re = new Float64Array(size);
    const [x, m] = wide(p.re, p, shape, size), [y, n] = wide(q.re, q, shape, size);
    if (!p.im && !q.im) {
      for (let k = 0; k < size; k++) re[k] = f(x[k & m], y[k & n]);
      return new ND(shape, re, null, flags);
    }
    const im = new Float64Array(size), [u, i] = wide(p.im, p, shape, size), [v, j] = wide(q.im, q, shape, size);
    for (let k = 0; k < size; k++) {
      re[k] = g(x[k & m], u[k & i], y[k & n], v[k & j]);
      im[k] = other[0];
    }
    return new ND(shape, re, im);
  };
  // f of a number, g of a complex one; g gives a number if `real`.
  const each1 = (a, f, g = null, real = false, flags = false) => {
    if (typeof a === "number") return flags ? Boolean(f(a)) : f(a);
    if (typeof a === "boolean") return f(+a);
    if (a instanceof Complex) { const re = g(a.re, a.im); return flags ? Boolean(re) : real ? re : complex(re); }
    const p = nd(a), re = new Float64Array(p.size);
    if (!p.im) {
      for (let k = 0; k < re.length; k++) re[k] = f(p.re[k]);
      return bare(new ND(p.shape, re, null, flags));
    }
    const im = real ? null : new Float64Array(p.size);
    for (let k = 0; k < re.length; k++) {
      re[k] = g(p.re[k], p.im[k]);
      if (im) im[k] = other[0];
    }
    return bare(new ND(p.shape, re, im, flags));
  };

  const rounding = (x, digits = 0) => {
    const size = 10 ** Math.abs(digits), scaled = digits < 0 ? x / size : x * size, low = Math.floor(scaled), rest = scaled - low;
    const near = rest < 0.5 || (rest === 0.5 && low % 2 === 0) ? low : low + 1;
    return digits < 0 ? near * size : near / size;
  };

  const format = (it, form) => {
    if (!form) return said(it);
    const [, fill, , zero, places, kind] = /^(?:(.?)([<>^]))?(\+?z?)0?\d*,?(?:\.(\d+))?([gfeds%]?)$/.exec(form) ?? fail(`format ${form}`);
    if (typeof it === "string") return it;
    if (it instanceof Complex || typeof it !== "number" && typeof it !== "boolean") fail(`format ${form} of ${it}`);
    if (Object.is(it, -0) && !zero.includes("z")) return `-${format(0, form.replace("+", ""))}`;
    if (zero.startsWith("+")) return (it < 0 ? "" : "+") + format(it, form.replace("+", ""));
    const x = +it, digits = places === undefined ? 6 : +places;
    if (!Number.isFinite(x)) return (Number.isNaN(x) ? "nan" : x > 0 ? "inf" : "-inf") + (kind === "%" ? "%" : "");
    if (kind === "%") return `${fixed(100 * x, digits)}%`;
    if (kind === "f") { const text = fixed(x, digits); return zero && +text === 0 ? text.replace("-", "") : text; }
    if (kind === "e") return power(x.toExponential(digits));
    if (kind === "d") return String(x);
    return six(x, digits || 1);
  };
  // Halves go to the even digit, as those of Python do and those of toFixed do not.
  const fixed = (x, digits) => {
    const text = x.toFixed(digits), half = x.toFixed(digits + 1).endsWith("5") && /^50*$/.test(x.toFixed(Math.min(100, digits + 60)).slice(-Math.min(100 - digits, 60)));
    if (!half || +text.at(-1) % 2 === 0) return text;
    return (x - Math.sign(x) * 10 ** -digits / 4).toFixed(digits);
  };
  const said = it => {
    if (typeof it === "number") return Number.isNaN(it) ? "nan" : power(String(it));
    if (it instanceof Error) return it.message;
    return it === null ? "None" : it === true ? "True" : it === false ? "False" : String(it);
  };
  const repr = it => typeof it === "string" ? `'${it}'` : said(it);

  const caught = (error, kind) => [kind].flat().some(one => error instanceof one);
  const or = (a, b) => {
    if (a instanceof Dict) return new Dict([...a.items(), ...pairs(b)]);
    if (a instanceof Set) return new Set([...a, ...b]);
    if (typeof a === "function") return [a, b].flat();
    if (typeof a === "boolean" && typeof b === "boolean") return a || b;
    return arrays(a, b) ? each(a, b, (x, y) => +(x || y), null, true) : a | b;
  };
  // What += and |= make of what may be changed.
  const extended = (a, b) => {
    if (!Array.isArray(a)) return add(a, b);
    for (const one of [...iter(b)]) a.push(one);
    return a;
  };
  const updated = (a, b) => {
    if (a instanceof Dict) for (const [key, value] of pairs(b)) a.set(key, value);
    else if (a instanceof Set) for (const one of b) a.add(one);
    else return or(a, b);
    return a;
  };
  const and = (a, b) => {
    if (a instanceof Set) return new Set([...a].filter(x => b.has(x)));
    if (typeof a === "boolean" && typeof b === "boolean") return a && b;
    return arrays(a, b) ? each(a, b, (x, y) => +(x && y), null, true) : a & b;
  };
  const add = (a, b) => {
    if (typeof a === "string") return a + b;
    return Array.isArray(a) && Array.isArray(b) ? [...a, ...b] : numbers.add(a, b);
  };
  const sub = (a, b) => a instanceof Set ? new Set([...a].filter(x => !b.has(x))) : numbers.sub(a, b);
  const mul = (a, b) => {
    if (typeof a === "string") return a.repeat(Math.max(0, +b));
    if (Array.isArray(a) && (typeof b === "number" || typeof b === "boolean")) return range(+b).flatMap(() => a);
    return Array.isArray(b) && typeof a === "number" ? range(a).flatMap(() => b) : numbers.mul(a, b);
  };
  // What Python holds, as JSON.
  const plain = it => {
    if (it instanceof Dict) return Object.fromEntries(it.items().map(([key, value]) => [key, plain(value)]));
    if (it instanceof ND) return it.tolist().map(plain);
    return Array.isArray(it) || it instanceof Tuple ? [...it].map(plain) : it;
  };
  return { ...numbers, Key, add, sub, mul, or, and, extended, updated, Complex, Record, Tuple, Dict, Slice, ND, nd, each, each1, common, places, bare, total,
    iter, truth, call, method, attribute, item, store, unpacked, pairs, has, eq, format, repr, said, caught, plain, named,
    lambda, order, rounding, fail, kept, next, pair, same: (a, b) => a === b, differs: (a, b) => a !== b, text: (...parts) => parts.join(""),
    ne: (a, b) => { const found = eq(a, b); return found instanceof ND ? np.logical_not(found) : !found; },
    hasnot: (a, b) => !has(a, b), lt: comparison((a, b) => a < b, x => x < 0), le: comparison((a, b) => a <= b, x => x <= 0),
    gt: comparison((a, b) => a > b, x => x > 0), ge: comparison((a, b) => a >= b, x => x >= 0),
    both: (a, b) => truth(a) ? b() : a, either: (a, b) => truth(a) ? a : b(),
    neg: a => typeof a === "number" ? -a : each1(a, x => -x, (re, im) => pair(-re, -im)),
    invert: a => typeof a === "number" ? ~a : each1(a, x => +!x, null, false, true) };
})();

const math = {
  sqrt: x => x < 0 ? py.fail("ValueError: math domain error") : Math.sqrt(x), ceil: Math.ceil, floor: Math.floor, isfinite: Number.isFinite,
  isnan: Number.isNaN, log10: Math.log10, cos: Math.cos, sin: Math.sin, exp: Math.exp, hypot: Math.hypot, atan2: Math.atan2, tan: Math.tan,
  log: (x, base) => base === undefined ? Math.log(x) : base === 2 ? Math.log2(x) : Math.log(x) / Math.log(base), expm1: Math.expm1,
  degrees: x => x * (180 / Math.PI), radians: x => x * (Math.PI / 180), prod: x => [...x].reduce((a, b) => a * b, 1), acos: Math.acos,
};

const np = (() => {
  const { ND, Complex, nd, each, each1, named, bare } = py;
  const unary = (f, g, real) => x => each1(x, f, g, real);
  const flag = f => x => each1(x, y => +f(y), (re, im) => +(f(re) && f(im)), true, true);
  const lists = it => [...py.iter(it)].map(nd);
  const joined = (arrays, axis = 0) => {
    arrays = lists(arrays).filter((x, _, all) => x.size || all.every(y => !y.size));
    if (axis < 0) axis += arrays[0].shape.length;
    const shape = [...arrays[0].shape], im = arrays.some(x => x.im);
    const blocks = arrays.map(x => x.shape.slice(axis).reduce((a, b) => a * b, 1)), outer = arrays[0].size / blocks[0] || 0;
    shape[axis] = arrays.reduce((sum, x) => sum + x.shape[axis], 0);
    const re = new Float64Array(shape.reduce((a, b) => a * b, 1)), more = im ? new Float64Array(re.length) : null;
    const total = re.length / outer;
    const put = (from, to, first, block) => {
      for (let n = 0; n < outer; n++) {
        if (block > 8) to.set(from.subarray(n * block, (n + 1) * block), first + n * total);
        else for (let j = 0; j < block; j++) to[first + n * total + j] = from[n * block + j];
      }
      return first + block;
    };
    arrays.reduce((first, x, k) => {
      if (x.im) put(x.im, more, first, blocks[k]);
      return put(x.re, re, first, blocks[k]);
    }, 0);
    return new ND(shape, re, more, arrays.every(x => x.flags));
  };
  const grown = (x, axis) => {
    const shape = [...x.shape];
    shape.splice(axis < 0 ? axis + shape.length + 1 : axis, 0, 1);
    return new ND(shape, x.re, x.im, x.flags);
  };
  const filled = (shape, value) => {
    shape = typeof shape === "number" ? [shape] : [...shape];
    return new ND(shape, new Float64Array(shape.reduce((a, b) => a * b, 1)).fill(value));
  };
  const array = (it, dtype) => {
    const found = it instanceof ND ? it : nd(it);
    return bare(dtype === lib.float && found.flags ? new ND(found.shape, found.re) : found);
  };
  const spread = (x, shape) => {
    const from = nd(x), at = py.places(from.shape, shape), take = list => list && Float64Array.from(at, k => list[k]);
    return new ND([...shape], take(from.re), take(from.im), from.flags);
  };
  const sorted = x => Float64Array.from(x).sort();
  const finite = x => nd(x).re.filter(y => !Number.isNaN(y));
  const reduced = name => named((x, axis) => nd(x)[name](axis), "x axis");
  const roots = p => {
    let list = [...nd(p).re];
    while (list.length && list[0] === 0) list = list.slice(1);
    let zeros = 0;
    while (list.length && list.at(-1) === 0) { list = list.slice(0, -1); zeros++; }
    const found = list.length > 3 ? together(list) : list.length === 3 ? quadratic(...list) : list.length === 2 ? [-list[1] / list[0]] : [];
    return nd([...found, ...range(zeros, () => 0)]);
  };
  const quadratic = (a, b, c) => {
    const inner = b * b - 4 * a * c;
    if (inner < 0) return [1, -1].map(sign => new Complex(-b / (2 * a), sign * Math.sqrt(-inner) / (2 * a)));
    const q = -(b + (b < 0 ? -1 : 1) * Math.sqrt(inner)) / 2;
    return [q / a, c / q];
  };
  // All roots at once, each from where the others are, by Durand and Kerner.
  const together = p => {
    const { add, sub, mul, div } = py, size = 1 + most(p, x => Math.abs(x / p[0])), start = new Complex(0.4, 0.9);
    let found = range(p.length - 1, k => mul(size, py.pow(start, k + 5)));
    for (let round = 0; round < 500; round++) found.forEach((x, k) => {
      const value = p.reduce((sum, c) => add(mul(sum, x), c), new Complex(0, 0));
      found[k] = sub(x, div(value, found.reduce((all, y, j) => j === k ? all : mul(all, sub(x, y)), new Complex(p[0], 0))));
    });
    return found;
  };
  // The characteristic polynomial, by Faddeev and LeVerrier.
  const characteristic = A => {
    const n = A.length, p = [1];
    let M = A.map(row => row.map(() => 0));
    for (let k = 1; k <= n; k++) {
      M = M.map((row, i) => row.map((_, j) => A[i].reduce((sum, a, m) => sum + a * M[m][j], 0) + (i === j ? p[k - 1] : 0)));
      p.push(-range(n).reduce((sum, i) => sum + A[i].reduce((all, a, m) => all + a * M[m][i], 0), 0) / k);
    }
    return p;
  };
  // Of curves, their real and imaginary parts, at x.
  const told = (x, curve, other) => {
    const re = each1(x, at => curve.at(at)), im = other && each1(x, at => other.at(at));
    return !im ? re : typeof re === "number" ? new Complex(re, im) : new ND(re.shape, re.re, im.re);
  };
  const angle = (z, deg = false) => {
    const of = (re, im) => Math.atan2(im, re) * (deg ? 180 / Math.PI : 1);
    return each1(z, x => of(x, 0), of, true);
  };
  const product = (A, b) => {
    const [rows, inner] = A.shape, wide = b.shape[1] ?? 1, out = new Float64Array(rows * wide), x = A.re, y = b.re;
    for (let k = 0; k < inner; k++) for (let i = 0; i < rows; i++) {
      const a = x[i * inner + k];
      for (let j = 0; j < wide; j++) out[i * wide + j] += a * y[k * wide + j];
    }
    return new ND(b.shape.length > 1 ? [rows, wide] : [rows], out);
  };
  py.matmul = (a, b) => product(nd(a), nd(b));
  const solved = (A, b) => {
    const n = A.shape[0], rows = A.tolist(), right = nd(b), wide = right.shape[1] ?? 1, x = right.re.slice();
    for (let k = 0; k < n; k++) {
      let best = k;
      for (let i = k + 1; i < n; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
      [rows[k], rows[best]] = [rows[best], rows[k]];
      for (let j = 0; j < wide; j++) [x[k * wide + j], x[best * wide + j]] = [x[best * wide + j], x[k * wide + j]];
      for (let i = k + 1; i < n; i++) {
        const share = rows[i][k] / rows[k][k];
        if (!share) continue;
        for (let j = k; j < n; j++) rows[i][j] -= share * rows[k][j];
        for (let j = 0; j < wide; j++) x[i * wide + j] -= share * x[k * wide + j];
      }
    }
    for (let i = n - 1; i >= 0; i--) for (let j = 0; j < wide; j++) {
      for (let k = i + 1; k < n; k++) x[i * wide + j] -= rows[i][k] * x[k * wide + j];
      x[i * wide + j] /= rows[i][i];
    }
    return new ND(right.shape, x);
  };
  return {
    sin: unary(Math.sin), cos: unary(Math.cos), log10: unary(Math.log10), sqrt: unary(Math.sqrt), log: unary(Math.log), sign: unary(Math.sign),
    square: unary(x => x * x), exp: unary(Math.exp, (re, im) => py.pair(Math.exp(re) * Math.cos(im), Math.exp(re) * Math.sin(im))),
    absolute: unary(Math.abs, Math.hypot, true), degrees: unary(math.degrees), radians: unary(math.radians), angle: named(angle, "z deg"),
    isfinite: flag(Number.isFinite), isnan: flag(Number.isNaN), isreal: x => each1(x, () => 1, (re, im) => +(im === 0), true, true),
    logical_not: x => each1(x, y => +!y, null, false, true), nan_to_num: unary(x => Number.isNaN(x) ? 0 : x), round: (x, digits) => each1(x, y => py.rounding(y, digits)),
    maximum: (a, b) => each(a, b, Math.max), minimum: (a, b) => each(a, b, Math.min), hypot: (a, b) => each(a, b, Math.hypot),
    arctan2: (a, b) => each(a, b, Math.atan2), clip: (x, low, high) => each(each(x, low, Math.max), high, Math.min),
    array: named(array, "it dtype"), asarray: named(array, "it dtype"), atleast_1d: x => { const y = nd(x); return y.shape.length ? y : y.reshape(1); },
    arange: (...ends) => { const [first, end] = ends.length > 1 ? ends : [0, ends[0]]; return nd(range(end - first, k => first + k)); },
    linspace: (a, b, n = 50) => typeof a === "number" && typeof b === "number" ? nd(linspace(a, b, n))
      : np.stack(range(n, k => py.add(py.mul(k, py.div(py.sub(b, a), n - 1)), a))), full: filled, zeros: shape => filled(shape, 0), ones: shape => filled(shape, 1),
    empty: shape => filled(shape, 0), full_like: (x, value) => filled(x.shape, value), geomspace: (a, b, n) => nd(geomspace(a, b, n)),
    concatenate: named(joined, "arrays axis"), stack: named((arrays, axis = 0) => joined(lists(arrays).map(x => grown(x, axis)), axis), "arrays axis"),
    vstack: arrays => joined(lists(arrays).map(x => x.shape.length < 2 ? grown(x, 0) : x)), hstack: arrays => joined(arrays, lists(arrays)[0].shape.length > 1 ? 1 : 0),
    column_stack: arrays => joined(lists(arrays).map(x => x.shape.length < 2 ? grown(x, 1) : x), 1), append: (a, b) => joined([nd(a).ravel(), nd(np.atleast_1d(b)).ravel()]),
    argsort: x => { const y = nd(x).re; return nd([...y.keys()].sort((a, b) => y[a] - y[b])); },
    repeat: named((x, n, axis) => { const from = nd(x); return py.item(from, axis === 1 ? new py.Key([new py.Slice(null, null, null), range(from.shape[1] * n, k => Math.floor(k / n))])
      : range(from.shape[0] * n, k => Math.floor(k / n))); }, "x n axis"),
    roll: (x, by) => { const n = x.size; return x.item(range(n, k => (((k - by) % n) + n) % n)); },
    outer: (a, b) => py.mul(grown(nd(a).ravel(), 1), nd(b).ravel()), diff: named(x => { const y = nd(x); return py.sub(y.item(new py.Slice(1, null, null)), y.item(new py.Slice(null, -1, null))); }, "x n axis"),
    where: (test, a, b) => { const shape = py.common([nd(test), nd(a), nd(b)].map(x => x.shape)), [t, p, q] = [test, a, b].map(x => spread(x, shape));
      return new ND(shape, t.re.map((x, k) => x ? p.re[k] : q.re[k])); },
    flatnonzero: x => nd(nd(x).set()), searchsorted: named((a, v) => each1(v, x => searchsorted(a.re, x)), "a v side"),
    sort: x => nd(sorted(nd(x).re)), unique: x => { const y = sorted(nd(x).re); return nd(y.filter((value, k) => !k || value !== y[k - 1])); }, isin: (x, among) => { const all = new Set(among); return each1(x, y => +all.has(y), null, false, true); },
    nanmin: x => -most(finite(x), y => -y), nanmax: x => most(finite(x)), array_split: (x, n) => { const size = x.length, wide = Math.floor(size / n), more = size % n;
      return range(n, k => { const first = k * wide + Math.min(k, more); return x.item(new py.Slice(first, first + wide + (k < more), null)); }); },
    broadcast_to: (x, shape) => spread(x, typeof shape === "number" ? [shape] : [...shape]), broadcast_arrays: (...arrays) => { const shape = py.common(arrays.map(x => nd(x).shape)); return arrays.map(x => spread(x, shape)); },
    argmax: x => nd(x).argmax(), argmin: x => nd(x).argmin(), max: reduced("max"), min: reduced("min"), sum: reduced("sum"), mean: reduced("mean"), any: reduced("any"), all: reduced("all"),
    ptp: x => nd(x).max() - nd(x).min(), eye: n => nd(range(n, i => range(n, j => +(i === j)))), told,
    lstsq: named((A, b, rcond) => { const flat = b.shape.length < 2, found = lstsq(A.tolist(), flat ? b.tolist().map(x => [x]) : b.tolist(), rcond); return [nd(flat ? found.flat() : found)]; }, "a b rcond"),
    eigvals: A => roots(characteristic(nd(A).tolist())), Polynomial: { fit: (x, y) => ({ called: at => told(at, ...[y.re, y.im].map(z => z && { at: through(x.re, z) })) }) }, cumsum: x => nd(x).cumsum(), roots, solve: (A, b) => solved(nd(A), b), interp: (x, xs, ys) => each1(x, at => {
      const k = Math.min(Math.max(searchsorted(xs.re, at), 1), xs.size - 1), share = (at - xs.re[k - 1]) / (xs.re[k] - xs.re[k - 1]);
      return at <= xs.re[0] ? ys.re[0] : at >= xs.re[xs.size - 1] ? ys.re[xs.size - 1] : ys.re[k - 1] + share * (ys.re[k] - ys.re[k - 1]); }),
    corrcoef: (a, b) => { const [p, q] = [a, b].map(x => py.sub(x, x.mean())), of = (x, y) => py.mul(x, y).sum();
      const c = of(p, q) / Math.sqrt(of(p, p) * of(q, q)); return nd([[1, c], [c, 1]]); },
    masked_invalid: x => x, ndarray: ND, delete: (x, k) => x.item(range(x.size).filter(n => n !== k)), cumprod: named((x, axis) => nd(x).cumprod(axis), "x axis"),
  };
})();

// Of Python's library, scipy and cosim. The worker's `machine` says what the modules have.
const heard = { lines: [], muted: 0 };
const lib = (() => {
  const { Dict, ND, nd, named, iter, call, truth } = py;
  const dict = (pairs = []) => new Dict(py.pairs(pairs));
  dict.words = (args, words) => new Dict([...dict(...args).items(), ...Object.entries(words)]);
  dict.fromkeys = (keys, value = null) => new Dict([...keys].map(key => [key, value]));
  const best = sign => {
    const found = (...args) => chosen(args.length > 1 ? args : [...iter(args[0])]);
    const chosen = (list, key, other) => {
      if (!list.length) return other === undefined ? py.fail("ValueError: of nothing") : other;
      const keys = key ? list.map(x => call(key, [x])) : list;
      let k = 0;
      keys.forEach((x, n) => { if (sign * py.order(x, keys[k]) > 0) k = n; });
      return list[k];
    };
    found.words = (args, { key, default: other }) => chosen(args.length > 1 ? args : [...iter(args[0])], key, other);
    return found;
  };
  const sorted = named((it, key, reverse) => {
    const list = [...iter(it)].map(x => [key ? call(key, [x]) : x, x]);
    list.sort(([a], [b]) => (reverse ? -1 : 1) * py.order(a, b));
    return list.map(([, x]) => x);
  }, "it key reverse");
  function* zip(...its) {
    const all = its.map(it => iter(it)[Symbol.iterator]());
    while (all.length) {
      const row = [];
      for (const one of all) { const { done, value } = one.next(); if (done) return; row.push(value); }
      yield row;
    }
  }
  function* enumerate(it, first = 0) { for (const one of iter(it)) yield [first++, one]; }
  function* map(f, ...its) { for (const row of zip(...its)) yield call(f, row); }
  function* filter(f, it) { for (const one of iter(it)) if (truth(f ? call(f, [one]) : one)) yield one; }
  function* count(first = 0, step = 1) { for (let k = 0; ; k++) yield first + k * step; }
  function* cycle(it) { const all = [...iter(it)]; for (;;) yield* all; }
  function* accumulate(it) { let sum = 0; for (const one of iter(it)) yield sum = py.add(sum, one); }
  function* pairwise(it) { let before; for (const one of iter(it)) { if (before !== undefined) yield [before, one]; before = one; } }
  const next = (it, other) => { if (other === undefined) return py.next(it); const { done, value } = it.next(); return done ? other : value; };
  function* islice(it, many) { for (it = iter(it)[Symbol.iterator](); many > 0; many--) { const { done, value } = it.next(); if (done) return; yield value; } }
  // Of a function of what is told by its words: it is asked once.
  const cache = f => {
    const known = new Dict();
    return Object.assign((...args) => { if (!known.has(args)) known.set(args, f(...args)); return known.item(args); }, { params: f.params });
  };
  const getattr = (it, name, other) => {
    const value = py.attribute(it, name) ?? other;
    return typeof value === "function" && !Object.hasOwn(it, name) ? Object.assign(value.bind(it), { params: value.params }) : value;
  };
  const brentq = named((f, low, high) => {
    for (const sign = Math.sign(call(f, [low])); ;) {
      const x = (low + high) / 2;
      if (x <= low || x >= high) return x;
      if (Math.sign(call(f, [x])) === sign) low = x; else high = x;
    }
  }, "f a b xtol");
  const partial = (f, ...args) => made(f, args, {});
  const made = (f, args, words) => Object.assign((...more) => call(f, [...args, ...more], words), { bound: { f, args, words } });
  partial.made = made;
  partial.words = ([f, ...args], words) => made(f, args, words);
  const isinstance = (it, kind) => [kind].flat().some(one => one === float ? typeof it === "number" : one === int
    ? Number.isInteger(it) : one === str ? typeof it === "string" : one === bool ? typeof it === "boolean"
    : one === list ? Array.isArray(it) || it instanceof py.Tuple : it instanceof (one === dict ? Dict : one));
  const float = x => x === "" ? NaN : typeof x === "string" ? Number(x) : x instanceof ND ? x.re[0] : +x;
  const int = x => Math.trunc(float(x)), str = x => py.said(x), bool = x => truth(x), list = it => it === undefined ? [] : [...iter(it)];
  const tops = { max: best(1), min: best(-1) };
  const round = (x, digits) => py.rounding(x, digits ?? 0);
  const abs = x => typeof x === "number" ? Math.abs(x) : np.absolute(x);
  const sum = (it, first = 0) => it instanceof ND ? it.sum(0) : [...iter(it)].reduce((a, b) => py.add(a, b), first);
  const fill = named((text, width) => {
    const lines = [];
    for (const word of text.split(/\s+/).filter(Boolean)) {
      if (lines.length && lines.at(-1).length + 1 + word.length <= width) lines.push(`${lines.pop()} ${word}`); else lines.push(word);
    }
    return lines.join("\n");
  }, "text width break_long_words");

  // scipy's spline, which is not-a-knot; a piecewise polynomial of any degree.
  class Piecewise {
    static fields = ["x", "y"];
    constructor(x, y) {
      if (y === undefined) return;
      this.of(Cubics.spline(nd(x).re, nd(y).re));
      if (nd(y).im) this.other = Cubics.spline(nd(x).re, nd(y).im);
    }
    of(cubics) { this.x = cubics.x; this.cubics = cubics; return this; }
    get c() { return this.cubics.parts.map(nd); }
    called(x) { return np.told(x, this.cubics, this.other); }
    derivative() { return Object.assign(new Piecewise().of(this.cubics.derivative()), { other: this.other?.derivative() }); }
    solve(level = 0, extrapolate = true) {
      if (extrapolate || this.other) py.fail("zeros beyond the ends of a spline, or of a complex one");
      return nd(Float64Array.from(this.cubics.roots(level)));
    }
    roots(discontinuity, extrapolate = true) { return this.solve(0, extrapolate); }
    get sums() {
      if (this.kept) return this.kept;
      if (this.other) py.fail("the integral of a complex spline");
      const all = new Float64Array(this.x.length);
      for (let k = 0; k < all.length - 1; k++) all[k + 1] = all[k] + this.under(k, this.x[k + 1]);
      return this.kept = all;
    }
    // The integral from a knot to x.
    under(k, x) {
      const [a, b, c, d] = this.cubics.parts.map(part => part[k]), s = x - this.x[k];
      return (((a * s / 4 + b / 3) * s + c / 2) * s + d) * s;
    }
    until(x) {
      const k = Math.min(Math.max(searchsorted(this.x, x) - 1, 0), this.x.length - 2);
      return this.sums[k] + this.under(k, x);
    }
    antiderivative() { return { called: x => py.each1(x, at => this.until(at)) }; }
    integrate(a, b) { return this.until(b) - this.until(a); }
  }
  Piecewise.prototype.solve.params = ["level", "extrapolate"];
  Piecewise.prototype.roots.params = ["discontinuity", "extrapolate"];

  class SetupError extends Raised {}
  class System extends py.Record {
    static fields = ["parts", "wires", "start"];
    constructor(parts, wires = [], start = new Dict()) { super(); Object.assign(this, { parts, wires: [...wires], start }); }
  }
  class Result {
    static fields = ["columns", "units", "provenance", "load"];
    constructor(columns, units, made, load) { Object.assign(this, { columns, units, made, load, kept: new Map() }); }
    get provenance() { return typeof this.made === "function" ? this.made = this.made() : this.made; }
    get data() { return this.whole ??= call(this.load, []); }
    item(name) {
      const k = this.columns.indexOf(name);
      if (k < 0) py.fail(`KeyError: ${name} was not recorded`);
      if (!this.kept.has(name)) this.kept.set(name, this.data.item(new py.Key([new py.Slice(null, null, null), k])));
      return this.kept.get(name);
    }
  }
  class Frame {
    constructor(columns) { this.columns = columns; }
    item(key) {
      if (typeof key === "string") return this.columns[key];
      if (Array.isArray(key)) return new Frame(Object.fromEntries(key.map(name => [name, this.columns[name]])));
      return new Frame(Object.fromEntries(Object.entries(this.columns).map(([name, x]) => [name, x.item(key)])));
    }
    to_numpy() { return np.column_stack(Object.values(this.columns)); }
  }
  ND.prototype.to_numpy = function() { return this; };
  class Table {
    static fields = ["frame", "units"];
    constructor(frame, units) { Object.assign(this, { frame, units }); }
    static of(result) { return new Table(null, result.units); }
    static of_rows(rows, units) {
      const names = [...units], all = [...iter(rows)].map(row => [...row]);
      const column = k => all.some(row => typeof row[k] === "string") ? all.map(row => row[k]) : nd(all.map(row => row[k]));
      return new Table(new Frame(Object.fromEntries(names.map((name, k) => [name, column(k)]))), units);
    }
  }

  const known = new Map();
  const network = system => {
    const parts = [...system.parts], key = JSON.stringify([parts, system.wires]);
    if (!known.has(key)) {
      const wires = system.wires.map(wire => {
        const [, from, factor, offset, to] = /^\s*(\S+)(?:\s*\*\s*(\S+))?(?:\s*\+\s*(\S+))?\s*[-=]>\s*(\S+)\s*$/.exec(wire) ?? py.fail(`the wire ${wire}`);
        return { from, to, factor: Number(factor ?? 1), offset: Number(offset ?? 0) };
      });
      const modules = Object.fromEntries(parts.map(part => [part, machine.modules[system.parts.item(part)]]));
      known.set(key, new Network(modules, wires, sequence(parts, wires)));
    }
    return known.get(key);
  };
  // The parts, each after those it hears: cosim.master.stepping_order.
  const sequence = (parts, wires) => {
    const of = end => parts.findIndex(part => end.startsWith(`${part}.`)), done = [];
    const arrows = wires.map(({ from, to }) => [of(from), of(to)]).filter(([a, b]) => a !== b);
    const free = k => arrows.every(([from, to]) => to !== k || done.includes(from));
    for (let declared = 0; done.length < parts.length;) {
      let k = range(parts.length).find(n => !done.includes(n) && free(n));
      if (k === undefined) { while (done.includes(declared)) declared++; k = declared; }
      done.push(k);
    }
    return done.map(k => parts[k]);
  };
  const begun = system => {
    const net = network(system);
    net.start(system.start.plain());
    return net;
  };
  const held = (net, part, name) => net.parts[part].get(name);
  const run = named((system, stop, step, algorithm = "strang", record = null) => {
    const net = begun(system), parts = [...system.parts], names = new Map(parts.map(part => [part, system.parts.item(part)]));
    const columns = record === null ? parts.flatMap(part => machine.outputs[names.get(part)].map(name => `${part}.${name}`)) : [...record];
    const rows = net.run(stop, step, algorithm, columns);
    if (!heard.muted) for (const line of net.heard()) if (!heard.lines.includes(line)) heard.lines.push(line);
    const all = ["time", ...columns];
    const units = new Dict(all.map(name => {
      const [part] = parts.filter(part => name.startsWith(`${part}.`));
      return [name, part ? machine.units[names.get(part)][name.slice(part.length + 1)] : "s"];
    }));
    const provenance = () => {
      begun(system);
      const values = part => new Dict(machine.parameters[names.get(part)].map(name => [name, held(net, part, name)]));
      return new Dict([["parts", new Dict(parts.map(part => [part, new Dict([["parameters", values(part)]])]))], ["convergence_order", machine.order],
        ["first_order", machine.late.filter(name => columns.includes(name))]]);
    };
    const result = new Result(all, units, provenance, () => np.column_stack(all.map(name => result.item(name))));
    for (const name of all) result.kept.set(name, nd(rows[name]));
    return result;
  }, "system stop step algorithm record csv progress");
  const parameters = (system, own = []) => {
    const net = begun(system), found = new Dict();
    for (const part of system.parts) for (const name of machine.parameters[system.parts.item(part)])
      if (!py.has(`${part}.${name}`, own)) found.set(`${part}.${name}`, { value: held(net, part, name) });
    return found;
  };

  class Bench {
    constructor() { this.fmus = new Dict(Object.keys(machine.modules).map(part => [part, part])); }
    certify(system, figures, o, record, csv) {
      const told = [], g = it => py.format(it, "g");
      let result = null, missing = "";
      for (const [k, coarser] of [4, 2, 1].entries()) {
        heard.muted += coarser > 1;
        machine.note(`run ${k + 1} of 3`);
        try {
          result = run(system, o.stop, coarser * o.step, o.algorithm, record);
        } catch (error) {
          if (!(error instanceof Failure) || coarser === 1) throw error;
          missing = `step = ${g(o.step)} s is too long to determine errors: a run with ${coarser} times the step, ` +
            `${g(coarser * o.step)} s, fails: ${error.message}`;
          continue;
        } finally {
          heard.muted -= coarser > 1;
        }
        told.push(call(figures, [result]));
      }
      if (missing) throw new Failure(missing);
      heard.muted++;
      const found = py.call(page.certified, [figures, result, told]);
      heard.muted--;
      return [result, found];
    }
    *each(f, cases, title, probes = false) {
      const all = [...iter(cases)];
      for (const [k, one] of all.entries()) {
        machine.note(`${title} ${k + 1} of ${all.length}`);
        heard.muted += probes;
        const found = call(f, [one]);
        heard.muted -= probes;
        yield found;
      }
    }
    kept(csv, units, rows) { return Table.of_rows(rows, units); }
  }
  Bench.prototype.each.params = ["function", "cases", "title", "probes"];
  const warns = { warning: text => { if (!heard.muted && !heard.lines.includes(text)) heard.lines.push(text); } };
  const replace = (it, words) => py.fail("replace takes names");
  replace.words = ([it], words) => it._replace(words);
  return {
    dict, list, tuple: list, float, int, str, bool, len: it => it instanceof Dict ? it.held.size : it instanceof Set ? it.size : it.length, ...tops, sorted, zip, enumerate, map, filter, count,
    cycle, accumulate, pairwise, next, iter: it => iter(it)[Symbol.iterator](), partial, isinstance, round, abs, sum, fill, range: (...ends) => {
      const [first, end, step] = ends.length > 1 ? ends : [0, ends[0]];
      return range(Math.max(0, Math.ceil((end - first) / (step ?? 1))), k => first + k * (step ?? 1));
    },
    any: it => [...iter(it)].some(truth), all: it => { for (const one of iter(it)) if (!truth(one)) return false; return true; }, slice: (...ends) => ends.length > 1
      ? new py.Slice(ends[0], ends[1], ends[2] ?? null) : new py.Slice(null, ends[0] ?? null, null), set: it => new Set(it ?? []), reversed: it => [...iter(it)].reverse(),
    type: it => it.constructor, getattr, islice, cache, brentq, StopIteration, SimulationError: Failure, harmonics: named((phi, x, highest = 8) => {
      const { shape } = x, columns = shape.length > 1 ? range(shape[1], k => x.column(k).re) : [x.re], out = new Float64Array(highest * columns.length), im = out.slice();
      harmonics(phi.re, columns, highest).forEach((orders, k) => orders.forEach(([a, b], n) => { out[n * columns.length + k] = a; im[n * columns.length + k] = b; }));
      return new ND([highest, ...shape.slice(1)], out, im);
    }, "phi x highest"), escape: text => text.replaceAll("&", "&amp;")
      .replaceAll("<", "&lt;").replaceAll(">", "&gt;").replaceAll('"', "&quot;").replaceAll("'", "&#x27;"), CubicSpline: Piecewise, SetupError, System, Result, Table,
    run, connect: system => begun(system) && null, parameters: named(parameters, "system own"), replace, getLogger: () => warns, write_ssp: () => null, Bench,
    contour_generator: () => py.fail("a live chart has no plane"), LineType: null, complex: (re, im = 0) => re instanceof py.Complex ? re : new py.Complex(re, im), Exception: Error, ValueError: Raised, KeyError: Raised, ArithmeticError: Raised,
  };
})();
