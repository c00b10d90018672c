// The live part of a page: sliders, a worker that answers, and what it told, beside the still answer.
// Stands in the script of page.html, whose functions it uses. A worker that is asked anew and has told
// nothing for so many ms is left for another.
const PATIENCE = 1500;

const live = async content => {
  const section = document.getElementById("live-part"), told = content.live, $ = name => section.querySelector(name);
  if (!section || typeof WebAssembly !== "object" || typeof Worker !== "function") return;
  const source = URL.createObjectURL(new Blob([await unpack("worker")], { type: "text/javascript" })), modules = {};
  for (const script of section.querySelectorAll("script[data-part]"))
    modules[script.dataset.part] = await (await unpacked(script.id)).arrayBuffer();
  let worker = null, since = 0;
  const begin = () => {
    worker?.terminate();
    worker = new Worker(source);
    worker.onmessage = hear;
    worker.onerror = event => {
      alarm.hidden = false;
      alarm.textContent = `The live part of this page broke down: ${event.message}`;
    };
    worker.postMessage({ modules, wires: told.wires, sequence: told.sequence, machine: told.machine });
  };
  section.hidden = false;

  const state = $(".live-state"), alarm = $(".live-alarm"), spoken = $(".live-spoken"), PREFIX = "#live:";
  const rows = [...section.querySelectorAll(".slider")].map((place, k) => {
    const one = { ...told.sliders[k], now: told.sliders[k].value, range: place.querySelector("[type=range]"),
      box: place.querySelector("[type=text]"), wrong: place.querySelector(".wrong") };
    const unit = one.unit === "1" ? "" : ` ${one.unit}`;
    one.range.addEventListener("input", () => { one.set(Number(Number(one.range.value).toPrecision(4))); ask(); });
    one.range.addEventListener("change", () => keep());
    one.box.addEventListener("input", () => { if (one.type(one.box.value)) ask(); });
    one.box.addEventListener("change", () => keep());
    one.mark = text => {
      one.wrong.textContent = text;
      one.box.setAttribute("aria-invalid", text !== "");
    };
    one.show = () => {
      one.range.value = one.now;
      one.range.setAttribute("aria-valuetext", `${shown(one.now)}${unit}`);
    };
    one.set = value => { one.now = value; one.box.value = shown(value); one.mark(""); one.show(); };
    one.type = typed => {
      const value = typed.trim() === "" ? NaN : Number(typed);
      const bound = value < one.low ? `at least ${shown(one.low)}` : value > one.high ? `at most ${shown(one.high)}` : "";
      one.mark(Number.isNaN(value) ? "must be a number" : bound && `must be ${bound}${unit}`);
      if (one.wrong.textContent) return false;
      one.now = value;
      one.show();
      return true;
    };
    return one;
  });
  const moved = () => rows.filter(one => one.now !== one.value);

  let id = 0, strange = [];
  const ask = () => {
    const options = { ...told.options }, asked = { ...told.asked };
    for (const one of moved()) (one.option ? options : asked)[one.name] = one.now;
    for (const one of rows) if (one.option && options[one.name] === null) options[one.name] = one.now;
    state.textContent = "Running …";
    section.setAttribute("aria-busy", "true");
    if (since && performance.now() - since > PATIENCE) begin(), since = 0;
    since ||= performance.now();
    worker.postMessage({ id: ++id, options, asked, start: { ...told.start, ...asked }, facts: told.facts });
  };

  const command = () => {
    const starts = { ...told.asked }, flags = [];
    for (const one of moved())
      if (one.option) flags.push(`--${one.name.replaceAll("_", "-")} ${one.now}`); else starts[one.name] = one.now;
    const kept = told.command.filter(words => !flags.some(flag => flag.split(" ")[0] === words.split(" ")[0]));
    return [...kept, ...flags, ...Object.entries(starts).map(([name, value]) => `--start ${name}=${value}`)].join(" ");
  };

  const keep = () => {
    const words = moved().map(one => `${one.name}=${one.now}`).join("&");
    const wanted = words ? PREFIX + words : location.hash.startsWith(PREFIX) ? " " : "";
    $(".live-command code").textContent = command();
    if (wanted && wanted.trim() !== location.hash) history.replaceState(null, "", wanted.trim() || location.pathname + location.search);
  };

  const arrive = () => {
    if (!location.hash.startsWith(PREFIX)) return;
    const given = new Map(decodeURIComponent(location.hash.slice(PREFIX.length)).split("&").filter(Boolean).map(word => word.split("=")));
    for (const one of rows) {
      one.set(one.value);
      if (given.has(one.name)) {
        one.box.value = given.get(one.name);
        one.type(one.box.value);
      }
      given.delete(one.name);
    }
    strange = given.size ? [`The link sets ${[...given.keys()].join(", ")}, which this page does not have.`] : [];
    $(".live-command code").textContent = command();
    ask();
  };

  const hear = ({ data }) => {
    if (data.id === id && data.done) since = 0; else if (data.figures) since = performance.now();
    if (data.charts) data.charts.forEach((one, k) => paint(k, one));
    const motions = data.motions ?? (data.motion ? [moving(content.motions[0], data.motion)] : []);
    motions.forEach((next, k) => move(k, next));
    if (data.figures) fill(data.figures);
    if (data.verdict) $(".verdict div").replaceChildren(...data.verdict.map(line => element("p", {}, line)));
    if (data.note) state.textContent = `Running: ${data.note} …`;
    if (data.id !== id || !data.done) return;
    section.setAttribute("aria-busy", "false");
    const alarms = data.failure ? [`No answer with these values: ${data.failure}. Below is the last answer there was.`] : [...strange, ...data.warnings ?? []];
    alarm.hidden = !alarms.length;
    alarm.replaceChildren(...alarms.map(line => element("span", { style: "display: block" }, line)));
    if (data.figures) for (const row of section.querySelectorAll("tr[data-figure]"))
      if (!(row.dataset.figure in data.figures)) row.querySelector("td").textContent = "none";
    state.textContent = data.failure ? "No answer" : `Done in ${(data.took / 1000).toFixed(1)} s`;
    spoken.textContent = data.failure ? alarm.textContent : data.verdict.join(" ");
    section.dataset.answered = id;
    keep();
  };
  const fill = figures => {
    const rows = [...section.querySelectorAll("tr[data-figure]")], names = rows.map(row => row.dataset.figure);
    for (const [name, { meaning }] of Object.entries(figures)) if (!names.includes(name)) {
      rows.push(element("tr", { role: "row", "data-figure": name }, element("th", { scope: "row", role: "rowheader" }, meaning),
        element("td", { role: "cell" }), element("td", { role: "cell" }, "none")));
      $("tbody").append(rows.at(-1));
    }
    for (const row of rows) {
      const found = figures[row.dataset.figure], cell = row.querySelector("td");
      cell.textContent = !found ? "…" : found.error === null ? `not told (${found.reason})` : found.text;
      cell.dataset.value = found?.value ?? "";
      cell.dataset.error = found?.error ?? "";
    }
  };

  const shapes = [];
  const move = (k, next) => {
    if (shapes[k]) return shapes[k](next);
    const place = element("div", { class: "moving" });
    $(".live-motion").append(place);
    shapes[k] = animate(place, next);
  };

  const charts = [], last = [];
  const paint = (k, one) => {
    if (!charts[k]) {
      charts[k] = element("div", { class: "live-chart", role: "img", "aria-label": "live curves over the still ones, which are grey" });
      $(".live-charts").append(charts[k]);
    }
    last[k] = one;
    const drawn = (one.data ? beside : overlaid)(content.charts[k], one, small.matches ? "narrow" : "wide");
    Plotly.react(charts[k], drawn.data, drawn.layout, { responsive: true, displayModeBar: false });
  };
  small.addEventListener("change", () => last.forEach((one, k) => paint(k, one)));

  $(".live-reset").addEventListener("click", () => { rows.forEach(one => one.set(one.value)); strange = []; ask(); keep(); });
  $(".live-copy").addEventListener("click", async () => {
    const text = command();
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      getSelection().selectAllChildren($(".live-command code"));
      document.execCommand("copy");
    }
    state.textContent = spoken.textContent = "Copied";
  });
  addEventListener("hashchange", arrive);
  $(".live-command code").textContent = command();
  rows.forEach(one => one.set(one.value));
  begin();
  if (location.hash.startsWith(PREFIX)) arrive(); else ask();
};

