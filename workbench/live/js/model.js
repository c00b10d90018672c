// The model of a page: slider values become start values, runs, numbers and curves. `formulas` are the
// formulas of the page, in which v holds values by name.

// More rows than these are thinned before they are drawn.
const MOST = 2000;
// Points of a curve without numbers over a sweep, for a smooth line on a wide screen.
const FINE = 300;
// Frames of a motion.
const FRAMES = 480;

class Model {
  constructor(data, modules) {
    this.data = data;
    this.network = new Network(modules, data.wires, data.sequence);
  }

  // Values by name with sliders as they are: of options, start values, and what follows from them.
  values(sliders) {
    const v = { ...this.data.scope, ...this.data.user, ...sliders };
    for (const [name, k] of this.data.values) v[name] = formulas[k](v);
    v.stop ??= formulas[this.data.stop](v);
    v.step ??= formulas[this.data.step](v);
    return v;
  }

  // The rows of a run with values v, at `multiple` times its step.
  rows(v, run, sliders, multiple, { step, steady } = this.data) {
    const { base, start, columns, schedule, adapted } = this.data;
    const own = computed(run.start, v);
    const all = { ...v, ...own };
    const starts = computed(start, all);
    const wanted = Object.entries({ ...this.data.user, ...sliders });
    const user = wanted.filter(([name]) => name.includes(".") && !adapted.includes(name));
    for (const wire of this.network.wires) wire.factor = formulas[wire.formula](v);
    this.network.start({ ...base, ...starts, ...own, ...Object.fromEntries(user) });
    const h = multiple * formulas[step](all);
    const stop = formulas[this.data.stop](all);
    if (!steady) return new Run(this.network, h, schedule, stop).rows(columns);
    return this.settled(new Run(this.network, h, schedule), Math.ceil((2 * stop) / h), steady);
  }

  // Two revolutions, of about `steps`, after as many as it takes until columns repeat.
  settled(run, steps, { tolerance, longest }) {
    let before = null;
    const repeats = (x, k) => Math.abs(x - before[k]) <= tolerance * Math.abs(x);
    for (let turns = 2; ; turns += 2) {
      const rows = run.rows(this.data.columns, steps);
      const now = this.swings(rows);
      if ((before && now.every(repeats)) || turns >= longest) return rows;
      before = now;
    }
  }

  // How far the columns swing over the last revolution.
  swings(rows) {
    const { angle, columns } = this.data;
    const begin = revolution(rows.time, rows[angle]);
    if (Number.isNaN(begin)) throw new Failure(`${angle} does not grow by a revolution`);
    const others = columns.filter((name) => name !== angle);
    return others.map((name) => {
      const window = since({ t: rows.time, x: rows[name], angle: rows[angle] }, begin);
      return readers.max(window) - readers.min(window);
    });
  }

  // When a window begins; NaN for all rows.
  begin(rows, window, v, turn = this.data.angle) {
    if (window === "revolution") return revolution(rows.time, rows[turn]);
    return window === null ? NaN : formulas[window](v);
  }

  // A formula of columns in a window: { t, x, angle }; crank_angle is 0 where a revolution begins.
  column(rows, { formula, columns }, window, v, turn = this.data.angle) {
    const t = rows.time;
    const angle = rows[turn] ?? t;
    const zero = Number.isNaN(revolution(t, angle)) ? 0 : angle.at(-1) - TURN;
    const known = { time: t, crank_angle: angle.map((phi) => phi - zero), ...rows };
    const inputs = columns.map((name) => known[name]);
    const local = { ...v };
    const x = t.map((_, n) => {
      for (let k = 0; k < columns.length; k++) local[columns[k]] = inputs[k][n];
      return formulas[formula](local);
    });
    return since({ t, x, angle }, this.begin(rows, window, v, turn));
  }

  // Numbers by name; those that are not there are NaN. Adds them to v as figures.NAME.
  numbers(list, runs, v) {
    const numbers = {};
    for (const item of list) {
      const { name, value } = item;
      const isRead = typeof value === "object";
      numbers[name] = isRead ? this.number(value, runs[value.run], v) : +formulas[value](v);
      v[`figures.${name}`] = numbers[name];
    }
    for (const { name, when } of list) if (!formulas[when](v)) numbers[name] = NaN;
    return numbers;
  }

  number({ kind, column, window, angle, order, level }, rows, v) {
    const read = this.column(rows, column, window, v, angle);
    return readers[kind]({ ...read, order, level: formulas[level](v) });
  }

  // When rows end that are shown.
  end(rows, v) {
    const { until } = this.data;
    const end = until === null ? NaN : formulas[until](v);
    return end < rows.time.at(-1) ? end : rows.time.at(-1);
  }

