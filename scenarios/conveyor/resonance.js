"use strict";
// What resonance.py and response.py tell of the drive, in a browser. Orbits come from the FMUs; the
// names are those of the Python.

const NONE = [NaN, NaN];
const RECORD = ["motor.tau", "conveyor.phi", "conveyor.w", "conveyor.f_rod", "conveyor.x"];
const COARSER = [1, 2, 4], ORDERS = { jacobi: 1, "gauss-seidel": 1, strang: 2 };
const FIELDS = { "motor.B": "B", "motor.T": "T", "conveyor.rotor.J": "theta1", "conveyor.crank.r": "r",
  "conveyor.trough.m": "m", "conveyor.spring.c": "c", "conveyor.trough.d": "d" };
const LAG = { meaning: "speed where the torque ripple lags its load by 90 deg", quantity: "torque", unit: "N.m", sort: "lag" };
const TORQUE = { meaning: "speed of the largest torque ripple", quantity: "torque", unit: "N.m", sort: "peak" };
const SPEED = { meaning: "speed of the largest speed ripple", quantity: "speed", unit: "rad/s", sort: "peak" };
const FROM = { meaning: "speed above which the torque ripple is too much", quantity: "torque", unit: "N.m", sort: "rise" };
const TO = { meaning: "speed below which the torque ripple is too much", quantity: "torque", unit: "N.m", sort: "fall" };
const MARKS = { nu_90: "90 deg lag", nu_peak_tau: "torque peak", nu_peak_w: "speed peak" };

// First-order theory: the formulas of theory.py.
class Machine {
  constructor(fields) {
    Object.assign(this, fields);
    const { B, T, theta1, m, r, d } = this;
    this.theta0 = theta1 + m * r ** 2 / 2;
    this.loadSlope = d * r ** 2 / 2;
    this.slope = B + this.loadSlope;
    this.J = this.theta0 + T * this.loadSlope;
    this.nuRes = Math.sqrt(this.slope / (this.theta0 * T)) / 2;
    this.zeta = this.J / (2 * Math.sqrt(this.slope * this.theta0 * T));
  }

  load(nu) {
    const half = this.r ** 2 / 2;
    return [half * (this.c - this.m * nu ** 2), half * this.d * nu];
  }

  ripple(quantity, nu) {
    const below = [this.slope - 4 * this.theta0 * this.T * nu ** 2, 2 * nu * this.J];
    const above = quantity === "torque" ? [this.B, 0] : [-1, -2 * this.T * nu];
    return div(mul(this.load(nu), above), below);
  }

  // The longest communication step that keeps the coupled oscillation from growing by itself [s].
  longestStep(algorithm) {
    const rate = ([[a, b], [c, d]]) => {
      const half = (a + d) / 2, inner = half ** 2 - (a * d - b * c);
      return inner < 0 ? Math.sqrt(half ** 2 - inner) : Math.abs(half) + Math.sqrt(inner);
    };
    const motor = h => { const e = Math.exp(-h / this.T); return [[1, 0], [-this.B * (1 - e), e]]; };
    const product = (A, B) => A.map(row => [0, 1].map(j => row[0] * B[0][j] + row[1] * B[1][j]));
    const growth = h => {
      const lost = this.loadSlope * h / this.theta0, share = lost ? -Math.expm1(-lost) / lost : 1;
      const conveyor = [[Math.exp(-lost), share * h / this.theta0], [0, 1]];
      if (algorithm === "jacobi") return rate([conveyor[0], motor(h)[1]]) - 1;
      if (algorithm === "gauss-seidel") return rate(product(conveyor, motor(h))) - 1;
      return rate(product(motor(h / 2), product(conveyor, motor(h / 2)))) - 1;
    };
    const steps = geomspace(1e-5, 1e2, 700).map(x => x / this.nuRes);
    const unstable = steps.findIndex(h => growth(h) > 0);
    if (unstable < 1) return Infinity;
    let [low, high] = [steps[unstable - 1], steps[unstable]];
    for (let k = 0; k < 60; k++) { const h = (low + high) / 2; if (growth(h) > 0) high = h; else low = h; }
    return high;
  }
}

// The motor at a mean speed: the slope of its line, and its start values. See drive.py.
class Drive {
  constructor(start) {
    this.start = start;
    this.base = Object.fromEntries(Object.entries(FIELDS).map(([name, field]) => [field, +start[name]]));
    this.induction = [1, "kloss"].includes(start["motor.characteristic"]);
  }

