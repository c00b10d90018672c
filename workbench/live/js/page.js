// The live part of a page: sliders, the address and the command that carry their values, and what the
// worker answers, beside the original answer. Uses the functions of page.html.
const PREFIX = "#live:";

const shown = (value, digits = 6) => String(Number(value.toPrecision(digits)));

// The text of a link; one that is not encoded stays as it is.
const readable = (text) => {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
};

// A slider and its box.
class Control {
  constructor(place, slider, moved, settled) {
    Object.assign(this, slider, { original: slider.value });
    this.range = place.querySelector("[type=range]");
    this.box = place.querySelector("[type=text]");
    this.wrong = place.querySelector(".wrong");
    this.range.addEventListener("input", () => {
      this.set(Number(Number(this.range.value).toPrecision(4)));
      moved();
    });
    this.box.addEventListener("input", () => this.type(this.box.value) && moved());
    for (const input of [this.range, this.box]) input.addEventListener("change", settled);
    this.set(this.value);
  }

  get unitText() {
    return this.unit === "1" ? "" : ` ${this.unit}`;
  }

  get isMoved() {
    return this.value !== this.original;
  }

  set(value) {
    this.box.value = shown(value);
    this.mark("");
    this.show(value);
  }

  show(value) {
    this.value = value;
    this.range.value = value;
    this.range.setAttribute("aria-valuetext", `${shown(value)}${this.unitText}`);
  }

  mark(text) {
    this.wrong.textContent = text;
    this.box.setAttribute("aria-invalid", text !== "");
  }

  // Take a typed text; false if it is no value of this slider.
  type(text) {
    const value = text.trim() === "" ? NaN : Number(text);
    const low = value < this.low ? `at least ${shown(this.low)}` : "";
    const high = value > this.high ? `at most ${shown(this.high)}` : "";
    const bound = low || high;
    this.mark(
      Number.isNaN(value) ? "must be a number" : bound && `must be ${bound}${this.unitText}`,
    );
    if (this.wrong.textContent) return false;
    this.show(value);
    return true;
  }
}

// The command that asks the question with the values of the sliders.
const commandOf = (data, controls) => {
  const moved = controls.filter((one) => one.isMoved);
  const starts = { ...data.given };
  for (const one of moved) if (!one.option) starts[one.name] = `${one.name}=${one.value}`;
  const options = moved.filter((one) => one.option);
  const flags = options.map((one) => `--${one.name.replaceAll("_", "-")} ${one.value}`);
  const replaced = (words) => flags.some((flag) => flag.split(" ")[0] === words.split(" ")[0]);
  const others = data.command.filter((words) => !replaced(words));
  const given = Object.values(starts).map((text) => `--start ${text}`);
  return [...others, ...flags, ...given].join(" ");
};

// A live number and its step difference, each with as many digits as the difference leaves.
const numberTexts = (value, difference) => {
  if (!Number.isFinite(value)) return null;
  if (!Number.isFinite(difference)) return [shown(value), "not known"];
  if (difference <= 1e-12 * Math.abs(value)) return [shown(value), "0"];
  const digits = Math.floor(Math.log10(Math.abs(value || 1))) - Math.floor(Math.log10(difference));
  return [shown(value, Math.min(7, Math.max(2, digits + 2))), shown(difference, 2)];
};

