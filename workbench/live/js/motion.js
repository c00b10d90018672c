// A mechanism in motion: points are sums of coefficients and features of its coordinates.
const SVG = "http://www.w3.org/2000/svg";

// The features [re, im] of coordinates: 1, each length, and exp(+-i q angle) of each angle.
const featured = (coordinates, values) => {
  const features = [[1, 0]];
  coordinates.forEach(({ turns }, k) => {
    if (!turns.length) features.push([values[k], 0]);
    for (const turn of turns) {
      const [cosine, sine] = [Math.cos(turn * values[k]), Math.sin(turn * values[k])];
      features.push([cosine, sine], [cosine, -sine]);
    }
  });
  return features;
};

// The points [x, y] of a shape.
const points = ({ terms }, features, [right, down]) =>
  (terms[0]?.[1] ?? []).map((_, n) => {
    let [x, y] = [right, down];
    for (const [k, re, im] of terms) {
      const [c, s] = features[k];
      x += re[n] * c - im[n] * s;
      y += re[n] * s + im[n] * c;
    }
    return [x, y];
  });

const drawn = (tag, attributes, ...children) => {
  const made = document.createElementNS(SVG, tag);
  Object.entries(attributes).forEach(([name, value]) => made.setAttribute(name, value));
  made.append(...children);
  return made;
};

// The lines and the names of a run's shapes, and a function that moves them to features.
const outlined = (view, { shapes, size }, offset) => {
  const lines = shapes.map((shape) => {
    const { color, width, closed, name, label } = shape;
    const look = { fill: "none", stroke: color, "stroke-width": width };
    const title = drawn("title", {}, name);
    const line = drawn(closed ? "polygon" : "polyline", look, title);
    const text = label === null ? null : drawn("text", { dy: "-.5em" }, name);
    return { shape, line, text };
  });
  view.append(...lines.map(({ line }) => line), ...lines.flatMap(({ text }) => text ?? []));
  return (features) => {
    for (const { shape, line, text } of lines) {
      const places = points(shape, features, offset);
      line.setAttribute(
        "points",
        places.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" "),
      );
      if (!text) continue;
      const [x, y] = places[shape.label];
      const right = x > 0.8 * size[0];
      const anchor = { x, y, dx: right ? "-.5em" : ".5em", "text-anchor": right ? "end" : "start" };
      Object.entries(anchor).forEach(([name, value]) => text.setAttribute(name, value));
    }
  };
};

// What stands below the drawing at a frame.
const captioned = ({ captions }, names, frames, k) => {
  const one = (run) => {
    const parts = captions.map(({ text, unit, decimals, texts }, n) => {
      const value = run.captions[n][k];
      const number = texts.length ? (texts[Math.round(value)] ?? value) : value.toFixed(decimals);
      return `${text} ${number} ${unit}`.trim();
    });
    return parts.join(", ");
  };
  const each = frames.runs.map((run, n) => `${names[n]} ${one(run)}`.trim());
  return `${frames.times[k].toFixed(3)} s: ${each.join("; ")}`;
};

// A mechanism that plays frames again and again; returns a function that takes other frames.
const moving = (place, motion, names) => {
  const { title, size, letters, slow, note, coordinates, shapes, offset } = motion;
  const label = `${title}: ${shapes.map(({ name }) => name).join(", ")}`;
  const [wide, tall] = size;
  const view = drawn("svg", { role: "img", "aria-label": label, viewBox: `0 0 ${wide} ${tall}` });
  view.style.cssText = letters;
  const movers = names.map((_, n) =>
    outlined(
      view,
      motion,
      offset.map((x) => n * x),
    ),
  );
  const button = element("button", { type: "button" });
  const slider = element("input", { type: "range", min: 0, max: 1, step: "any" });
  slider.setAttribute("aria-label", "time of the motion in seconds");
  const caption = element("p", { class: "caption" });
  const controls = element("div", { class: "controls" }, button, slider);
  place.append(view, caption, controls, element("p", { class: "soft" }, note));
  let frames = null;
  let time = 0;
  let since = null;
  const show = () => {
    const last = frames.times.at(-1);
    const k = Math.max(
      0,
      frames.times.findLastIndex((t) => t <= time + 1e-9),
    );
    movers.forEach((move, n) => {
      const values = frames.runs[n].coordinates.map(
        (column) => column[Math.min(k, column.length - 1)],
      );
      move(featured(coordinates, values));
    });
    slider.value = time / last;
    caption.textContent = captioned(motion, names, frames, k);
    slider.setAttribute("aria-valuetext", caption.textContent);
  };
  const tick = (now) => {
    if (since === null || !place.isConnected) return;
    time = (time + (now - since) / (1000 * slow)) % frames.times.at(-1);
    since = now;
    show();
    requestAnimationFrame(tick);
  };
  const play = (on) => {
    since = on ? performance.now() : null;
    button.textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame(tick);
  };
  button.addEventListener("click", () => play(since === null));
  slider.addEventListener("input", () => {
    play(false);
    time = slider.value * frames.times.at(-1);
    show();
  });
  addEventListener("beforeprint", () => play(false));
  return (next) => {
    const share = frames ? time / frames.times.at(-1) : 0;
    const begins = !frames;
    frames = next;
    time = share * frames.times.at(-1);
    show();
    if (begins) play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  };
};
