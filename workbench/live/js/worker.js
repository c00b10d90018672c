// Answers the newest request; what is asked meanwhile waits for the next part of an answer.
let model = null;
let newest = null;
let busy = false;
// How often the points of a sweep are shown [ms].
const PACE = 200;
// How long a newer request waits for the points of a sweep [ms].
const PAUSE = 20;
// The sweep goes through its values in so many passes, so that its first points show the whole of it.
const PASSES = 4;

const breath = () =>
  new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = resolve;
    port2.postMessage(0);
  });

// An answer in parts: the curves of twice the step, all with the step itself, the sweep.
const answer = async function* ({ sliders }) {
  const rough = model.answer(sliders, 2);
  yield { charts: rough.charts };
  const fine = model.answer(sliders, 1);
  const difference = ([name, value]) => [name, Math.abs(value - rough.numbers[name])];
  const differences = Object.fromEntries(Object.entries(fine.numbers).map(difference));
  yield { ...fine, differences, done: !model.data.sweep };
  if (!model.data.sweep) return;
  const { values } = model.data.sweep;
  const passes = values.map((_, k) => k % PASSES);
  const sequence = values.map((_, k) => k).sort((a, b) => passes[a] - passes[b] || a - b);
  const points = [];
  let [last, heard] = [performance.now(), performance.now()];
  for (const k of sequence) {
    points.push(model.point(sliders, values[k]));
    const now = performance.now();
    if (now - last > PACE) {
      yield { sweep: model.curve(points, sliders), share: points.length / values.length };
      last = now;
    } else if (now - heard > PAUSE) {
      yield null;
      heard = now;
    }
  }
  yield { sweep: model.curve(points, sliders), done: true };
};

const work = async () => {
  busy = true;
  while (newest) {
    const request = newest;
    const { id } = request;
    newest = null;
    const begin = performance.now();
    try {
      for await (const part of answer(request)) {
        if (part) postMessage({ id, ...part, took: performance.now() - begin });
        await breath();
        if (newest) break;
      }
    } catch (error) {
      if (!(error instanceof Failure)) throw error;
      postMessage({ id, failure: error.message, done: true, took: performance.now() - begin });
    }
  }
  busy = false;
};

onmessage = ({ data }) => {
  if (data.modules) {
    const compiled = Object.entries(data.modules).map(([part, bytes]) => [
      part,
      new WebAssembly.Module(bytes),
    ]);
    model = new Model(data.data, Object.fromEntries(compiled));
  } else {
    newest = data;
    if (!busy) work();
  }
};