const shown = value => String(Number(value.toPrecision(6)));

// The lines of the still chart in grey below those of the live one; the axes fit both.
const beside = (still, one, screen) => {
  const layout = structuredClone(one[screen]), titles = laid => key => laid[key]?.title?.text;
  const now = titles(layout), before = titles(still[screen]), axes = Object.keys(layout).filter(key => /^yaxis/.test(key));
  const twin = key => axes.includes(key) && now(key) === before(key) ? key : axes.find(other => now(other) === before(key));
  const grey = still.data.filter(trace => !trace.type && !trace.fill && trace.name && trace.line?.width !== 0 && twin(`yaxis${trace.yaxis.slice(1)}`))
    .map(trace => ({ ...trace, yaxis: `y${twin(`yaxis${trace.yaxis.slice(1)}`).slice(5)}`, opacity: 0.5, hoverinfo: "skip", hovertemplate: null, showlegend: false, legendgroup: "still",
      marker: { ...trace.marker, color: GREY }, line: { ...trace.line, color: GREY } }));
  for (const key of Object.keys(still[screen]).filter(key => /^[xy]axis/.test(key))) {
    const axis = layout[key[0] === "x" ? key : twin(key)], { range: other } = still[screen][key];
    if (axis) axis.range = axis.range.map((x, k) => (axis.range[0] > axis.range[1]) === (k === 0) ? Math.max(x, other[k]) : Math.min(x, other[k]));
  }
  return { data: [...grey, ...one.data], layout: { ...layout, dragmode: false } };
};