const live = async (content) => {
  const section = document.getElementById("live-part");
  const find = (selector) => section.querySelector(selector);
  if (!section || typeof WebAssembly !== "object" || typeof Worker !== "function") return;
  const data = content.live;
  const modules = {};
  for (const packed of section.querySelectorAll("script[data-part]")) {
    modules[packed.dataset.part] = await (await unpacked(packed.id)).arrayBuffer();
  }
  const source = new Blob([await unpack("worker")], { type: "text/javascript" });
  const worker = new Worker(URL.createObjectURL(source));
  section.hidden = false;
  document.documentElement.classList.add("has-live");
  for (const folded of document.querySelectorAll("details.original")) folded.open = false;

  const [state, alarm, spoken] = [find(".live-state"), find(".live-alarm"), find(".live-spoken")];
  const places = [...section.querySelectorAll(".slider")];
  const controls = places.map((place, k) => new Control(place, data.sliders[k], ask, settle));
  let id = 0;
  let strange = [];
  let request = null;
  let begin = null;
  const begun = new Promise((resolve) => {
    begin = resolve;
  });

  // The original machine is asked first, so that its curves stay in grey.
  function ask() {
    const isOriginal = !controls.some((one) => one.isMoved);
    const sliders = Object.fromEntries(controls.map((one) => [one.name, one.value]));
    request = { id: ++id, sliders, isOriginal };
    state.textContent = "Running …";
    section.setAttribute("aria-busy", "true");
    document.documentElement.classList.toggle("is-moved", !isOriginal);
    worker.postMessage(request);
  }

  function settle() {
    const moved = controls.filter((one) => one.isMoved);
    const words = moved.map((one) => `${one.name}=${one.value}`).join("&");
    find(".live-command code").textContent = commandOf(data, controls);
    const bare = location.pathname + location.search;
    const wanted = words ? PREFIX + words : location.hash.startsWith(PREFIX) ? "" : location.hash;
    if (wanted !== location.hash) history.replaceState(null, "", wanted || bare);
  }

  // Take the values of the address.
  const arrive = (hash) => {
    if (!hash.startsWith(PREFIX)) return;
    const words = readable(hash.slice(PREFIX.length)).split("&").filter(Boolean);
    const values = new Map(words.map((word) => [word.split("=")[0], word.replace(/^[^=]*=?/, "")]));
    for (const one of controls) {
      one.set(one.original);
      if (!values.has(one.name)) continue;
      one.box.value = values.get(one.name);
      one.type(one.box.value);
      values.delete(one.name);
    }
    const names = [...values.keys()].join(", ");
    strange = names ? [`The link sets ${names}, which this page does not have.`] : [];
    find(".live-command code").textContent = commandOf(data, controls);
    ask();
  };

  const charts = [...(data.sweep ? [data.sweep.chart] : []), ...data.charts].map((chart) => {
    const place = element("div", { class: "live-chart", role: "img" });
    find(".live-charts").append(element("figure", {}, element("h3", {}, chart.title), place));
    return charted(place, chart);
  });
  const move =
    data.motion &&
    moving(
      find(".live-motion"),
      data.motion,
      data.runs.map((run) => run.name),
    );

  const fill = (numbers, differences) => {
    for (const row of section.querySelectorAll("tr[data-number]")) {
      const { name, unit, otherwise } = data.numbers.find((one) => one.name === row.dataset.number);
      const texts = numberTexts(numbers[name], differences[name]);
      const cells = row.querySelectorAll("td");
      const suffix = unit === "1" ? "" : ` ${unit}`;
      cells[0].textContent = texts ? `${texts[0]}${suffix}` : otherwise || "not reached";
      cells[1].textContent = texts ? `${texts[1]}${suffix}` : "";
      cells[0].dataset.value = numbers[name];
      cells[1].dataset.value = differences[name];
    }
  };

  function finish({ failure, took }) {
    section.setAttribute("aria-busy", "false");
    state.textContent = failure ? "No answer" : `Done in ${(took / 1000).toFixed(2)} s`;
    const first = section.querySelector("tr[data-number]");
    spoken.textContent = failure
      ? alarm.textContent
      : (first?.textContent.replace(/\s+/g, " ") ?? "Done");
    section.dataset.answered = id;
    settle();
    begin();
  }

  worker.onmessage = ({ data: part }) => {
    if (part.id !== id) return;
    const { isOriginal } = request;
    const sweeps = charts.length - data.charts.length;
    part.charts?.forEach((chart, k) => charts[sweeps + k](chart, isOriginal));
    if (part.charts) section.dataset.drawn = id;
    if (part.sweep) charts[0](part.sweep, isOriginal && part.done);
    if (part.motion) move?.(part.motion);
    if (part.numbers) fill(part.numbers, part.differences);
    if (part.share) state.textContent = `Running: ${Math.round(100 * part.share)} % of the sweep …`;
    if (part.numbers || part.failure) {
      const failed = `No answer with these values: ${part.failure}. Below is the last answer.`;
      const alarms = part.failure ? [failed] : [...strange, ...part.warnings];
      alarm.hidden = !alarms.length;
      alarm.replaceChildren(...alarms.map((line) => element("p", {}, line)));
    }
    if (part.done) finish(part);
  };
  worker.onerror = ({ message }) => {
    alarm.hidden = false;
    alarm.textContent = `The live part of this page failed: ${message}`;
  };

  find(".live-reset").addEventListener("click", () => {
    for (const one of controls) one.set(one.original);
    strange = [];
    ask();
    settle();
  });
  find(".live-copy").addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(commandOf(data, controls));
    } catch {
      getSelection().selectAllChildren(find(".live-command code"));
      document.execCommand("copy");
    }
    state.textContent = spoken.textContent = "Copied";
  });
  find(".live-command code").textContent = commandOf(data, controls);
  const address = location.hash;
  worker.postMessage({ modules, data });
  ask();
  await begun;
  // Its own address: by now an answer may have replaced that of the page.
  addEventListener("hashchange", (event) => arrive(new URL(event.newURL).hash));
  arrive(address);
};