  kloss(nu) {
    const { start, base } = this, share = base.d * base.r ** 2 / 2 * nu / start["motor.kloss.tau_b"];
    if (share >= 1)
      throw new Failure(`motor.kloss.tau_b = ${start["motor.kloss.tau_b"]} N.m must be above the mean load torque at ${six(nu)} rad/s`);
    const b = start["motor.kloss.s_b"] * start["motor.kloss.w_s"];
    return { tau: start["motor.kloss.tau_b"], b, slip: b * share / (1 + Math.sqrt(1 - share ** 2)) };
  }

  machine(nu) {
    if (!this.induction) return this.linear ??= new Machine(this.base);
    const { tau, b, slip } = this.kloss(nu);
    return new Machine({ ...this.base, B: 2 * tau * b * (b ** 2 - slip ** 2) / (slip ** 2 + b ** 2) ** 2 });
  }

  values(nu) {
    const machine = this.machine(nu), { start } = this, fed = {};
    if (this.induction) {
      const { b, slip } = this.kloss(nu);
      Object.assign(fed, { "motor.kloss.w_s": nu + slip, "motor.kloss.s_b": b / (nu + slip) });
    } else Object.assign(fed, { "motor.A": machine.slope * nu });
    return { ...start, ...fed, "conveyor.phi": 0, "conveyor.w": nu + machine.ripple("speed", nu)[1],
      "motor.tau": machine.loadSlope * nu + machine.ripple("torque", nu)[1] };
  }
}

// The ripple of the last revolution of an orbit, and its rod forces: response.read.
const read = (turns, nu) => {
  const { rows, phi, ends, times } = turns;
  const ripples = [0, 1].map(back => {
    const [first, end] = turns.window(back), cut = values => values.subarray(first, end);
    const highest = Math.min(40, Math.floor((end - first) / 3));
    return harmonics(cut(phi), [cut(rows["motor.tau"]), cut(rows["conveyor.w"])], highest).map(orders => orders[1]);
  });
  const [torque, speed] = ripples[0];
  const [torqueError, speedError] = [0, 1].map(k => turns.remains(abs(sub(ripples[0][k], ripples[1][k]))));
  const [first, end] = turns.window(0), from = Math.max(0, first - 8), count = ends.length;
  const near = Array.from(phi.subarray(from, end + 8)), force = Array.from(rows["conveyor.f_rod"].subarray(from, end + 8));
  const edges = linspace(ends[count - 2], ends[count - 1], 17), forces = sectorTops(near, force, edges);
  const halves = [0, 1].map(k => sectorTops(...[near, force].map(x => x.filter((_, n) => n % 2 === k)), edges));
  const left = forces.map((top, n) => Math.max(...halves.map(half => Math.abs(half[n] - top))) / 4);
  return { nu, torque, speed, mean: TURN / (times[count - 1] - times[count - 2]), forces, torqueError, speedError, left };
};

const sectorTops = (phi, x, edges) => {
  const curve = Cubics.spline(phi, x), at = [...edges, ...curve.derivative().roots()].map(p => [p, curve.at(p)]);
  const inside = range(edges.length - 1, k => at.filter(([p]) => p >= edges[k] && p <= edges[k + 1]));
  return [1, -1].flatMap(sense => inside.map(points => most(points, ([, value]) => sense * value)));
};

const largestForce = orbits => {
  const peaks = orbits.flatMap(points => range(Math.min(...points.map(point => point.forces.length)), n => {
    const values = points.map(point => point.forces[n]), [value, error] = limit(values, 1);
    const reach = error === null ? 2 * (Math.max(...values) - Math.min(...values)) : error + 2 * points[0].left[n];
    return { value, reach: value + reach, unknown: error === null };
  }));
  const best = most(peaks, peak => peak.value);
  if (peaks.some(peak => peak.unknown && peak.reach >= best)) return [best, NaN];
  return [best, most(peaks, peak => peak.reach) - best];
};

class Lost extends Error {}

// Load over response along the speed, and the places on it: response.Line.
class Line {
  constructor(drive, first, end) {
    Object.assign(this, { drive, first, last: end, whole: geomspace(first, end, 8000) });
    this.loads = most(this.whole, nu => abs(this.load(nu)));
    this.sense = this.ideal(LAG, first)[0] >= this.ideal(LAG, end)[0] ? 1 : -1;
  }