// The still chart in grey, and over it the live curves of a script in its colours; the axes fit both.
const overlaid = (still, one, screen) => {
  const layout = structuredClone(still[screen]), fresh = new Map(), before = [];
  for (const curve of one.curves) {
    const like = still.data.filter(trace => trace.yaxis === `y${curve.panel}` && trace.name === curve.name);
    const model = like.find(trace => trace.showlegend ?? true) ?? like[0], { mode, marker } = model;
    like.forEach(trace => {
      before.push({ ...trace, opacity: 0.5, hoverinfo: "skip", hovertemplate: null, showlegend: false,
        legendgroup: "still", marker: { ...trace.marker, color: GREY }, line: { ...trace.line, color: GREY } });
      fresh.set(trace, null);
    });
    const error = mode === "markers" && curve.error
      ? { error_y: { type: "data", array: curve.error, thickness: 1.2, width: 0, color: marker.color } } : {};
    fresh.set(model, { ...model, x: curve.x, y: curve.y, ...error });
  }
  const after = still.data.map(trace => fresh.has(trace) ? fresh.get(trace) : trace).filter(Boolean);
  const curves = [...fresh.values()].filter(Boolean), xs = curves.flatMap(trace => trace.x);
  const wide = layout.xaxis.range, factor = layout.meta?.factor;
  wide[1] = xs.reduce((most, x) => Math.max(most, x), wide[1]);
  if (factor) layout.xaxis2.range = wide.map(x => factor * x);
  for (const key of Object.keys(layout).filter(key => /^yaxis/.test(key))) {
    const values = curves.filter(trace => trace.yaxis === `y${key.slice(5)}`).flatMap(trace => trace.y).filter(Number.isFinite);
    const [low, high] = layout[key].range, [least, most] = values.reduce(([a, b], y) => [Math.min(a, y), Math.max(b, y)], [low, high]);
    const room = 0.05 * (most - least);
    layout[key].range = [least < low ? least - room : low, most > high ? most + room : high];
  }
  const spans = [...one.spans, ...one.marks.map(mark => ({ ...mark, first: mark.at, last: mark.at }))]
    .filter(span => span.last >= wide[0] && span.first <= wide[1]);
  layout.annotations = flags(spans, wide, LETTERS[screen]).map(({ text, x, anchor, lane }) => ({ text, x, xanchor: anchor,
    showarrow: false, font: { size: 11 }, yref: "y domain", y: 1, yanchor: "bottom", yshift: 19 * lane }));
  const lanes = drawn => Math.max(0, ...drawn.map(flag => flag.yshift)), more = Math.max(0, lanes(layout.annotations) - lanes(still[screen].annotations));
  layout.legend2.y += more / (layout.height - layout.margin.t - layout.margin.b);
  layout.margin = { ...layout.margin, t: layout.margin.t + more };
  layout.height += more;
  const panels = Object.keys(layout).filter(key => /^yaxis/.test(key));
  layout.shapes = panels.flatMap((_, k) => spans.map(({ first, last, color = GREY }) => ({
    type: "rect", yref: `y${k + 1} domain`, y0: 0, y1: 1, x0: first, x1: last, layer: "below", fillcolor: `${color}24`,
    line: { color, ...(first === last ? { dash: "dot", width: 1.6 } : { width: 0.6 }) },
  })));
  return { data: [...before, ...after], layout: { ...layout, dragmode: false } };
};

