"use strict";
// The answer of a page whose Python was translated, as `workbench.ask` makes it.

const drawn = shown => [...shown.charts, ...shown.more].map(chart => py.plain(py.call(page.picture, [chart])));

function* answer({ options, asked }) {
  heard.lines = [];
  const o = py.call(page.Options, [], { ...options, start: new py.Dict(Object.entries(asked)) });
  const bench = new lib.Bench();
  let figures, data;
  if (page.solve) {
    let found = py.call(page.solve, [o, bench]);
    while (found.next) {
      const { done, value } = found.next();
      if (done) found = value; else yield { charts: drawn(py.call(value, [])) };
    }
    ({ figures, data } = found);
  } else [data, figures] = bench.certify(py.call(page.system, [o, bench.fmus]), r => py.call(page.figures, [o, r]), o, page.record);
  const known = { figures: {}, verdict: py.call(page.whole, [py.call(page.verdict, [o, figures, data]), figures]).split("\n"), warnings: [...heard.lines] };
  for (const [name, figure] of figures.items()) known.figures[name] = { ...figure, text: figure.text() };
  yield known;
  const shown = py.call(page.show, [o, figures, data]);
  yield { ...known, charts: drawn(shown) };
  yield { ...known, motions: shown.motions.map(one => py.plain(py.call(page.moving, [one]))), done: true };
}