  load(nu) { return this.drive.machine(nu).load(nu); }
  ideal(place, nu) { return div(this.load(nu), this.drive.machine(nu).ripple(place.quantity, nu)); }

  curve(place, known) {
    if (!known.length) return nu => this.ideal(place, nu);
    const problem = known.find(point => point.problem);
    if (problem) throw new Lost(problem.problem);
    const x = known.map(point => point.nu);
    const beside = known.map(point => sub(div(this.load(point.nu), point[place.quantity]), this.ideal(place, point.nu)));
    const [re, im] = [0, 1].map(k => {
      const y = beside.map(value => value[k]);
      if (x.length <= 6) return through(x, y);
      const spline = Cubics.spline(x, y);
      return nu => spline.at(nu);
    });
    return nu => add(this.ideal(place, nu), [re(nu), im(nu)]);
  }

  zeros(place, curve, x) {
    const inverse = x.map(curve);
    const y = inverse.map((value, k) => place.sort === "lag" ? this.sense * value[0] / abs(value)
      : (place.sort === "rise" ? -1 : 1) * Math.log(abs(this.load(x[k])) / abs(value) / (place.level ?? 1)));
    const spline = Cubics.spline(x, y), condition = place.sort === "peak" ? spline.derivative() : spline;
    const bend = condition.derivative();
    const found = condition.roots().filter(at => bend.at(at) < 0)
      .map(at => ({ x: at, height: abs(this.load(at)) / abs(curve(at)), bend: bend.at(at) }));
    return { found, condition };
  }

  expected(place, known = []) {
    if (place.near !== undefined) return place.near;
    const curve = this.curve(place, known), { found } = this.zeros(place, curve, this.whole);
    if (place.sort === "peak") {
      const top = found.reduce((best, zero) => zero.height > best.height ? zero : best, { height: 0 });
      if (top.height < most([this.first, this.last], nu => abs(this.load(nu)) / abs(curve(nu))))
        throw new Lost("it is largest at an end of the sweep");
      return top.x;
    }
    const [behind] = found.filter(zero => curve(zero.x)[1] > 0);
    if (!behind) throw new Lost("no speed of the sweep has it");
    if (abs(this.load(behind.x)) < 0.02 * this.loads)
      throw new Lost("the load ripple nearly vanishes there, and its phase means nothing");
    return behind.x;
  }

  edges(level, known) {
    const curve = this.curve(TORQUE, known);
    return [FROM, TO].map(end => ({ ...end, level }))
      .flatMap(end => this.zeros(end, curve, this.whole).found.map(zero => ({ ...end, near: zero.x })))
      .sort((a, b) => a.near - b.near);
  }

  get spacing() {
    if (this.space) return this.space;
    let x = Math.sqrt(this.first * this.last);
    try { x = this.expected(LAG); } catch (lost) { if (!(lost instanceof Lost)) throw lost; }
    const [machine, beside] = [this.drive.machine(x), this.drive.machine(1.001 * x)];
    const moved = Math.abs(Math.log(beside.nuRes / machine.nuRes * x / (1.001 * x))) / 0.001;
    return this.space = x * Math.min(0.25 * machine.zeta / Math.max(moved, 1e-9), 0.05);
  }

  fitted(place, known) {
    const x = known.map(point => point.nu), middle = (Math.min(...x) + Math.max(...x)) / 2;
    const reach = 0.75 * (Math.max(...x) - Math.min(...x)), fine = linspace(middle - reach, middle + reach, 601);
    const { found, condition } = this.zeros(place, this.curve(place, known), fine);
    const nowhere = { x: condition.at(middle) > 0 ? last(fine) : fine[0], height: NaN };
    return found.reduce((best, zero) =>
      !best || Math.abs(zero.x - middle) < Math.abs(best.x - middle) ? zero : best, null) ?? nowhere;
  }
}

