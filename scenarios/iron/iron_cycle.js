"use strict";
// What iron_cycle.py and drive.py tell of the sealing iron, in a browser.

function* answer({ options: o, start, asked, facts }, system) {
  const at = speed => ({ ...start, ...asked, ...facts.own, "iron.w_cam": speed }), ratio = start["iron.reducer.i_g"];
  const shown = ["iron.phi", "iron.motion", "iron.lift", "iron.E_friction"], forces = Object.values(facts.letsGo).map(([column]) => column);
  const columns = [...new Set([...shown, ...forces, ...facts.curves.map(curve => curve.column)])];
  const cut = (rows, name) => Array.from(rows[name]), angle = rows => cut(rows, "iron.phi").map(x => x * 180 / Math.PI);
  const of = (name, { value, error }) => {
    const [unit, meaning] = facts.figures[name] ?? ["deg", ""];
    return figure(value, unit, error, meaning);
  };
  const figures = rows => {
    const phi = angle(rows), torque = cut(rows, "iron.tau_cam"), low = smallest(phi, torque), high = largest(phi, torque);
    const found = {
      tau_cam_min: low, tau_cam_min_angle: low.at, tau_cam_max: high, tau_cam_max_angle: high.at,
      tau_motor_max: largest(phi, torque.map(x => Math.abs(x) / ratio)), stroke: largest(phi, cut(rows, "iron.lift")),
      friction_work: { value: last(rows["iron.E_friction"]), error: 0 }, work: integral(cut(rows, "iron.phi"), torque),
    };
    for (const [name, [column]] of Object.entries(facts.letsGo)) {
      found[`${name}_force_min`] = smallest(phi, cut(rows, column));
      found[`${name}_force_max`] = largest(phi, cut(rows, column));
    }
    return Object.fromEntries(Object.entries(found).map(([name, told]) => [name, of(name, told)]));
  };
  const stop = TURN / o.speed, settings = { stop, step: stop / o.samples, algorithm: "strang", order: facts.order };
  const { rows, figures: f, warnings } = yield* certify(system, at(o.speed), settings, columns, figures);
  f.cycles = of("cycles", { value: o.speed * 30 / Math.PI, error: 0 });

  const turns = [];
  for (const speed of [1, 2]) {
    const h = TURN / (speed * 1440);
    system.start(at(speed));
    turns.push(system.run(1440 * h, h, "strang", ["iron.phi", ...forces]));
    warnings.push(...system.heard().filter(line => !warnings.includes(line)));
    yield;
  }
  const [slow, fast] = turns, phi = angle(slow), limits = [];
  for (const [name, [column, event]] of Object.entries(facts.letsGo)) {
    const rising = cut(slow, column).map((x, k) => (fast[column][k] - x) / 3), still = cut(slow, column).map((x, k) => x - rising[k]);
    f[`${name}_limit`] = of(`${name}_limit`, { value: 0, error: 0 });
    if (Math.min(...still) > 0) {
      const top = largest(phi, rising.map((x, k) => -x / still[k])), w = top.value ** -0.5;
      f[`${name}_limit`] = of(`${name}_limit`, { value: w, error: w * top.error / (2 * top.value) });
      f[`${name}_limit_angle`] = of(`${name}_limit_angle`, top.at);
    }
    limits.push([f[`${name}_limit`], event]);
  }
  const [limit, event] = limits.reduce((first, next) => next[0].value < first[0].value ? next : first);
  const share = 100 * o.speed / limit.value;
  f.share = limit.value ? of("share", { value: share, error: share * limit.error / limit.value })
    : refused("%", "the first limit is 0", facts.figures.share[1]);
  const safe = o.speed < limit.value ? `is safe: it is ${text(f.share)} of ${text(limit)}, where ${event}`
    : `is NOT possible: ${event} at ${text(limit)} already`;

  const x = angle(rows), t = cut(rows, "time"), lift = rows["iron.lift"];
  yield {
    figures: f, warnings, done: true,
    verdict: [`${six(o.speed, 5)} rad/s (${text(f.cycles, "cycles/min")}) ${safe}. The cam's shaft carries between `
      + `${text(f.tau_cam_min)} and ${text(f.tau_cam_max)}, the motor up to ${text(f.tau_motor_max)}, the chain up to `
      + `${text(f.run_force_max)}, and the cam presses its follower with up to ${text(f.follower_force_max)}.`],
    charts: [{ marks: [], spans: facts.spans,
      curves: facts.curves.map(({ panel, column, name, scale }) => ({ panel, name, x, y: cut(rows, column).map(y => scale * y) })) }],
    motion: { angle: cut(rows, "iron.phi"), time: t, captions: t.map((now, k) => `${now.toFixed(3)} s: cam ${turned(x[k]).toFixed(1)} deg, `
      + `iron ${facts.phases[rows["iron.motion"][k]]}, lift ${(1e3 * lift[k]).toFixed(1)} mm`) },
  };
}