  // The traces of a chart, each { x, y } or { level }, and the values of its marks.
  chart({ x, window, traces, marks }, runs, v) {
    const across = runs.map((rows) => this.column(rows, x, window, v));
    const drawn = traces.map((trace) => {
      if ("level" in trace) return { level: formulas[trace.level](v) };
      const rows = runs[trace.run];
      const y = this.column(rows, trace, window, v).x;
      const { t, x: abscissa } = across[trace.run];
      const end = this.end(rows, v);
      const picked = thinned(y.subarray(0, t.findIndex((now) => now >= end) + 1));
      return { x: picked.map((k) => abscissa[k]), y: picked.map((k) => y[k]) };
    });
    return { traces: drawn, marks: marks.map(({ value }) => formulas[value](v)) };
  }

  // The frames of a motion: their times, and of each run coordinates and captions.
  motion({ coordinates, captions, window }, runs, v) {
    const views = runs.map((rows) => {
      const begin = this.begin(rows, window, v);
      const { t } = since({ t: rows.time, x: rows.time, angle: rows.time }, begin);
      const frames = evenly(t, this.end(rows, v), FRAMES);
      const pick = (x) => frames.map((k) => x[k]);
      const coordinate = ({ column }) =>
        since({ t: rows.time, x: rows[column], angle: rows.time }, begin).x;
      return {
        times: pick(t).map((now) => now - t[0]),
        coordinates: coordinates.map((one) => pick(coordinate(one))),
        captions: captions.map(({ value }) => pick(this.column(rows, value, window, v).x)),
      };
    });
    return { times: views[0].times, runs: views };
  }

  // All of an answer but its sweep, at `multiple` times the step.
  answer(sliders, multiple) {
    const { runs, numbers, charts, motion } = this.data;
    const v = this.values(sliders);
    const warnings = [];
    const rows = runs.map((run) => {
      const recorded = this.rows(v, run, sliders, multiple);
      warnings.push(...this.network.warnings());
      return recorded;
    });
    return {
      numbers: this.numbers(numbers, rows, v),
      warnings: [...new Set(warnings)],
      charts: charts.map((chart) => this.chart(chart, rows, v)),
      motion: motion && this.motion(motion, rows, v),
    };
  }

  // A point of the sweep: values by name, its numbers among them.
  point(sliders, value) {
    const { over, numbers, ...settings } = this.data.sweep;
    const shifted = { ...sliders, [over]: value };
    const v = this.values(shifted);
    const rows = this.rows(v, this.data.runs[0], shifted, 1, settings);
    this.numbers(numbers, [rows], v);
    return v;
  }

  // The chart of a sweep from its points so far.
  curve(points, sliders) {
    const { over, values, chart } = this.data.sweep;
    const { traces, marks } = chart;
    const sorted = [...points].sort((a, b) => a[over] - b[over]);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const grid = Array.from({ length: FINE }, (_, k) => low + ((high - low) * k) / (FINE - 1));
    const smooth = grid.map((value) => this.values({ ...sliders, [over]: value }));
    const now = this.values(sliders);
    const drawn = traces.map((trace) => {
      if ("level" in trace) return { level: formulas[trace.level](now) };
      const all = trace.sweep ? sorted : smooth;
      return { x: all.map((v) => v[over]), y: all.map((v) => formulas[trace.formula](v)) };
    });
    return { traces: drawn, marks: marks.map(({ value }) => formulas[value](now)) };
  }
}

const computed = (pairs, v) => Object.fromEntries(pairs.map(([name, k]) => [name, formulas[k](v)]));

// At most MOST rows: the ends, and the smallest and largest of every stretch.
const thinned = (y) => {
  if (y.length <= MOST) return Array.from(y.keys());
  const rows = new Set([0, y.length - 1]);
  const stretch = (3 * y.length) / MOST;
  for (let begin = 0; begin < y.length; begin += stretch) {
    let [low, high, gap] = [];
    for (let k = Math.floor(begin); k < Math.min(y.length, begin + stretch); k++) {
      if (!Number.isFinite(y[k])) gap = k;
      else {
        if (!(y[k] >= y[low])) low = k;
        if (!(y[k] <= y[high])) high = k;
      }
    }
    for (const k of [low, high, gap]) if (k !== undefined) rows.add(k);
  }
  return [...rows].sort((a, b) => a - b);
};

// Rows at about even times up to an end, each once.
const evenly = (t, end, count) => {
  const rows = [];
  for (let k = 0, n = 0; n < count; n++) {
    const wanted = t[0] + ((end - t[0]) * n) / (count - 1);
    while (k < t.length - 1 && t[k + 1] <= wanted + 1e-12) k++;
    if (rows.at(-1) !== k) rows.push(k);
  }
  return rows;
};