// A place and the height there: response.search. Its orbits come from `orbit`, a generator.
function* search(line, place, known, orbit) {
  if (known.length < 2) throw new Lost("the sweep holds no two steady orbits");
  const start = line.expected(place, known), { spacing } = line;
  let center = Math.round(start / spacing);
  for (let round = 0; round < 8; round++) {
    if (center < 3) throw new Lost("it lies at standstill");
    const near = [];
    for (const k of [-2, -1, 0, 1, 2]) near.push(yield* orbit((center + k) * spacing));
    const rough = line.fitted(place, near);
    if (isNaN(rough.height) || Math.abs(rough.x / spacing - center) > 0.75) {
      center = Math.round(rough.x / spacing);
      continue;
    }
    const off = rough.x / spacing - Math.round(rough.x / spacing);
    const point = yield* orbit(Math.abs(off) > 0.1 ? rough.x : rough.x + (0.5 - off) * spacing);
    const { x, height, bend } = line.fitted(place, [...near, point]);
    if (isNaN(height)) continue;
    const noise = point[`${place.quantity}Error`], unsure = Math.abs(noise / abs(point[place.quantity]) / bend);
    const xError = Math.abs(x - rough.x) + (place.sort === "peak" ? unsure / spacing : unsure);
    return [[x, xError], [height, Math.abs(height - rough.height) + noise]];
  }
  throw new Lost("it does not stand still");
}

const converged = (runs, order, unit, meaning) => {
  const lost = runs.find(run => typeof run === "string");
  if (lost) return refused(unit, lost, meaning);
  const [value, error, reason] = limit(runs.map(run => run[0]), order);
  if (error === null) return refused(unit, reason, meaning);
  return figure(value, unit, error + 2 * most(runs, run => run[1]), meaning);
};

const complexLimit = (values, order) => {
  const parts = [0, 1].map(k => limit(values.map(value => value[k]), order));
  return [parts.map(part => part[0]), Math.hypot(...parts.map(part => part[1] ?? NaN))];
};

const row = (drive, points, order) => {
  const [{ nu }] = points;
  const told = {};
  for (const [name, quantity] of [["w2", "speed"], ["tau2", "torque"]]) {
    const [whole, error] = complexLimit(points.map(point => point[quantity]), order);
    told[name] = { whole, size: abs(whole), error: error + 2 * points[0][`${quantity}Error`] };
  }
  const { w2, tau2 } = told, lag = turned(degrees(drive.machine(nu).load(nu)) - degrees(tau2.whole));
  return { nu, w2: w2.size, w2_error: w2.error, tau2: tau2.size, tau2_error: tau2.error, lag,
    lag_error: tau2.error / tau2.size * 180 / Math.PI };
};

