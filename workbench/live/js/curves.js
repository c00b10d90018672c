// Curves: plotly's traces and layouts as Python made them, filled with rows. Uses `small` and `element`
// of the page.

const GREY = "#76828c";
// The share of an axis that stays free beside its values.
const ROOM = 0.05;
// Pixels between a mark and its text, and the heights of a line of a mark and of a name.
const SHIFT = 4;
const LINE = 18.7;
const NAME = 13.75;

// Places from 0 to 1 near the wanted ones, so far apart that no two of these sizes meet, as `labels.py` has them.
const apart = (wanted, sizes) => {
  const order = [...wanted.keys()].sort((a, b) => wanted[a] - wanted[b]);
  const places = [];
  let edge = 0;
  for (const k of order) {
    places[k] = Math.max(wanted[k], edge + sizes[k] / 2);
    edge = places[k] + sizes[k] / 2;
  }
  edge = Math.max(
    1,
    sizes.reduce((sum, size) => sum + size, 0),
  );
  for (const k of order.reverse()) {
    places[k] = Math.min(places[k], edge - sizes[k] / 2);
    edge = places[k] - sizes[k] / 2;
  }
  return places;
};

// A range that shows values.
const ranged = (values) => {
  const seen = values.filter(Number.isFinite);
  const [low, high] = [Math.min(...seen), Math.max(...seen)];
  const room = ROOM * (high - low) || Math.abs(high) || 1;
  return seen.length ? [low - room, high + room] : [0, 1];
};

// A chart that draws { traces, marks } again and again, the first of all in grey below.
const charted = (place, { picture, includes, marks, title }) => {
  const original = { traces: null };
  let last = null;
  const draw = (screen) => {
    const layout = structuredClone(picture[screen]);
    const xs = last.traces.flatMap(({ x }) => x ?? []);
    const [first, end] = [Math.min(...xs), Math.max(...xs)];
    const filled = last.traces.map((trace, k) => {
      const flat = "level" in trace;
      const data = flat ? { x: [first, end], y: [trace.level, trace.level] } : trace;
      return { ...picture.data[k], ...data };
    });
    const isMoved = original.traces && original.traces !== last.traces;
    const old = isMoved ? filled.map(grey).filter(Boolean) : [];
    const plot = layout.height - layout.margin.b;
    for (const [key, axis] of Object.entries(layout)) {
      if (/^xaxis/.test(key)) axis.range = [first, end];
      if (!/^yaxis/.test(key)) continue;
      const row = `y${key.slice(5)}`;
      const own = [...old, ...filled].filter(({ yaxis }) => yaxis === row);
      axis.range = ranged([...own.flatMap(({ y }) => y), ...includes[key.slice(5) - 1]]);
      const now = filled.filter(({ yaxis }) => yaxis === row);
      name(layout, row, now, axis.range, plot * (axis.domain[1] - axis.domain[0]));
    }
    mark(layout, first, end, plot);
    place.style.height = `${layout.height}px`;
    const data = [...old, ...filled];
    const options = { responsive: true, displayModeBar: false };
    return Plotly.react(place, data, { ...layout, dragmode: false }, options);
  };
  const grey = (trace, k) => {
    const before = original.traces[k];
    if ("level" in before) return null;
    const { line, marker } = trace;
    const quiet = { opacity: 0.5, hoverinfo: "skip", hovertemplate: null };
    const color = { line: { ...line, color: GREY }, marker: { ...marker, color: GREY } };
    return { ...trace, ...before, ...quiet, ...color, legendgroup: "original" };
  };
  // Names move to the ends of their curves.
  const name = (layout, row, traces, [low, high], height) => {
    const notes = layout.annotations.filter((note) => note.name && note.yref === `${row} domain`);
    const ends = notes.map((note) =>
      traces.find((trace) => trace.name === note.name).y.findLast(Number.isFinite),
    );
    const wanted = ends.map((y = low) => (high - y) / (high - low));
    const sizes = notes.map(({ text }) => (NAME * text.split("<br>").length) / height);
    apart(wanted, sizes).forEach((share, k) => {
      notes[k].y = 1 - share;
    });
  };
  // Marks move to their values; one beyond the axis is not drawn.
  const mark = (layout, first, end, plot) => {
    const rows = Object.keys(layout).filter((key) => /^yaxis/.test(key));
    layout.shapes = [];
    layout.annotations = layout.annotations.flatMap((note) => {
      if (note.name) return [note];
      const k = marks.findIndex(({ text }) => text === note.text);
      const value = last.marks[k];
      if (!(value >= first && value <= end)) return [];
      const share = (value - first) / (end - first);
      const line = { color: GREY, dash: "dot", width: 1.2 };
      for (const key of rows) {
        const yref = `y${key.slice(5)} domain`;
        const [foot, top] = layout[key].domain;
        const y1 = key === "yaxis1" ? 1 + (note.yshift + 0.8 * LINE) / (plot * (top - foot)) : 1;
        layout.shapes.push({ type: "line", yref, y0: 0, y1, x0: value, x1: value, line });
      }
      const xanchor = share < 0.5 ? "left" : "right";
      const text = `${note.text} ${shown(value, 4)} ${marks[k].unit}`;
      const xshift = share < 0.5 ? SHIFT : -SHIFT;
      return [{ ...note, text, x: value, xanchor, xshift }];
    });
  };
  const screen = () => (small.matches ? "narrow" : "wide");
  small.addEventListener("change", () => last && draw(screen()));
  addEventListener("beforeprint", () => last && draw("paper"));
  addEventListener("afterprint", () => last && draw(screen()));
  place.setAttribute("aria-label", `${title}: live curves, the original ones in grey`);
  return (next, isOriginal) => {
    if (isOriginal) original.traces = next.traces;
    last = next;
    return draw(screen());
  };
};
