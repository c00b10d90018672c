"use strict";
// What orientator_cycle.py tells of a product, in a browser.

const ORIENTED = 4, FRAMES = 240;

function* answer({ options: o, start, asked, facts }, system) {
  const values = { ...start, "orientator.w": o.speed, "orientator.release": 1, "orientator.chute.mu": o.friction, ...asked };
  const stages = facts.stages.slice(0, ORIENTED), last = (rows, name) => rows[`orientator.${name}`].at(-1);
  const shown = ["xc", "yc", "phi1", "phi2"].map(name => `orientator.${name}`);
  const durations = stages.map(stage => `t_${stage}`), told = ["stage", "reason", "orientation_time"];
  const record = [...told, ...durations, ...Object.values(facts.impulses)].map(name => `orientator.${name}`);
  const ending = rows => {
    const stage = facts.stages[last(rows, "stage")], reason = last(rows, "reason");
    if (reason) return `the product jams: ${facts.reasons[reason]}`;
    return `the product is ${last(rows, "stage") === ORIENTED ? "" : "still in the stage "}${stage}`;
  };
  const figures = rows => {
    const of = (name, value, reached = true) => {
      const [unit, meaning] = facts.figures[name];
      return reached ? figure(value, unit, 0, meaning) : refused(unit, ending(rows), meaning);
    };
    const oriented = last(rows, "stage") === ORIENTED, found = { oriented: of("oriented", +oriented) };
    found.orientation_time = of("orientation_time", last(rows, "orientation_time"), oriented);
    for (const name of durations) found[name] = of(name, last(rows, name), last(rows, name) > 0);
    for (const [name, column] of Object.entries(facts.impulses)) found[name] = of(name, last(rows, column));
    return found;
  };
  const columns = [...new Set([...record, ...shown, ...facts.curves.map(curve => curve.column)])];
  const settings = { ...o, order: facts.order };
  const { rows, figures: f, warnings } = yield* certify(system, values, settings, columns, figures);

  const over = rows["orientator.stage"].findIndex(stage => stage >= ORIENTED), count = over < 0 ? rows.time.length : over + 1;
  const cut = name => Array.from(rows[name].subarray(0, count)), t = cut("time"), ms = t.map(x => 1e3 * x), stage = cut("orientator.stage");
  const begins = range(count - 2, k => k + 1).filter(k => stage[k] !== stage[k - 1]);
  const spans = [0, ...begins].map((k, n, all) => ({ first: ms[k], last: ms[all[n + 1] ?? count - 1], text: facts.stages[stage[k]],
    color: facts.colors[stage[k]] }));
  const curves = facts.curves.map(({ panel, column, name, scale }) => ({ panel, name, x: ms, y: cut(column).map(y => scale * y) }));
  const named = durations.filter(name => f[name].error !== null).map(name => `${name.slice(2)} ${text(f[name])}`);
  const end = ending(rows), after = f.oriented.value ? ` after ${text(f.orientation_time)}` : "";
  const course = named.length ? `Its stages: ${named.join(", ")}` : "None of its stages came to an end";
  yield { figures: f, warnings, charts: [{ curves, spans, marks: [] }], motion: moving(cut, t, stage, values, facts.stages),
    verdict: [`${end[0].toUpperCase()}${end.slice(1)}${after}. ${course}.`], done: true };
}

// Cup and catcher, as mechanism.py draws them: places are x - i y.
const moving = (cut, t, stage, p, names) => {
  const at = name => p[`orientator.${name}`], r = at("cup.d") / 2, front = at("cup.h") - at("cup.l"), back = -at("cup.l");
  const outline = [[back, r], ...linspace(-Math.PI / 2, Math.PI / 2, 25).map(a => [front + r * Math.cos(a), -r * Math.sin(a)]), [back, -r]];
  const [xc, yc, phi1, phi2] = ["xc", "yc", "phi1", "phi2"].map(name => cut(`orientator.${name}`));
  const turned = (place, angle) => mul(place, [Math.cos(angle), -Math.sin(angle)]);
  const rows = [...new Set(linspace(0, t.length - 1, Math.min(FRAMES, t.length)).map(Math.round))];
  return {
    time: rows.map(k => t[k]), captions: rows.map(k => `${t[k].toFixed(3)} s: ${names[stage[k]]}`),
    shapes: {
      cup: rows.map(k => outline.map(point => add([xc[k], -yc[k]], turned(point, phi2[k])))),
      catcher: rows.map(k => [[0, 0], [at("catcher.l"), 0], [at("catcher.l"), at("catcher.h")]].map(point => turned(point, phi1[k]))),
    },
  };
};