// Yields nothing for a breath, or what is known so far.
function* answer({ options: o, start, facts }, system) {
  const operating = o.speed ?? facts.speed, { speeds, rated } = facts, level = o.limit / 100 * rated;
  const drive = new Drive({ ...start, ...facts.kloss }), line = new Line(drive, speeds[0], last(speeds)), order = ORDERS[o.algorithm];
  const wanted = [...new Set([...speeds, operating])].sort((a, b) => a - b), known = new Map();
  const unstable = (nu, coarser) => {
    const machine = drive.machine(nu), steps = Math.floor(o.steps_per_rev / coarser);
    const longest = machine.longest ??= machine.longestStep(o.algorithm), least = TURN / (nu * longest);
    if (steps < 18) return `${steps} steps per revolution must be at least 18`;
    if (steps <= least)
      return `${steps} steps per revolution are unstable with ${o.algorithm} at ${six(nu)} rad/s: its limit there is ${least.toFixed(2)}`
        + ` (a step of ${six(longest, 3)} s)`;
    return "";
  };
  for (const nu of drive.induction ? wanted : wanted.slice(0, 1)) if (unstable(nu, 1)) throw new Failure(unstable(nu, 1));
  const coarser = unstable(wanted[0], 4) ? [1] : COARSER;
  const orbit = function* (nu, k) {
    const key = `${nu} ${k}`;
    if (known.has(key)) return known.get(key);
    const values = drive.values(nu), steps = Math.floor(o.steps_per_rev / k);
    const states = { "conveyor.w": values["conveyor.w"], "motor.tau": values["motor.tau"] };
    let point;
    try {
      const turns = yield* steady(system, values, states, "conveyor.phi", nu, steps, RECORD, o.algorithm);
      point = read(turns, nu);
      if (nu === operating && k === 1) point.turns = turns;
    } catch (failure) {
      if (!(failure instanceof Failure)) throw failure;
      point = { nu, problem: failure.message, torque: NONE, speed: NONE, forces: [NaN], torqueError: NaN, speedError: NaN, left: [NaN] };
    }
    known.set(key, point);
    return point;
  };
  const runs = new Map(wanted.map(nu => [nu, []]));
  for (const k of [...coarser].reverse()) {
    for (const nu of wanted) runs.get(nu).unshift(yield* orbit(nu, k));
    if (k > 1 && k === last(coarser)) {
      const rough = new Map(wanted.map(nu => [nu, row(drive, runs.get(nu).slice(0, 1), order)]));
      yield { note: `first curve, ${Math.floor(o.steps_per_rev / k)} steps per revolution, no error yet`,
        charts: [chart(drive, speeds.map(nu => rough.get(nu)), {}, operating, [])] };
    }
  }
  const rows = new Map(wanted.map(nu => [nu, row(drive, runs.get(nu), order)])), { tau2, tau2_error } = rows.get(operating);
  const figures = {}, machine = drive.machine(drive.machine(speeds[Math.floor(speeds.length / 2)]).nuRes);
  figures.nu_res = figure(machine.nuRes, "rad/s", 0, "resonance by formula (22)");
  figures.zeta = figure(machine.zeta, "1", 0, "damping ratio by formula");
  const problems = [...runs.values()].flat().filter(point => point.problem);
  const warnings = [...new Map(problems.map(({ nu, problem }) => [nu, problem]))]
    .map(([nu, problem]) => `No steady orbit at ${six(nu)} rad/s: ${problem}`);
  const told = (value, error, unit, meaning, nu) => isNaN(value)
    ? refused(unit, `there is no steady orbit at ${six(nu)} rad/s`, meaning)
    : isNaN(error) ? refused(unit, "the coupling error is not known; take more steps per revolution", meaning)
      : figure(value, unit, error, meaning);
  figures.tau2_operating = told(tau2, tau2_error, "N.m", "torque ripple at the operating speed", operating);
  const force = largestForce(speeds.map(nu => runs.get(nu))), standing = problems.find(({ nu }) => speeds.includes(nu))?.nu;
  figures.f_rod_peak = told(...force, "N", "largest rod force of the sweep", standing ?? speeds[0]);
  const sweep = speeds.map(nu => rows.get(nu)), { turns } = runs.get(operating)[0];
  yield { note: "whole sweep, places to come", figures: { ...figures }, motion: turns && revolution(turns) };

  const steadyOnes = speeds.map(nu => runs.get(nu)[0]).filter(point => !point.problem);
  const passed = steadyOnes.length > 1 ? line.edges(level, steadyOnes) : [], above = steadyOnes.some(p => abs(p.torque) > level);
  const ends = [];
  for (const [name, place, height] of [["nu_90", LAG], ["nu_peak_tau", TORQUE, "tau2_peak"], ["nu_peak_w", SPEED, "w2_peak"],
    ...passed.map(place => ["", place])]) {
    const found = [];
    for (const k of coarser) {
      try {
        found.push(yield* search(line, place, steadyOnes, nu => orbit(nu, k)));
      } catch (lost) {
        if (!(lost instanceof Lost)) throw lost;
        found.push([lost.message, lost.message]);
      }
    }
    const where = converged(found.map(run => run[0]), order, "rad/s", place.meaning);
    if (name) figures[name] = where; else ends.push({ place, figure: where });
    if (height) figures[height] = converged(found.map(run => run[1]), order, place.unit, `${place.quantity} ripple there, order 2`);
  }
  ends.forEach(({ place, figure }, n) => {
    const k = n + (ends[0].place.sort === "fall"), name = place.sort === "rise" ? "avoid_from" : "avoid_to";
    figures[k > 1 ? `${name}_${Math.floor(k / 2) + 1}` : name] = figure;
  });
  const limits = ends.map(({ place, figure }) => figure.error === null ? place.near : figure.value);
  if (ends.length ? ends[0].place.sort === "fall" : above) limits.unshift(line.first);
  if (limits.length % 2) limits.push(line.last);
  const avoid = range(limits.length / 2, k => limits.slice(2 * k, 2 * k + 2));
  yield { figures, verdict: verdict(figures, { operating, level, rated, ends, avoid, line, sweep }),
    charts: [chart(drive, sweep, figures, operating, avoid)], warnings, done: true };
}

