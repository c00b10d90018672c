// Curves: plotly's traces and layouts as Python made them, filled with rows. Uses `small` and `element`
// of the page.

const GREY = "#76828c";
// The share of an axis that stays free beside its values.
const ROOM = 0.05;
// Pixels between a mark and its text.
const SHIFT = 4;

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
    for (const [key, axis] of Object.entries(layout)) {
      if (/^xaxis/.test(key)) axis.range = [first, end];
      if (!/^yaxis/.test(key)) continue;
      const own = [...old, ...filled].filter(({ yaxis }) => yaxis === `y${key.slice(5)}`);
      axis.range = ranged([...own.flatMap(({ y }) => y), ...includes[key.slice(5) - 1]]);
    }
    mark(layout, first, end);
    place.style.height = `${layout.height}px`;
    const data = [...old, ...filled];
    const options = { responsive: true, displayModeBar: false };
    return Plotly.react(place, data, { ...layout, dragmode: false }, options);
  };
  const grey = (trace, k) => {
    const before = original.traces[k];
    if ("level" in before) return null;
    const { line, marker } = trace;
    const quiet = { opacity: 0.5, hoverinfo: "skip", hovertemplate: null, showlegend: false };
    const color = { line: { ...line, color: GREY }, marker: { ...marker, color: GREY } };
    return { ...trace, ...before, ...quiet, ...color, legendgroup: "original" };
  };
  // Marks move to their values; one beyond the axis is not drawn.
  const mark = (layout, first, end) => {
    const rows = Object.keys(layout).filter((key) => /^yaxis/.test(key));
    layout.shapes = [];
    layout.annotations = layout.annotations.flatMap((note) => {
      const k = marks.findIndex(({ text }) => text === note.text);
      const value = last.marks[k];
      if (!(value >= first && value <= end)) return [];
      const share = (value - first) / (end - first);
      const near = (other, n) => n !== k && Math.abs(other - value) < 0.25 * (end - first);
      const before = (other, n) => near(other, n) && (other < value || (other === value && n < k));
      const after = last.marks.some(near) ? "right" : "center";
      const side = last.marks.some(before) ? "left" : after;
      const line = { color: GREY, dash: "dot", width: 1.6 };
      for (const key of rows) {
        const yref = `y${key.slice(5)} domain`;
        layout.shapes.push({ type: "line", yref, y0: 0, y1: 1, x0: value, x1: value, line });
      }
      const xanchor = share < 0.1 ? "left" : share > 0.9 ? "right" : side;
      const text = `${note.text} ${shown(value, 4)} ${marks[k].unit}`;
      const xshift = SHIFT * { left: 1, center: 0, right: -1 }[xanchor];
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
