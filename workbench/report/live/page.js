// The live part of a page: sliders, a worker that answers, and its figures next to the original answer.
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
      alarm.textContent = `The live part of this page failed: ${event.message}`;
    };
    worker.postMessage({ modules, machine: told.machine });
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
    worker.postMessage({ id: ++id, options, asked });
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
    const given = new Map(readable(location.hash.slice(PREFIX.length)).split("&").filter(Boolean).map(word => [word.split("=")[0], word.slice(word.split("=")[0].length + 1)]));
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
    if (data.id === id && data.done) since = 0; else if (!data.note) since = performance.now();
    if (data.charts) data.charts.forEach((one, k) => paint(k, one));
    if (data.motions) data.motions.forEach((next, k) => move(k, next));
    if (data.figures) fill(data.figures);
    if (data.verdict) $(".verdict div").replaceChildren(...data.verdict.map(line => element("p", {}, line)));
    if (data.note) state.textContent = `Running: ${data.note} …`;
    if (data.id !== id || !data.done) return;
    section.setAttribute("aria-busy", "false");
    const alarms = data.failure ? [`No answer with these values: ${data.failure}. Below is the last answer.`] : [...strange, ...data.warnings ?? []];
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
      cell.textContent = !found ? "…" : found.error === null ? `not determined (${found.reason})` : found.text;
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
      charts[k] = element("div", { class: "live-chart", role: "img", "aria-label": "live curves over the original ones, which are grey" });
      $(".live-charts").append(charts[k]);
    }
    last[k] = one;
    const drawn = beside(content.charts[k], one, small.matches ? "narrow" : "wide");
    charts[k].style.height = `${drawn.layout.height}px`;
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

// What a link says, as it stands where it is no encoded text.
const readable = text => {
  try { return decodeURIComponent(text); } catch { return text; }
};

const shown = value => String(Number(value.toPrecision(6)));

const GREY = "#76828c";

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