const verdict = (f, { operating, level, rated, ends, avoid, line, sweep }) => {
  const ripple = f.tau2_operating, resonance = f.nu_90, formula = f.nu_res.value, away = resonance.value / operating - 1;
  const at = `the operating speed of ${six(operating)} rad/s (${(operating * 30 / Math.PI).toFixed(0)} rpm)`;
  let said = ripple.error === null ? `Whether ${at} is on it is not told: ${ripple.reason}`
    : `${ripple.value > level ? "Yes" : "No"}: at ${at} the torque ripple is ${text(ripple)}, ${(100 * ripple.value / rated).toFixed(0)}% `
      + `of the rated torque; the limit is ${six(level)} N.m`;
  if (Math.abs(away) < 5e-4) said += `, and the resonance is there, at ${text(resonance)}`;
  else if (resonance.error !== null)
    said += `, and the resonance at ${text(resonance)} is ${(100 * Math.abs(away)).toFixed(1)}% ${away > 0 ? "above" : "below"} that speed`;
  const lines = [`${said}.`];
  if (ends.length) {
    const words = ends.map(({ place, figure }, k) => {
      const where = figure.error === null ? `about ${six(Number(place.near.toPrecision(2)))} rad/s` : text(figure), inner = k < ends.length - 1;
      return place.sort === "rise" ? `${inner ? "from" : "above"} ${where}` : `${k ? "to" : "below"} ${where}${inner ? " and" : ""}`;
    });
    const why = ends.find(({ figure }) => figure.error === null);
    lines.push(`Avoid speeds ${words.join(" ")}, where the torque ripple is above the limit`
      + `${why ? `; their error is not told: ${why.figure.reason}` : ""}.`);
  } else if (avoid.length) lines.push("The torque ripple is above the limit at every speed of the sweep.");
  else if (!sweep.every(point => isNaN(point.tau2))) lines.push("The torque ripple stays below the limit at every speed of the sweep.");
  if (resonance.error === null) lines.push(`No 90 degree lag of the torque ripple is told: ${resonance.reason}.`);
  if (formula < line.first || formula > line.last)
    lines[lines.length - 1] += ` The sweep from ${six(line.first)} to ${six(line.last)} rad/s does not hold the ${formula.toFixed(3)} rad/s of formula (22).`;
  return lines;
};

const chart = (drive, rows, figures, operating, avoid) => {
  const nu = linspace(rows[0].nu, last(rows).nu, 400), x = rows.map(one => one.nu);
  const theory = [at => abs(drive.machine(at).ripple("torque", at)), at => abs(drive.machine(at).ripple("speed", at)),
    at => turned(degrees(div(drive.machine(at).load(at), drive.machine(at).ripple("torque", at))))];
  const curves = ["tau2", "w2", "lag"].flatMap((name, k) => [
    { panel: k + 1, name: "first-order theory", x: nu, y: nu.map(theory[k]) },
    { panel: k + 1, name: "co-simulation", x, y: rows.map(one => one[name]), error: rows.map(one => one[`${name}_error`] ?? NaN) },
  ]);
  const formula = drive.machine(operating).nuRes;
  const marks = [{ at: formula, text: `formula ${formula.toFixed(2)} rad/s` },
    ...Object.entries(MARKS).filter(([name]) => Number.isFinite(figures[name]?.value))
      .map(([name, words]) => ({ at: figures[name].value, text: `${words} ${text(figures[name])}` })),
    { at: operating, text: `operating speed ${six(operating)} rad/s` }];
  return { curves, marks, spans: avoid.map(([first, end]) => ({ first, last: end, text: "avoid", color: "#c8500a" })) };
};

// The last revolution over time: its angle, and a caption for each of its rows.
const revolution = ({ rows, phi, ends }) => {
  const count = ends.length, first = searchsorted(phi, ends[count - 2]), end = searchsorted(phi, ends[count - 1]) + 1;
  const cut = values => Array.from(values.subarray(first, end)), t = cut(rows.time);
  const [tau, w, x] = ["motor.tau", "conveyor.w", "conveyor.x"].map(name => cut(rows[name]));
  return { angle: cut(phi).map(x => x - ends[count - 2]), time: t.map(x => x - t[0]),
    captions: t.map((at, k) => `${(at - t[0]).toFixed(3)} s: ${w[k].toFixed(1)} rad/s, ${(1e3 * x[k]).toFixed(2)} mm, ${tau[k].toFixed(0)} N.m`) };
};