// Where the words of spans and marks stand, as layout.py places them: none covers another.
const GREY = "#76828c", LETTERS = { narrow: 44, wide: 130 };
const flags = (spans, [low, high], letters) => {
  const marks = spans.filter(span => span.first === span.last).sort((a, b) => b.first - a.first), taken = [];
  return [...spans.filter(span => span.first !== span.last), ...marks].map(({ first, last, text }) => {
    const long = Math.min((text.length + 2) / letters, 1), share = x => Math.min(Math.max((x - low) / (high - low), 0), 1);
    let at = (share(first) + share(last)) / 2;
    let begins = first !== last ? [] : [["left", at], ["right", at - long]].filter(([, x]) => x >= 0 && x <= 1 - long);
    if (!begins.length) {
      at = Math.max(Math.min(at, 1 - long / 2), long / 2);
      begins = [["center", at - long / 2]];
    }
    for (let lane = 0; ; lane++)
      for (const [anchor, begin] of begins) {
        if (taken.some(([k, from, to]) => k === lane && begin < to && from < begin + long)) continue;
        taken.push([lane, begin, begin + long]);
        return { text, anchor, lane, x: low + at * (high - low) };
      }
  });
};

// The still motion with the frames of a live run: the same ones at the times at which it passes their
// `angle`, or others with the points of `shapes` by name; what stands stays.
const moving = (motion, run) => {
  const now = element("div", {});
  now.innerHTML = motion.svg;
  let times = run.time, captions = run.captions;
  if (run.angle) {
    let k = 0;
    times = motion.angles.map(angle => {
      while (k < run.angle.length - 2 && run.angle[k + 1] < angle) k++;
      const share = (angle - run.angle[k]) / (run.angle[k + 1] - run.angle[k]);
      return Math.max(0, run.time[k] + share * (run.time[k + 1] - run.time[k]));
    });
    times[0] = 0;
    captions = times.map(t => run.captions[Math.max(0, run.time.findLastIndex(x => x <= t + 1e-9))]);
  }
  const end = times.at(-1), { low, high, scale, edge } = motion.place;
  const placed = ([x, y]) => [edge + scale * (x - low), edge + scale * (high - y)].map(z => z.toFixed(1));
  for (const [name, frames] of Object.entries(run.shapes ?? {})) {
    const lines = [...now.querySelectorAll("polyline, polygon")].filter(line => line.querySelector("title")?.textContent === name);
    const word = [...now.querySelectorAll("text")].find(text => text.firstChild.data === name);
    for (const line of lines.filter(line => line.querySelector("animate"))) {
      if (word) {
        const still = line.getAttribute("points").split(" ").map(Number), at = [word.getAttribute("x"), word.getAttribute("y")].map(Number);
        const near = frames[0].map((_, k) => Math.hypot(still[2 * k] - at[0], still[2 * k + 1] - at[1]));
        const k = near.indexOf(Math.min(...near));
        ["x", "y"].forEach((side, j) => word.querySelector(`[attributeName=${side}]`)
          ?.setAttribute("values", frames.map(points => placed(points[k])[j]).join(";")));
      }
      line.querySelector("animate").setAttribute("values", frames.map(points => points.flatMap(placed).join(" ")).join(";"));
    }
  }
  for (const moved of now.querySelectorAll("animate")) {
    moved.setAttribute("keyTimes", times.map(t => (t / end).toFixed(6)).join(";"));
    moved.setAttribute("dur", `${end * motion.slow}s`);
  }
  return { ...motion, svg: now.innerHTML, times, captions };
};
